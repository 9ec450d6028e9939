// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/conditions.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "server/http_date.hpp"

namespace tind {
namespace {

constexpr std::int64_t kThen = 784111777;  // Sun, 06 Nov 1994 08:49:37 GMT
constexpr std::int64_t kNow = 1795000000;  // 2026
const Validators kValidators{"\"abc-p\"", kThen};

using Fields = std::vector<std::pair<RequestField, std::string_view>>;

Request request_with(const Fields& fields) {
  Request request{"GET", "/", {}};
  for (const auto& [field, value] : fields) request[field] = value;
  return request;
}
Condition evaluate(const Fields& fields, const Validators& validators = kValidators) {
  return evaluate_conditions(request_with(fields), validators);
}

TEST(HttpDate, ReadsAllThreeForms) {
  for (const char* text :
       {"Sun, 06 Nov 1994 08:49:37 GMT", "Sunday, 06-Nov-94 08:49:37 GMT", "Sun Nov  6 08:49:37 1994"}) {
    EXPECT_EQ(parse_http_date(text, kNow), kThen) << text;
  }
  EXPECT_EQ(format_http_date(kThen), "Sun, 06 Nov 1994 08:49:37 GMT");
  for (const std::int64_t time : {std::int64_t{0}, std::int64_t{951782399}, std::int64_t{951868800}, kNow}) {
    EXPECT_EQ(parse_http_date(format_http_date(time), kNow), time);
  }
}

TEST(HttpDate, TwoDigitYearsAreNotFarAhead) {
  EXPECT_EQ(parse_http_date("Tuesday, 01-Jan-30 00:00:00 GMT", kNow),
            parse_http_date("Tue, 01 Jan 2030 00:00:00 GMT", kNow));
  EXPECT_EQ(parse_http_date("Friday, 01-Jan-99 00:00:00 GMT", kNow),
            parse_http_date("Fri, 01 Jan 1999 00:00:00 GMT", kNow));
}

TEST(HttpDate, RefusesWhatIsNone) {
  for (const char* text :
       {"", "now", "Sun", "Sun, ", "Sun, 06 Nov 1994", "Sun, 06 Nov 1994 08:49:37", "Sun, 06 Nov 1994 08:49:37 CET",
        "Sun, 31 Feb 1994 08:49:37 GMT", "Sun, 06 Nov 1994 24:00:00 GMT", "Sun, 06 Nov 1994 08:60:37 GMT",
        "Sun, 6 Nov 1994 08:49:37 GMT", "Sun, 06 nov 1994 08:49:37 GMT", "Sun, 06 Nov 1994 08:49:37 GMT ",
        "Sun Nov 06 08:49:37 94", "Sunday, 06-Nov-1994 08:49:37 GMT", "784111777", "Sun, -6 Nov 1994 08:49:37 GMT"}) {
    EXPECT_EQ(parse_http_date(text, kNow), std::nullopt) << text;
  }
}

TEST(Conditions, TagsAreComparedWeaklyOrStrongly) {
  using enum RequestField;
  EXPECT_EQ(evaluate({}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfNoneMatch, "\"abc-p\""}}), Condition::kNotModified);
  EXPECT_EQ(evaluate({{kIfNoneMatch, "W/\"abc-p\""}}), Condition::kNotModified);
  EXPECT_EQ(evaluate({{kIfNoneMatch, "\"x\", \"abc-p\""}}), Condition::kNotModified);
  EXPECT_EQ(evaluate({{kIfNoneMatch, "*"}}), Condition::kNotModified);
  EXPECT_EQ(evaluate({{kIfNoneMatch, "\"abc-pz\""}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfNoneMatch, "abc-p"}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfMatch, "\"abc-p\""}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfMatch, "*"}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfMatch, "W/\"abc-p\""}}), Condition::kFailed);
  EXPECT_EQ(evaluate({{kIfMatch, "\"x\""}}), Condition::kFailed);
}

