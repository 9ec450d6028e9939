// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/conditions.hpp"

#include <algorithm>
#include <charconv>
#include <ctime>

#include "server/http_date.hpp"
#include "server/negotiation.hpp"

namespace tind {
namespace {

std::optional<std::int64_t> date_of(const std::optional<std::string_view>& field) {
  return field ? parse_http_date(*field, std::time(nullptr)) : std::nullopt;
}

// All digits; nullopt when there are none or other bytes. What does not fit is as large as can be.
std::optional<std::uint64_t> digits(std::string_view text) {
  if (text.empty() || !std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; })) {
    return std::nullopt;
  }
  std::uint64_t value = 0;
  const auto error = std::from_chars(text.data(), text.data() + text.size(), value).ec;
  return error == std::errc() ? value : UINT64_MAX;
}

// Strong comparison: a weak tag matches nothing, a date must be the very one.
bool if_range_holds(std::string_view field, const Validators& validators) {
  if (field.starts_with('"') || field.starts_with("W/")) return field == validators.etag;
  const auto date = date_of(field);
  return date && date == validators.last_modified;
}

}  // namespace

Condition evaluate_conditions(const Request& request, const Validators& validators) {
  const auto& last_modified = validators.last_modified;
  if (const auto& tags = request[RequestField::kIfMatch]) {
    if (!etag_matches(*tags, validators.etag, EtagComparison::kStrong)) return Condition::kFailed;
  } else if (const auto date = date_of(request[RequestField::kIfUnmodifiedSince]); date && last_modified) {
    if (*last_modified > *date) return Condition::kFailed;
  }
  if (const auto& tags = request[RequestField::kIfNoneMatch]) {
    if (etag_matches(*tags, validators.etag)) return Condition::kNotModified;
  } else if (const auto date = date_of(request[RequestField::kIfModifiedSince]); date && last_modified) {
    if (*last_modified <= *date) return Condition::kNotModified;
  }
  return Condition::kProceed;
}

std::optional<ByteRange> choose_range(const Request& request, const Validators& validators, std::uint64_t total) {
  const auto& field = request[RequestField::kRange];
  if (!field) return std::nullopt;
  if (const auto& condition = request[RequestField::kIfRange]; condition && !if_range_holds(*condition, validators)) {
    return std::nullopt;
  }
  constexpr std::string_view kUnit = "bytes=";
  const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + ('a' - 'A')) : c; };
  if (field->size() < kUnit.size() ||
      !std::equal(kUnit.begin(), kUnit.end(), field->begin(), [&](char a, char b) { return a == lower(b); })) {
    return std::nullopt;
  }
  const std::string_view set = field->substr(kUnit.size());
  const std::size_t dash = set.find('-');
  if (dash == set.npos) return std::nullopt;
  const auto first = digits(set.substr(0, dash)), last = digits(set.substr(dash + 1));
  if ((dash > 0 && !first) || (dash + 1 < set.size() && !last) || (!first && !last)) return std::nullopt;
  if (!first) {  // the last so many
    const std::uint64_t length = std::min(*last, total);
    return ByteRange{total - length, length};
  }
  if (last && *last < *first) return std::nullopt;
  if (*first >= total) return ByteRange{};
  return ByteRange{*first, std::min(last.value_or(UINT64_MAX), total - 1) - *first + 1};
}

}  // namespace tind
