// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http_date.hpp"

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>

namespace tind {
namespace {

using namespace std::chrono;

constexpr std::array<std::string_view, 12> kMonths = {"Jan", "Feb", "Mar", "Apr", "May", "Jun",
                                                      "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"};
constexpr std::array<std::string_view, 7> kDays = {"Sunday",   "Monday", "Tuesday", "Wednesday",
                                                   "Thursday", "Friday", "Saturday"};
constexpr int kSecondsPerDay = 86400;

// Takes a date apart from its front; the first thing that does not fit sticks.
class Reader {
 public:
  explicit Reader(std::string_view text) : rest_(text) {}

  bool skip(std::string_view expected) {
    if (!rest_.starts_with(expected)) return ok_ = false;
    rest_.remove_prefix(expected.size());
    return true;
  }
  // Exactly `n_digits`, the first of which may be a blank where `padded`.
  int number(std::size_t n_digits, bool padded = false) {
    int value = 0;
    for (std::size_t k = 0; k < n_digits; ++k) {
      const char c = k < rest_.size() ? rest_[k] : '\0';
      if (padded && k == 0 && c == ' ') continue;
      if (c < '0' || c > '9') ok_ = false;
      value = value * 10 + (c - '0');
    }
    rest_.remove_prefix(std::min(n_digits, rest_.size()));
    return ok_ ? value : 0;
  }
  unsigned month() {
    const auto found = std::find(kMonths.begin(), kMonths.end(), rest_.substr(0, 3));
    if (found == kMonths.end()) ok_ = false;
    rest_.remove_prefix(std::min<std::size_t>(3, rest_.size()));
    return ok_ ? static_cast<unsigned>(found - kMonths.begin()) + 1 : 0;
  }
  // Seconds since midnight.
  int time() {
    const int hour = number(2);
    skip(":");
    const int minute = number(2);
    skip(":");
    const int second = number(2);
    if (hour > 23 || minute > 59 || second > 60) ok_ = false;
    return (hour * 60 + minute) * 60 + second;
  }
  bool ok() const { return ok_ && rest_.empty(); }

 private:
  std::string_view rest_;
  bool ok_ = true;
};

std::optional<std::int64_t> seconds_of(int year, unsigned month, int day, int second) {
  const year_month_day date{std::chrono::year(year), std::chrono::month(month),
                            std::chrono::day(static_cast<unsigned>(day))};
  if (!date.ok()) return std::nullopt;
  return std::int64_t{sys_days(date).time_since_epoch().count()} * kSecondsPerDay + second;
}

}  // namespace

std::string format_http_date(std::int64_t seconds) {
  const sys_seconds time{std::chrono::seconds(seconds)};
  const auto day = floor<days>(time);
  const year_month_day date(day);
  const auto second = static_cast<int>((time - day).count());
  std::array<char, 64> text;
  const int n = std::snprintf(text.data(), text.size(), "%.3s, %02u %s %04d %02d:%02d:%02d GMT",
                              kDays[weekday(day).c_encoding()].data(), static_cast<unsigned>(date.day()),
                              kMonths[static_cast<unsigned>(date.month()) - 1].data(), static_cast<int>(date.year()),
                              second / 3600, second / 60 % 60, second % 60);
  return {text.data(), static_cast<std::size_t>(n)};
}

std::optional<std::int64_t> parse_http_date(std::string_view text, std::int64_t now) {
  const auto day_name = std::find_if(kDays.begin(), kDays.end(),
                                     [&](std::string_view name) { return text.starts_with(name.substr(0, 3)); });
  if (day_name == kDays.end()) return std::nullopt;
  Reader in(text);
  int year = 0, day = 0, second = 0;
  unsigned month = 0;
  if (text.substr(3).starts_with(", ")) {  // Sun, 06 Nov 1994 08:49:37 GMT
    in.skip(text.substr(0, 5));
    day = in.number(2);
    in.skip(" ");
    month = in.month();
    in.skip(" ");
    year = in.number(4);
    in.skip(" ");
    second = in.time();
    in.skip(" GMT");
  } else if (text.starts_with(*day_name)) {  // Sunday, 06-Nov-94 08:49:37 GMT
    in.skip(*day_name);
    in.skip(", ");
    day = in.number(2);
    in.skip("-");
    month = in.month();
    in.skip("-");
    const int this_year = static_cast<int>(year_month_day(floor<days>(sys_seconds(seconds(now)))).year());
    year = in.number(2) + this_year / 100 * 100;
    if (year > this_year + 50) year -= 100;  // more than 50 years ahead is the past
    in.skip(" ");
    second = in.time();
    in.skip(" GMT");
  } else {  // Sun Nov  6 08:49:37 1994
    in.skip(text.substr(0, 3));
    in.skip(" ");
    month = in.month();
    in.skip(" ");
    day = in.number(2, true);
    in.skip(" ");
    second = in.time();
    in.skip(" ");
    year = in.number(4);
  }
  if (!in.ok()) return std::nullopt;
  return seconds_of(year, month, day, second);
}

}  // namespace tind
