// SPDX-License-Identifier: GPL-3.0-or-later
// The client's own LAS reader: every version and point format, and files that lie.
#include "tests/client/las_points.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "tests/client_checks/las_bytes.hpp"

namespace tind::client {
namespace {

using test::las_bytes;
using test::LasPlan;
using test::poke;
using testing::ElementsAre;
using testing::HasSubstr;

ClassFilter only(std::initializer_list<std::size_t> classes) {
  ClassFilter filter;
  for (const std::size_t c : classes) filter.set(c);
  return filter;
}

Outcome<LasPoints> read_bytes(const Blob& bytes, const ClassFilter& classes = only({2})) {
  const auto read = [&](std::uint64_t offset, std::size_t n) {
    if (offset >= bytes.size()) return Blob{};
    const auto first = bytes.begin() + static_cast<std::ptrdiff_t>(offset);
    return Blob(first,
                first + static_cast<std::ptrdiff_t>(std::min(n, bytes.size() - static_cast<std::size_t>(offset))));
  };
  return read_las(read, bytes.size(), classes);
}

LasPlan three_points() {
  LasPlan plan;
  plan.x_offset = 500000;
  plan.y_offset = 4e6;
  plan.z_offset = -10;
  plan.points = {
      {500001.5, 4000002.25, 33.125, 2, false}, {500003, 4000004, 35, 5, false}, {500005, 4000006, 36, 2, true}};
  return plan;
}

TEST(LasPoints, EveryVersionAndPointFormatIsRead) {
  for (int minor = 0; minor <= 4; ++minor) {
    for (std::uint8_t format = 0; format <= 10; ++format) {
      if (format >= 6 && minor < 4) continue;
      for (const std::uint16_t extra : {std::uint16_t{0}, std::uint16_t{7}}) {
        LasPlan plan = three_points();
        plan.minor = minor;
        plan.format = format;
        plan.extra_bytes = extra;
        const auto las = read_bytes(las_bytes(plan));
        const auto which = testing::Message() << "1." << minor << " format " << int{format} << " + " << extra;
        ASSERT_TRUE(las.has_value()) << which << ": " << las.error();
        ASSERT_EQ(las->x.size(), 1u) << which << ": one of class 2, one of class 5, one withheld";
        EXPECT_NEAR(las->x[0], 500001.5, 1e-6) << which;
        EXPECT_NEAR(las->y[0], 4000002.25, 1e-6) << which;
        EXPECT_NEAR(las->z[0], 33.125, 1e-6) << which;
        EXPECT_EQ(las->n_withheld, 1u) << which;
        EXPECT_EQ(las->n_of_class[5], 1u) << which;
      }
    }
  }
}

TEST(LasPoints, ClassesBeyondFiveBitsAreReadInTheNewFormatsOnly) {
  LasPlan plan = three_points();
  plan.minor = 4;
  plan.format = 6;
  plan.points[1].classification = 64 + 2;
  const auto las = read_bytes(las_bytes(plan), only({66}));
  ASSERT_TRUE(las.has_value()) << las.error();
  EXPECT_EQ(las->x.size(), 1u);
  plan.format = 1;
  plan.points[1].classification = 2;
  const auto old = read_bytes(las_bytes(plan), only({2, 66}));
  ASSERT_TRUE(old.has_value());
  EXPECT_EQ(old->x.size(), 2u);
}

TEST(LasPoints, ProjectionRecordsAreFoundBeforeAndBehindThePoints) {
  LasPlan plan = three_points();
  plan.minor = 4;
  test::LasRecord foreign = test::text_record(2112, "not this one");
  foreign.user = "liblas";
  plan.records = {test::shorts_record({1, 1, 0, 1, 3072, 0, 1, 2949}), foreign, test::doubles_record({1.5, -2})};
  plan.extended_records = {test::text_record(2112, "PROJCS[...]")};
  const auto las = read_bytes(las_bytes(plan));
  ASSERT_TRUE(las.has_value()) << las.error();
  EXPECT_EQ(las->wkt, "PROJCS[...]");
  EXPECT_THAT(las->keys.directory, ElementsAre(1, 1, 0, 1, 3072, 0, 1, 2949));
  EXPECT_THAT(las->keys.doubles, ElementsAre(1.5, -2));
}

TEST(LasPoints, ClassesAreDescribedWithTheirCounts) {
  const auto las = read_bytes(las_bytes(three_points()), only({9}));
  ASSERT_TRUE(las.has_value());
  EXPECT_TRUE(las->x.empty());
  EXPECT_THAT(describe_classes(*las), HasSubstr("2 (1), 5 (1)"));
  EXPECT_THAT(describe_classes(*las), HasSubstr("--class"));
}

TEST(LasPoints, RefusesFilesThatLie) {
  LasPlan plan = three_points();
  plan.minor = 4;
  plan.records = {test::text_record(2112, "PROJCS")};
  plan.extended_records = {test::text_record(2112, "PROJCS")};
  const Blob good = las_bytes(plan);
  ASSERT_TRUE(read_bytes(good).has_value());
  const auto refusal = [&](auto&& damage) {
    Blob bytes = good;
    damage(bytes);
    const auto las = read_bytes(bytes);
    return las ? std::string("was read") : las.error();
  };
  EXPECT_THAT(refusal([](Blob& b) { b[0] = 'X'; }), HasSubstr("no LAS file"));
  EXPECT_THAT(refusal([](Blob& b) { b.resize(3); }), HasSubstr("no LAS file"));
  EXPECT_THAT(refusal([](Blob& b) { b.resize(100); }), HasSubstr("inside its header"));
  EXPECT_THAT(refusal([](Blob& b) { b.resize(240); }), HasSubstr("inside its header"));
  EXPECT_THAT(refusal([](Blob& b) { b[24] = 2; }), HasSubstr("LAS 2.4"));
  EXPECT_THAT(refusal([](Blob& b) { b[25] = 5; }), HasSubstr("LAS 1.5"));
  EXPECT_THAT(refusal([](Blob& b) { b[104] = 11; }), HasSubstr("point format 11"));
  EXPECT_THAT(refusal([](Blob& b) { b[104] = 0x80; }), HasSubstr("LAZ"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 105, std::uint16_t{19}); }), HasSubstr("needs 20"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 94, std::uint16_t{227}); }), HasSubstr("needs 375"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 96, std::uint32_t{100}); }), HasSubstr("start at byte 100"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 96, 0xffffffffu); }), HasSubstr("start at byte"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 247, std::uint64_t{1} << 60); }), HasSubstr("has room for"));
  EXPECT_THAT(refusal([](Blob& b) { b.resize(375 + 54 + 7 + 30); }), HasSubstr("cut short"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 131, 0.0); }), HasSubstr("scale"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 139, std::numeric_limits<double>::quiet_NaN()); }), HasSubstr("scale"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 155, std::numeric_limits<double>::infinity()); }), HasSubstr("offset"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 100, 0xffffffffu); }), HasSubstr("variable length records"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 100, std::uint32_t{2}); }), HasSubstr("record 2 of 2"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 375 + 20, std::uint16_t{60000}); }), HasSubstr("record 1 of 1"));
  EXPECT_THAT(refusal([](Blob& b) { poke(b, 235, ~std::uint64_t{0}); }), HasSubstr("beyond its place"));
  EXPECT_THAT(refusal([&](Blob& b) { b.resize(good.size() - 3); }), HasSubstr("beyond its place"));
}

}  // namespace
}  // namespace tind::client
