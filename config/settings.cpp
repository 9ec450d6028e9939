// SPDX-License-Identifier: GPL-3.0-or-later
#include "config/settings.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

constexpr int kDay_s = 86400;

const std::array<OptionSpec, 9> kOptions = {{
    {"listen", "HOST:PORT", "address to listen on; port 0 takes a free one", &Settings::listen},
    {"threads", "N", "worker threads; 0: one per core", &Settings::threads, 0, 1024},
    {"cesium", "DIR", "CesiumJS for the globe page (npm's cesium/Build/Cesium)", &Settings::cesium},
    {"max_connections", "N", "open connections; further ones are answered 503", &Settings::max_connections, 1, 1000000},
    {"max_header_bytes", "N", "bytes of request line and header fields", &Settings::max_header_bytes, 1024, 1 << 20},
    {"request_timeout_s", "S", "seconds a request may take to arrive, or its answer to make progress",
     &Settings::request_timeout_s, 1, kDay_s},
    {"idle_timeout_s", "S", "seconds a connection may stay open without a request", &Settings::idle_timeout_s, 1,
     kDay_s},
    {"drain_timeout_s", "S", "seconds that answers under way get after SIGTERM", &Settings::drain_timeout_s, 0, kDay_s},
    {"cache_mb", "MB", "memory for finished answers; 0: none", &Settings::cache_mb, 0, 1 << 20},
}};

tl::unexpected<Error> invalid(std::string message) { return fail(ErrorKind::kInvalidInput, std::move(message)); }

}  // namespace

std::span<const OptionSpec> option_table() { return kOptions; }

std::string flag_of(const OptionSpec& option) {
  std::string flag = std::string("--") + option.name;
  std::replace(flag.begin(), flag.end(), '_', '-');
  return flag;
}

std::string variable_of(const OptionSpec& option) {
  std::string variable = std::string("TIND_") + option.name;
  std::transform(variable.begin(), variable.end(), variable.begin(),
                 [](char c) { return c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c; });
  return variable;
}

Result<void> set_option(Settings& settings, const OptionSpec& option, const std::string& text,
                        const std::string& where) {
  if (const auto* member = std::get_if<std::string Settings::*>(&option.member)) {
    settings.** member = text;
    return {};
  }
  int value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || value < option.minimum || value > option.maximum) {
    return invalid(
        fmt::format("{}: '{}' is not a whole number from {} to {}", where, text, option.minimum, option.maximum));
  }
  settings.*std::get<int Settings::*>(option.member) = value;
  return {};
}

Result<Settings> overlay_json(Settings base, std::string_view json, const std::string& file_name) {
  const nlohmann::json root = nlohmann::json::parse(json, nullptr, false);
  if (!root.is_object()) return invalid(file_name + ": not a JSON object");
  for (const auto& [name, value] : root.items()) {
    const std::string where = file_name + ": \"" + name + "\"";
    if (name == "$schema") continue;
    if (name == "datasets") {
      if (!value.is_array() || !std::all_of(value.begin(), value.end(), [](const auto& v) { return v.is_string(); })) {
        return invalid(where + " is not a list of paths");
      }
      base.datasets = value.get<std::vector<std::string>>();
      continue;
    }
    const auto option =
        std::find_if(kOptions.begin(), kOptions.end(), [&wanted = name](const auto& o) { return wanted == o.name; });
    if (option == kOptions.end()) return invalid(where + " is not a setting");
    const bool wants_text = std::holds_alternative<std::string Settings::*>(option->member);
    if (wants_text != value.is_string() || (!wants_text && !value.is_number_integer())) {
      return invalid(where + (wants_text ? " is not a string" : " is not a whole number"));
    }
    const std::string text = wants_text ? value.get<std::string>() : value.dump();
    if (auto set = set_option(base, *option, text, where); !set) return tl::unexpected(set.error());
  }
  return base;
}

Result<Settings> overlay_environment(Settings base, const Environment& environment) {
  if (const auto paths = environment("TIND_DATASETS"); paths && !paths->empty()) {
    base.datasets.clear();
    for (std::size_t at = 0; at <= paths->size();) {
      const std::size_t end = std::min(paths->find(':', at), paths->size());
      if (end > at) base.datasets.push_back(paths->substr(at, end - at));
      at = end + 1;
    }
  }
  for (const OptionSpec& option : kOptions) {
    const std::string variable = variable_of(option);
    const auto text = environment(variable);
    if (!text) continue;
    if (auto set = set_option(base, option, *text, variable); !set) return tl::unexpected(set.error());
  }
  return base;
}

}  // namespace tind
