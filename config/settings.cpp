// SPDX-License-Identifier: GPL-3.0-or-later
#include "config/settings.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

constexpr int kDay_s = 86400;

const auto kOptions = std::to_array<OptionSpec>({
    {"listen", "HOST:PORT",
     "addresses to listen on, HOST:PORT or unix:PATH, separated by commas; port 0 takes a free one", &Settings::listen},
    {"threads", "N", "worker threads; 0: one per core", &Settings::threads, 0, 1024},
    {"cesium", "DIR", "CesiumJS for the globe page (npm's cesium/Build/Cesium)", &Settings::cesium},
    {"max_connections", "N", "open connections; further ones are answered 503", &Settings::max_connections, 1, 1000000},
    {"max_header_bytes", "N", "bytes of request line and header fields", &Settings::max_header_bytes, 1024, 1 << 20},
    {"request_timeout_s", "S", "seconds a request may take to arrive, or its answer to make progress",
     &Settings::request_timeout_s, 1, kDay_s},
    {"idle_timeout_s", "S", "seconds a connection may stay open without a request", &Settings::idle_timeout_s, 1,
     kDay_s},
    {"drain_timeout_s", "S", "seconds that answers under way get after SIGTERM", &Settings::drain_timeout_s, 0, kDay_s},
    {"max_connections_per_address", "N", "open connections of one client; 0: as many as in all",
     &Settings::max_connections_per_address, 0, 1000000},
    {"max_requests_per_connection", "N", "requests that a connection may bring before it is closed; 0: any number",
     &Settings::max_requests_per_connection, 0, 1000000000},
    {"min_send_rate_bytes_s", "N", "bytes per second that a client must take of a waiting answer; 0: any progress",
     &Settings::min_send_rate_bytes_s, 0, 1000000000},
    {"cors_origins", "LIST", "origins whose pages may read answers, separated by commas; *: all; none when empty",
     &Settings::cors_origins},
    {"public_url", "URL", "address that clients know the daemon by, for absolute links; relative ones when empty",
     &Settings::public_url},
    {"trust_proxy", "off|on", "make links absolute by Forwarded and X-Forwarded-*, which a proxy must set",
     &Settings::trust_proxy},
    {"cache_mb", "MB", "memory for finished answers; 0: none", &Settings::cache_mb, 0, 1 << 20},
    {"admin_listen", "HOST:PORT", "address for /metrics, /-/reload, /-/health and /-/datasets; none when empty",
     &Settings::admin_listen},
    {"watch", "auto|poll|off", "notice new, replaced and removed files at once, by looking now and then, or on reload",
     &Settings::watch},
    {"poll_interval_s", "S", "seconds between two looks at the files", &Settings::poll_interval_s, 1, kDay_s},
    {"max_open_datasets", "N", "files open at a time; others are opened when they are asked for",
     &Settings::max_open_datasets, 1, 100000},
    {"log_level", "debug|info|warning|error", "least level of the lines on standard error", &Settings::log_level},
    {"log_format", "text|json", "form of the lines on standard error and of the access log", &Settings::log_format},
    {"access_log", "FILE", "a line per request goes there; - is standard output; none when empty",
     &Settings::access_log},
});

constexpr std::size_t kMaxDatasets = 100000;
constexpr std::string_view kMerge = "merge", kParentUrl = "parent_url";

tl::unexpected<Error> invalid(std::string message) { return fail(ErrorKind::kInvalidInput, std::move(message)); }

// One entry of "datasets": a path, or an object.
Result<DatasetSpec> read_dataset(const nlohmann::json& entry, const std::string& where) {
  if (entry.is_string() && !entry.get_ref<const std::string&>().empty()) return DatasetSpec(entry.get<std::string>());
  if (!entry.is_object()) return invalid(where + ": neither a path nor an object with \"path\"");
  DatasetSpec spec;
  for (const auto& [name, value] : entry.items()) {
    if (!value.is_string()) return invalid(fmt::format("{}: \"{}\" is not a string", where, name));
    const std::string& text = value.get_ref<const std::string&>();
    if (name == "path") {
      spec.path = text;
    } else if (name == "name") {
      if (text.empty() || text.find('/') != text.npos) return invalid(where + ": \"name\" is empty or has a slash");
      spec.name = text;
    } else if (name == "base") {
      spec.base = text;
    } else if (name == "base_mode") {
      if (text != kMerge && text != kParentUrl) {
        return invalid(fmt::format("{}: \"base_mode\": '{}' is neither {} nor {}", where, text, kMerge, kParentUrl));
      }
      spec.base_mode = text == kMerge ? BaseMode::kMerge : BaseMode::kParentUrl;
    } else {
      return invalid(fmt::format("{}: \"{}\" is none of path, name, base, base_mode", where, name));
    }
  }
  if (spec.path.empty()) return invalid(where + ": \"path\" is missing");
  return spec;
}

nlohmann::ordered_json dataset_to_json(const DatasetSpec& spec) {
  if (spec == DatasetSpec(spec.path)) return spec.path;
  nlohmann::ordered_json entry = {{"path", spec.path}};
  if (!spec.name.empty()) entry["name"] = spec.name;
  if (!spec.base.empty()) entry["base"] = spec.base;
  entry["base_mode"] = spec.base_mode == BaseMode::kMerge ? kMerge : kParentUrl;
  return entry;
}