TEST(Conditions, DatesCountWhereNoTagIsGiven) {
  using enum RequestField;
  const std::string same = format_http_date(kThen), before = format_http_date(kThen - 1),
                    after = format_http_date(kThen + 1);
  EXPECT_EQ(evaluate({{kIfModifiedSince, same}}), Condition::kNotModified);
  EXPECT_EQ(evaluate({{kIfModifiedSince, after}}), Condition::kNotModified);
  EXPECT_EQ(evaluate({{kIfModifiedSince, before}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfModifiedSince, "yesterday"}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfModifiedSince, after}}, {"\"abc-p\"", std::nullopt}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfUnmodifiedSince, before}}), Condition::kFailed);
  EXPECT_EQ(evaluate({{kIfUnmodifiedSince, same}}), Condition::kProceed);
  // RFC 9110, 13.2.2
  EXPECT_EQ(evaluate({{kIfNoneMatch, "\"x\""}, {kIfModifiedSince, after}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfMatch, "\"abc-p\""}, {kIfUnmodifiedSince, before}}), Condition::kProceed);
  EXPECT_EQ(evaluate({{kIfMatch, "\"x\""}, {kIfNoneMatch, "\"abc-p\""}}), Condition::kFailed);
  EXPECT_EQ(evaluate({{kIfMatch, "*"}, {kIfNoneMatch, "\"abc-p\""}}), Condition::kNotModified);
}

TEST(Ranges, OneRangeOfBytesIsTaken) {
  using enum RequestField;
  const struct {
    const char* field;
    std::uint64_t first, length;
  } taken[] = {{"bytes=0-0", 0, 1},   {"bytes=2-5", 2, 4},
               {"bytes=5-", 5, 5},    {"bytes=9-9", 9, 1},
               {"bytes=8-100", 8, 2}, {"bytes=-3", 7, 3},
               {"bytes=-10", 0, 10},  {"bytes=-99", 0, 10},
               {"BYTES=1-1", 1, 1},   {"bytes=0-18446744073709551616", 0, 10}};
  for (const auto& c : taken) {
    const auto range = choose_range(request_with({{kRange, c.field}}), kValidators, 10);
    ASSERT_TRUE(range.has_value()) << c.field;
    EXPECT_EQ(range->first, c.first) << c.field;
    EXPECT_EQ(range->length, c.length) << c.field;
  }
  for (const char* outside : {"bytes=10-", "bytes=10-12", "bytes=-0", "bytes=99999999999999999999-"}) {
    const auto range = choose_range(request_with({{kRange, outside}}), kValidators, 10);
    ASSERT_TRUE(range.has_value()) << outside;
    EXPECT_EQ(range->length, 0u) << outside;
  }
  for (const char* ignored : {"", "bytes", "bytes=", "bytes=-", "bytes=5-2", "bytes=a-b", "bytes=1-2,4-5", "lines=1-2",
                              "bytes=1", "bytes= 1-2", "bytes=+1-2", "bytes=1-2x"}) {
    EXPECT_EQ(choose_range(request_with({{kRange, ignored}}), kValidators, 10), std::nullopt) << ignored;
  }
  EXPECT_EQ(choose_range(request_with({}), kValidators, 10), std::nullopt);
}

TEST(Ranges, IfRangeMustNameTheVeryRepresentation) {
  using enum RequestField;
  const std::string same = format_http_date(kThen), after = format_http_date(kThen + 1);
  const auto takes = [&](std::string_view condition) {
    return choose_range(request_with({{kRange, "bytes=0-1"}, {kIfRange, condition}}), kValidators, 10).has_value();
  };
  EXPECT_TRUE(takes("\"abc-p\""));
  EXPECT_TRUE(takes(same));
  EXPECT_FALSE(takes("W/\"abc-p\""));
  EXPECT_FALSE(takes("\"x\""));
  EXPECT_FALSE(takes(after));
  EXPECT_FALSE(takes("nonsense"));
}

}  // namespace
}  // namespace tind
