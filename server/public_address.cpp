// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/public_address.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>

namespace tind {
namespace {

constexpr std::size_t kMaxPartBytes = 255;

std::string_view trim(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

std::string_view first_of(std::string_view list, char separator) {
  return trim(list.substr(0, std::min(list.find(separator), list.size())));
}

bool is_plain(std::string_view text, std::string_view also) {
  return text.size() <= kMaxPartBytes && std::all_of(text.begin(), text.end(), [&](char c) {
           return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                  also.find(c) != also.npos;
         });
}

bool is_scheme(std::string_view text) { return text == "http" || text == "https"; }
bool is_host(std::string_view text) { return !text.empty() && is_plain(text, "-._:[]"); }
bool is_prefix(std::string_view text) { return text.empty() || (text[0] == '/' && is_plain(text, "-._~/%")); }

// The value of a parameter of the first element of Forwarded, quotes taken off.
std::string_view forwarded_value(std::string_view forwarded, std::string_view name) {
  std::string_view element = first_of(forwarded, ',');
  while (!element.empty()) {
    const std::string_view pair = first_of(element, ';');
    const std::size_t equals = std::min(pair.find('='), pair.size());
    const bool same =
        std::equal(name.begin(), name.end(), pair.begin(), pair.begin() + static_cast<std::ptrdiff_t>(equals),
                   [](char a, char b) { return a == (b >= 'A' && b <= 'Z' ? b + ('a' - 'A') : b); });
    if (same && equals < pair.size()) {
      std::string_view value = pair.substr(equals + 1);
      if (value.size() >= 2 && value.front() == '"' && value.back() == '"') value = value.substr(1, value.size() - 2);
      return value;
    }
    element.remove_prefix(std::min(element.find(';'), element.size()));
    if (!element.empty()) element.remove_prefix(1);
  }
  return {};
}

}  // namespace

PublicAddress::PublicAddress(const Settings& settings)
    : public_url_(settings.public_url), trust_proxy_(settings.trust_proxy == "on") {
  while (public_url_.ends_with('/')) public_url_.pop_back();
}

std::string PublicAddress::base_for(const Request& request) const {
  if (!depends_on_request()) return public_url_;
  std::string_view scheme, host, prefix;
  if (const auto& forwarded = request[RequestField::kForwarded]) {
    scheme = forwarded_value(*forwarded, "proto");
    host = forwarded_value(*forwarded, "host");
  } else {
    const auto first = [&](RequestField field) { return first_of(request[field].value_or(std::string_view()), ','); };
    scheme = first(RequestField::kForwardedProto);
    host = first(RequestField::kForwardedHost);
  }
  prefix = first_of(request[RequestField::kForwardedPrefix].value_or(std::string_view()), ',');
  while (prefix.ends_with('/')) prefix.remove_suffix(1);
  if (scheme.empty()) scheme = "http";
  if (!is_scheme(scheme) || !is_host(host) || !is_prefix(prefix)) return {};
  std::string base(scheme);
  return base.append("://").append(host).append(prefix);
}

std::string absolute_layer(const std::string& layer_json, const std::string& base, const std::string& name) {
  auto layer = nlohmann::ordered_json::parse(layer_json, nullptr, false);
  if (!layer.is_object() || !layer.contains("tiles")) return layer_json;
  for (auto& tile : layer["tiles"]) {
    if (tile.is_string()) tile = base + "/" + name + "/" + tile.get<std::string>();
  }
  return layer.dump();
}

std::string absolute_list(const std::string& list_json, const std::string& base) {
  auto page = nlohmann::ordered_json::parse(list_json, nullptr, false);
  if (!page.is_object() || !page.contains("datasets")) return list_json;
  const auto make_absolute = [&](nlohmann::ordered_json& link) {
    if (link.is_string()) link = base + "/" + link.get<std::string>();
  };
  for (auto& dataset : page["datasets"]) {
    for (auto& link : dataset["links"]) make_absolute(link);
  }
  if (page.contains("next")) make_absolute(page["next"]);
  return page.dump();
}

}  // namespace tind