// Line and column, from 1, of a place in the text.
std::string place_of(std::string_view text, std::size_t at) {
  const std::string_view before = text.substr(0, std::min(at, text.size()));
  const auto line_begin = before.rfind('\n') + 1;  // npos + 1 is 0
  return fmt::format("line {}, column {}", std::count(before.begin(), before.end(), '\n') + 1,
                     before.size() - line_begin + 1);
}

// nlohmann reports where a text ends to be JSON by exception only.
Result<nlohmann::json> parse_json(std::string_view text, const std::string& file_name) {
  try {
    return nlohmann::json::parse(text);
  } catch (const nlohmann::json::parse_error& error) {
    return invalid(fmt::format("{}: not JSON at {}", file_name, place_of(text, error.byte > 0 ? error.byte - 1 : 0)));
  } catch (const nlohmann::json::out_of_range&) {  // and 1e999 by another one
    return invalid(file_name + ": a number is too large");
  }
}

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

std::vector<std::string> choices_of(const OptionSpec& option) {
  const std::string_view words = option.value_name;
  std::vector<std::string> choices;
  for (std::size_t at = 0; words.find('|') != words.npos && at <= words.size();) {
    const std::size_t end = std::min(words.find('|', at), words.size());
    choices.emplace_back(words.substr(at, end - at));
    at = end + 1;
  }
  return choices;
}

Result<void> set_option(Settings& settings, const OptionSpec& option, const std::string& text,
                        const std::string& where) {
  if (const auto* member = std::get_if<std::string Settings::*>(&option.member)) {
    const auto choices = choices_of(option);
    if (!choices.empty() && std::find(choices.begin(), choices.end(), text) == choices.end()) {
      return invalid(fmt::format("{}: '{}' is none of {}", where, text, fmt::join(choices, ", ")));
    }
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
  const auto root = parse_json(json, file_name);
  if (!root) return tl::unexpected(root.error());
  if (!root->is_object()) return invalid(file_name + ": not a JSON object");
  for (const auto& [name, value] : root->items()) {
    const std::string where = file_name + ": \"" + name + "\"";
    if (name == "$schema") continue;
    if (name == "datasets") {
      if (!value.is_array() || value.size() > kMaxDatasets) {
        return invalid(fmt::format("{} is not a list of at most {} paths or objects", where, kMaxDatasets));
      }
      base.datasets.clear();
      for (std::size_t k = 0; k < value.size(); ++k) {
        auto spec = read_dataset(value[k], fmt::format("{}[{}]", where, k));
        if (!spec) return tl::unexpected(spec.error());
        base.datasets.push_back(std::move(*spec));
      }
      continue;
    }
    const auto option =
        std::find_if(kOptions.begin(), kOptions.end(), [&wanted = name](const auto& o) { return wanted == o.name; });
    if (option == kOptions.end()) return invalid(where + " is not a setting; tind --print-config shows them all");
    const bool wants_text = std::holds_alternative<std::string Settings::*>(option->member);
    if (wants_text != value.is_string() || (!wants_text && !value.is_number_integer())) {
      return invalid(
          wants_text ? where + " is not a string"
                     : fmt::format("{} is not a whole number from {} to {}", where, option->minimum, option->maximum));
    }
    const std::string text = wants_text ? value.get<std::string>() : value.dump();
    if (auto set = set_option(base, *option, text, where); !set) return tl::unexpected(set.error());
  }
  return base;
}

std::string print_settings(const Settings& settings, const std::map<std::string, std::string>* origins) {
  using nlohmann::ordered_json;
  ordered_json root = ordered_json::object();
  const auto put = [&](const std::string& name, ordered_json value) {
    if (!origins) {
      root[name] = std::move(value);
      return;
    }
    const auto from = origins->find(name);
    root[name] = {{"value", std::move(value)}, {"from", from == origins->end() ? "default" : from->second}};
  };
  ordered_json datasets = ordered_json::array();
  for (const DatasetSpec& spec : settings.datasets) datasets.push_back(dataset_to_json(spec));
  put("datasets", std::move(datasets));
  for (const OptionSpec& option : kOptions) {
    if (const auto* text = std::get_if<std::string Settings::*>(&option.member)) {
      put(option.name, settings.**text);
    } else {
      put(option.name, settings.*std::get<int Settings::*>(option.member));
    }
  }
  // Paths are bytes; what is not UTF-8 cannot be said in JSON.
  return root.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

std::vector<std::string> json_members(std::string_view json) {
  const nlohmann::json root = nlohmann::json::parse(json, nullptr, false);
  std::vector<std::string> members;
  if (!root.is_object()) return members;
  for (const auto& [name, value] : root.items()) members.push_back(name);
  return members;
}

Result<Settings> overlay_environment(Settings base, const Environment& environment) {
  if (const auto paths = environment("TIND_DATASETS"); paths && !paths->empty()) {
    base.datasets.clear();
    for (std::size_t at = 0; at <= paths->size();) {
      const std::size_t end = std::min(paths->find(':', at), paths->size());
      if (end > at) base.datasets.emplace_back(paths->substr(at, end - at));
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
