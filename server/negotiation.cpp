// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/negotiation.hpp"

#include <algorithm>
#include <array>

namespace tind {
namespace {

std::string_view trim(std::string_view text) {
  const auto first = text.find_first_not_of(" \t");
  if (first == text.npos) return {};
  return text.substr(first, text.find_last_not_of(" \t") - first + 1);
}

bool equals_ignoring_case(std::string_view a, std::string_view lower) {
  return std::equal(a.begin(), a.end(), lower.begin(), lower.end(),
                    [](char x, char y) { return (x >= 'A' && x <= 'Z' ? static_cast<char>(x + 32) : x) == y; });
}

// Cuts `list` before its first separator, removes that part from it and returns it trimmed.
std::string_view take(std::string_view& list, char separator) {
  const std::size_t end = std::min(list.find(separator), list.size());
  const std::string_view part = trim(list.substr(0, end));
  list.remove_prefix(std::min(end + 1, list.size()));
  return part;
}

// q-value in thousandths; 0 when malformed, so that a broken wish is no wish.
int parse_q(std::string_view text) {
  if (text.empty() || (text[0] != '0' && text[0] != '1') || text.size() > 5) return 0;
  int value = text[0] == '1' ? 1000 : 0;
  if (text.size() > 1 && text[1] != '.') return 0;
  int scale = 100;
  for (std::size_t i = 2; i < text.size(); ++i, scale /= 10) {
    if (text[i] < '0' || text[i] > '9') return 0;
    value += (text[i] - '0') * scale;
  }
  return std::min(value, 1000);
}

bool names_normals(std::string_view extensions) {
  while (!extensions.empty()) {
    if (take(extensions, '-') == "octvertexnormals") return true;
  }
  return false;
}

}  // namespace

Coding choose_coding(std::optional<std::string_view> accept_encoding) {
  if (!accept_encoding) return Coding::kIdentity;
  constexpr int kNotNamed = -1;
  std::array<int, 3> q = {kNotNamed, kNotNamed, kNotNamed};  // by Coding
  int any = kNotNamed;
  for (std::string_view list = *accept_encoding; !list.empty();) {
    std::string_view element = take(list, ',');
    const std::string_view coding = take(element, ';');
    int quality = 1000;
    while (!element.empty()) {
      std::string_view parameter = take(element, ';');
      const std::string_view name = take(parameter, '=');
      if (equals_ignoring_case(name, "q")) quality = parse_q(trim(parameter));
    }
    if (equals_ignoring_case(coding, "zstd")) q[2] = quality;
    if (equals_ignoring_case(coding, "gzip") || equals_ignoring_case(coding, "x-gzip")) q[1] = quality;
    if (equals_ignoring_case(coding, "identity")) q[0] = quality;
    if (coding == "*") any = quality;
  }
  for (std::size_t c = 1; c < 3; ++c) {
    if (q[c] == kNotNamed) q[c] = std::max(any, 0);
  }
  // Not named, identity is acceptable, but what the client named is what it wants.
  if (q[0] == kNotNamed) q[0] = any == 0 ? 0 : 1;
  Coding best = Coding::kIdentity;
  int best_q = q[0];
  for (const Coding coding : {Coding::kGzip, Coding::kZstd}) {
    const int value = q[static_cast<std::size_t>(coding)];
    if (value > 0 && value >= best_q) {
      best = coding;
      best_q = value;
    }
  }
  return best;
}

bool etag_matches(std::string_view list, std::string_view etag, EtagComparison comparison) {
  if (trim(list) == "*") return true;
  // A tag may hold a comma, so walk the quotes.
  for (std::string_view rest = list; !rest.empty();) {
    const auto open = rest.find('"');
    if (open == rest.npos) return false;
    const auto close = rest.find('"', open + 1);
    if (close == rest.npos) return false;
    const bool is_weak = rest.substr(0, open).ends_with("W/");
    if ((!is_weak || comparison == EtagComparison::kWeak) && rest.substr(open, close - open + 1) == etag) return true;
    rest.remove_prefix(close + 1);
  }
  return false;
}

bool wants_normals(std::optional<std::string_view> accept, std::optional<std::string_view> query_extensions) {
  if (query_extensions && names_normals(*query_extensions)) return true;
  if (!accept) return false;
  for (std::string_view list = *accept; !list.empty();) {
    std::string_view element = take(list, ',');
    if (!equals_ignoring_case(take(element, ';'), "application/vnd.quantized-mesh")) continue;
    while (!element.empty()) {
      std::string_view parameter = take(element, ';');
      if (!equals_ignoring_case(take(parameter, '='), "extensions")) continue;
      std::string_view value = trim(parameter);
      if (value.size() >= 2 && value.front() == '"' && value.back() == '"') value = value.substr(1, value.size() - 2);
      if (names_normals(value)) return true;
    }
  }
  return false;
}

}  // namespace tind
