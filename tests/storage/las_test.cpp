// SPDX-License-Identifier: GPL-3.0-or-later
// The LAS reader on files written byte by byte: every version and point format, and every way to be broken.
#include "storage/readers/las.hpp"

#include <limits>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/storage/test_las.hpp"
#include "tests/support/memory_source.hpp"

namespace tind {
namespace {

using test::LasTestPoint;
using test::LasTestSpec;
using test::make_las;
using test::put_at;
using ::testing::HasSubstr;
using Bytes = std::vector<std::uint8_t>;

Result<LasHeader> read_header(const Bytes& bytes) {
  test::MemorySource source(bytes);
  return read_las_header(source, "a.las");
}

std::string message(const Bytes& bytes) {
  const auto header = read_header(bytes);
  return header ? "" : header.error().message;
}

const std::vector<LasTestPoint> kPoints = {
    {1.5, -2.25, 100.125, 2, false}, {1000, 2000, -3, 9, false}, {-7, 8, 9, 2, true}, {0, 0, 0, 31, false}};

TEST(Las, EveryVersionAndPointFormatGivesTheSamePoints) {
  for (int minor = 0; minor <= 4; ++minor) {
    for (int format = 0; format <= 10; ++format) {
      for (const std::size_t extra : {0u, 5u}) {
        SCOPED_TRACE(fmt::format("1.{} format {} extra {}", minor, format, extra));
        LasTestSpec spec;
        spec.version_minor = minor;
        spec.point_format = format;
        spec.extra_bytes = extra;
        spec.offset = {100, -200, 0.5};
        spec.geo_keys = test::keys_of_epsg(2949);
        const Bytes bytes = make_las(spec, kPoints);
        const auto header = read_header(bytes);
        ASSERT_TRUE(header) << header.error().message;
        EXPECT_EQ(header->version_minor, minor);
        EXPECT_EQ(header->point_format, format);
        EXPECT_EQ(header->n_points, kPoints.size());
        EXPECT_EQ(header->crs.geo_keys, spec.geo_keys);
        std::vector<LasPoint> points;
        const std::size_t n_bytes = kPoints.size() * header->record_bytes;
        decode_las_points(*header, std::span(bytes).subspan(header->points_offset, n_bytes), points);
        ASSERT_EQ(points.size(), kPoints.size());
        for (std::size_t i = 0; i < points.size(); ++i) {
          EXPECT_NEAR(points[i].x, kPoints[i].x, 1e-9);
          EXPECT_NEAR(points[i].y, kPoints[i].y, 1e-9);
          EXPECT_NEAR(points[i].z, kPoints[i].z, 1e-9);
          EXPECT_EQ(points[i].classification, kPoints[i].classification);
          EXPECT_EQ(points[i].withheld, kPoints[i].withheld);
        }
      }
    }
  }
}

TEST(Las, NewFormatsHaveClassesBeyond31) {
  const Bytes bytes = make_las({.version_minor = 4, .point_format = 6}, {{0, 0, 0, 255, false}});
  const auto header = read_header(bytes);
  ASSERT_TRUE(header);
  std::vector<LasPoint> points;
  decode_las_points(*header, std::span(bytes).subspan(header->points_offset), points);
  ASSERT_EQ(points.size(), 1u);
  EXPECT_EQ(points[0].classification, 255);
}

TEST(Las, WktIsFoundInBothKindsOfRecords) {
  for (const bool at_end : {false, true}) {
    LasTestSpec spec{.version_minor = 4, .wkt = "PROJCS[...]", .wkt_at_end = at_end, .legacy_count = false};
    const auto header = read_header(make_las(spec, kPoints));
    ASSERT_TRUE(header) << header.error().message;
    EXPECT_EQ(header->crs.wkt, "PROJCS[...]");
    EXPECT_EQ(header->n_points, kPoints.size());
  }
}

TEST(Las, GeoTiffRecordsAreKeptAsTheyAre) {
  LasTestSpec spec;
  spec.geo_keys = test::keys_of_epsg(32611);
  spec.geo_doubles = {1.5, -2.5};
  spec.geo_ascii = "Words|";
  const auto header = read_header(make_las(spec, {}));
  ASSERT_TRUE(header);
  EXPECT_EQ(header->n_points, 0u);
  EXPECT_EQ(header->crs.geo_doubles, spec.geo_doubles);
  EXPECT_EQ(header->crs.geo_ascii, "Words|");
}

TEST(Las, BrokenFilesAreRefusedWithAReason) {
  const Bytes good = make_las({.version_minor = 4, .point_format = 6, .wkt = "X", .wkt_at_end = true}, kPoints);
  const Bytes old = make_las({}, kPoints);
  ASSERT_EQ(message(good), "");
  ASSERT_EQ(message(old), "");
  const auto spoiled = [](Bytes bytes, std::size_t at, auto value) {
    put_at(bytes, at, value);
    return message(bytes);
  };
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_THAT(message({}), HasSubstr("a.las: is not a LAS file"));
  EXPECT_THAT(spoiled(good, 0, 'X'), HasSubstr("is not a LAS file"));
  EXPECT_THAT(message(Bytes(good.begin(), good.begin() + 100)), HasSubstr("truncated within the LAS header"));
  EXPECT_THAT(message(Bytes(good.begin(), good.begin() + 300)), HasSubstr("truncated within the LAS header"));
  EXPECT_THAT(spoiled(good, 24, char{2}), HasSubstr("LAS version 2.4 is not known"));
  EXPECT_THAT(spoiled(good, 25, char{5}), HasSubstr("LAS version 1.5 is not known"));
  EXPECT_THAT(spoiled(good, 94, std::uint16_t{227}), HasSubstr("needs a header of 375 bytes, its own says 227"));
  EXPECT_THAT(spoiled(good, 104, char{11}), HasSubstr("point format 11 is not known"));
  EXPECT_THAT(spoiled(good, 105, std::uint16_t{29}), HasSubstr("records of 30 bytes, the header says 29"));
  EXPECT_THAT(spoiled(good, 105, std::uint16_t{0}), HasSubstr("the header says 0"));
  EXPECT_THAT(spoiled(good, 96, std::uint32_t{374}), HasSubstr("inside its header"));
  EXPECT_THAT(spoiled(good, 96, std::uint32_t{0x7fffffff}), HasSubstr("outside the file's"));
  EXPECT_THAT(spoiled(good, 131, 0.0), HasSubstr("scale 0 and offset 0 of coordinate x"));
  EXPECT_THAT(spoiled(good, 147, kNan), HasSubstr("of coordinate z"));
  EXPECT_THAT(spoiled(good, 163, std::numeric_limits<double>::infinity()), HasSubstr("of coordinate y"));
  EXPECT_THAT(spoiled(good, 100, std::uint32_t{2}), HasSubstr("record 1 of 2 runs into the points"));
  EXPECT_THAT(spoiled(good, 100, std::uint32_t{0xffffffff}), HasSubstr("runs into the points"));
  EXPECT_THAT(spoiled(good, 375 + 20, std::uint16_t{4}), HasSubstr("record 0 of 1 runs into the points"));
  EXPECT_THAT(spoiled(good, 247, std::uint64_t{9}), HasSubstr("announces 9 points, it holds 4"));
  EXPECT_THAT(spoiled(good, 247, ~std::uint64_t{0}),
              HasSubstr("is truncated: its header announces 18446744073709551615"));
  EXPECT_THAT(spoiled(old, 107, std::uint32_t{5}), HasSubstr("announces 5 points, it holds 4"));
  EXPECT_THAT(message(Bytes(old.begin(), old.end() - 1)), HasSubstr("announces 4 points, it holds 3"));
  EXPECT_THAT(spoiled(good, 235, ~std::uint64_t{0}), HasSubstr("extended record 0 of 1 lies beyond the file's end"));
  EXPECT_THAT(spoiled(good, 243, std::uint32_t{2}), HasSubstr("extended record 1 of 2 lies beyond the file's end"));
  EXPECT_THAT(spoiled(good, 243, ~std::uint32_t{0}), HasSubstr("extended records are not plausible"));
  const std::size_t evlr = good.size() - 62;
  EXPECT_THAT(spoiled(good, evlr + 20, ~std::uint64_t{0}), HasSubstr("lies beyond the file's end"));
  Bytes huge = good;
  huge.resize(huge.size() + (2 << 20));
  EXPECT_THAT(spoiled(huge, evlr + 20, std::uint64_t{(1 << 20) + 1}),
              HasSubstr("a CRS of 1048577 bytes is not plausible"));
}

TEST(Las, CompressedFilesSayHowToConvertThem) {
  LasTestSpec spec;
  spec.laszip = true;
  const auto by_record = read_header(make_las(spec, kPoints));
  ASSERT_FALSE(by_record);
  EXPECT_EQ(by_record.error().kind, ErrorKind::kUnsupported);
  EXPECT_THAT(by_record.error().message, HasSubstr("pdal translate a.las points.las"));
  Bytes by_bit = make_las({}, kPoints);
  by_bit[104] |= 0x80;
  EXPECT_THAT(message(by_bit), HasSubstr("compressed (LAZ)"));
  // A compressed file is shorter than its count of records of full length.
  by_bit.resize(by_bit.size() - 30);
  EXPECT_THAT(message(by_bit), HasSubstr("compressed (LAZ)"));
}

}  // namespace
}  // namespace tind
