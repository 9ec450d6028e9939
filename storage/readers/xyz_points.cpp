// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/xyz_points.hpp"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <initializer_list>
#include <optional>

#include <fmt/format.h>

namespace tind {
namespace {

constexpr std::size_t kBufferBytes = std::size_t{1} << 20;
constexpr std::size_t kMaxLineBytes = std::size_t{1} << 16;
/// Bytes of a broken field that a message shows.
constexpr std::size_t kShownBytes = 24;

bool is_blank(char c) { return c == ' ' || c == '\t' || c == '\r'; }

std::string_view trim(std::string_view text) {
  while (!text.empty() && is_blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && is_blank(text.back())) text.remove_suffix(1);
  if (text.size() >= 2 && text.front() == '"' && text.back() == '"') text = text.substr(1, text.size() - 2);
  return text;
}

std::optional<double> to_number(std::string_view text) {
  text = trim(text);
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (end != text.data() + text.size() || error != std::errc() || text.empty()) return std::nullopt;
  return value;
}

bool is_one_of(std::string_view text, std::initializer_list<const char*> names) {
  std::string lower;
  for (const char c : trim(text)) lower += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return std::any_of(names.begin(), names.end(), [&](const char* n) { return lower == n; });
}

/// What a message may show of untrusted text.
std::string shown(std::string_view text) {
  std::string out;
  for (const char c : text.substr(0, kShownBytes)) out += c >= ' ' && c < 127 ? c : '?';
  return text.size() > kShownBytes ? out + "..." : out;
}

}  // namespace

tl::unexpected<Error> XyzReader::bad_line(const std::string& what) const {
  return fail(ErrorKind::kInvalidInput, fmt::format("{}: line {}: {}", path_, line_number_, what));
}

Result<bool> XyzReader::next_line(std::string_view& line) {
  for (std::size_t searched = begin_;;) {
    const auto newline = std::find(buffer_.begin() + static_cast<std::ptrdiff_t>(searched), buffer_.end(), '\n');
    const auto end = static_cast<std::size_t>(newline - buffer_.begin());
    const bool complete = newline != buffer_.end() || next_offset_ == bytes_->size();
    if (end - begin_ > kMaxLineBytes) {
      ++line_number_;
      return bad_line(fmt::format("is longer than {} bytes: not a file of points as text", kMaxLineBytes));
    }
    if (complete) {
      if (begin_ == buffer_.size()) return false;
      line = {reinterpret_cast<const char*>(buffer_.data()) + begin_, end - begin_};
      begin_ = std::min(end + 1, buffer_.size());
      ++line_number_;
      return true;
    }
    buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(begin_));
    begin_ = 0;
    searched = buffer_.size();
    const std::size_t n = std::min<std::uint64_t>(kBufferBytes, bytes_->size() - next_offset_);
    buffer_.resize(searched + n);
    if (!bytes_->read(next_offset_, std::span(buffer_).subspan(searched))) {
      return fail(ErrorKind::kIo, fmt::format("{}: reading at byte {} failed", path_, next_offset_));
    }
    next_offset_ += n;
  }
}

Result<bool> XyzReader::next_data_line(std::string_view& line) {
  for (;;) {
    auto more = next_line(line);
    if (!more || !*more) return more;
    if (line_number_ == 1 && line.substr(0, 3) == "\xef\xbb\xbf") line.remove_prefix(3);
    const std::string_view text = trim(line);
    if (!text.empty() && text.front() != '#') return true;
  }
}

void XyzReader::split(std::string_view line) {
  fields_.clear();
  if (separator_ == ' ') {
    for (std::size_t at = 0; at < line.size();) {
      while (at < line.size() && is_blank(line[at])) ++at;
      std::size_t end = at;
      while (end < line.size() && !is_blank(line[end])) ++end;
      if (end > at) fields_.push_back(line.substr(at, end - at));
      at = end;
    }
    return;
  }
  for (std::size_t at = 0;;) {
    const std::size_t end = std::min(line.find(separator_, at), line.size());
    fields_.push_back(line.substr(at, end - at));
    if (end == line.size()) return;
    at = end + 1;
  }
}

Result<XyzReader> XyzReader::open(ByteSource& bytes, const std::string& path) {
  XyzReader reader(bytes, path);
  if (auto ok = reader.read_header(); !ok) return tl::unexpected(ok.error());
  return reader;
}

Result<void> XyzReader::read_header() {
  std::string_view line;
  auto more = next_data_line(line);
  if (!more) return tl::unexpected(more.error());
  if (!*more) return fail(ErrorKind::kInvalidInput, fmt::format("{}: holds no line with a point", path_));
  separator_ = ' ';
  for (const char c : {';', '\t', ','}) {
    if (separator_ == ' ' && trim(line).find(c) != std::string_view::npos) separator_ = c;
  }
  split(line);
  const auto is_number = [](std::string_view field) { return to_number(field).has_value(); };
  if (std::any_of(fields_.begin(), fields_.end(), is_number)) {
    pending_ = true;
    return {};
  }
  constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  columns_ = {kNone, kNone, kNone};
  for (std::size_t i = 0; i < fields_.size(); ++i) {
    const std::string_view name = fields_[i];
    const auto take = [&](std::size_t which) {
      if (columns_[which] == kNone) columns_[which] = i;
    };
    if (is_one_of(name, {"x", "lon", "long", "longitude", "lng", "easting", "east", "e"})) {
      take(0);
    } else if (is_one_of(name, {"y", "lat", "latitude", "northing", "north", "n"})) {
      take(1);
    } else if (is_one_of(name, {"z", "height", "elevation", "elev", "altitude", "alt", "h"})) {
      take(2);
    }
  }
  if (std::find(columns_.begin(), columns_.end(), kNone) != columns_.end()) {
    return bad_line(fmt::format(
        "\"{}\" is neither three numbers nor a header that names x, y and z (or lon, lat, height)", shown(trim(line))));
  }
  return {};
}

Result<XyzPoint> XyzReader::parse() const {
  std::array<double, 3> values{};
  for (std::size_t i = 0; i < 3; ++i) {
    if (columns_[i] >= fields_.size()) {
      return bad_line(fmt::format("has {} columns, at least {} are needed (x, y, z)", fields_.size(),
                                  *std::max_element(columns_.begin(), columns_.end()) + 1));
    }
    const auto number = to_number(fields_[columns_[i]]);
    if (!number) return bad_line(fmt::format("{} is not a number: \"{}\"", "xyz"[i], shown(fields_[columns_[i]])));
    values[i] = *number;
  }
  return XyzPoint{values[0], values[1], values[2]};
}

Result<bool> XyzReader::next(std::size_t n_most, std::vector<XyzPoint>& points) {
  for (std::size_t i = 0; i < n_most; ++i) {
    if (!pending_) {
      std::string_view line;
      auto more = next_data_line(line);
      if (!more || !*more) return more;
      split(line);
    }
    pending_ = false;
    auto point = parse();
    if (!point) return tl::unexpected(point.error());
    points.push_back(*point);
  }
  return true;
}

}  // namespace tind
