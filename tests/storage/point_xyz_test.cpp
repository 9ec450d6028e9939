// SPDX-License-Identifier: GPL-3.0-or-later
// Points as text: separators, headers, and lines that are none.
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/xyz_points.hpp"
#include "tests/support/memory_source.hpp"

namespace tind {
namespace {

using ::testing::HasSubstr;

struct Read {
  std::vector<XyzPoint> points;
  std::string error;
};

Read read(const std::string& text, std::size_t batch = 2) {
  const std::vector<std::uint8_t> bytes(text.begin(), text.end());
  test::MemorySource source(bytes);
  Read result;
  auto reader = XyzReader::open(source, "a.csv");
  if (!reader) {
    result.error = reader.error().message;
    return result;
  }
  for (bool more = true; more;) {
    const auto next = reader->next(batch, result.points);
    if (!next) {
      result.error = next.error().message;
      return result;
    }
    more = *next;
  }
  return result;
}

void expect_two_points(const std::string& text) {
  SCOPED_TRACE(text);
  const Read r = read(text);
  EXPECT_EQ(r.error, "");
  ASSERT_EQ(r.points.size(), 2u);
  EXPECT_EQ(r.points[0].x, 10.5);
  EXPECT_EQ(r.points[0].y, -47);
  EXPECT_EQ(r.points[0].z, 1e3);
  EXPECT_EQ(r.points[1].x, 11);
  EXPECT_EQ(r.points[1].y, 48.25);
  EXPECT_EQ(r.points[1].z, 7);
}

TEST(PointXyz, AnySeparatorAndAnyLineEnd) {
  expect_two_points("10.5 -47 1e3\n11 48.25 7\n");
  expect_two_points("10.5,-47,1e3\n11,48.25,7");
  expect_two_points("10.5;-47;1000.0\r\n11;48.25;7\r\n");
  expect_two_points("10.5\t-47\t1e3\n11\t48.25\t7\n");
  expect_two_points("  10.5   -47  +1e3  \n\n11 \t 48.25 7 255 128\n");
  expect_two_points("10.5, -47 , 1e3, red\n11, 48.25, 7, blue\n");
  expect_two_points("\xef\xbb\xbf# a comment\n10.5 -47 1e3\n# another\n11 48.25 7\n\n");
}

TEST(PointXyz, HeaderNamesColumnsInAnyOrder) {
  expect_two_points("x,y,z\n10.5,-47,1e3\n11,48.25,7\n");
  expect_two_points("id;Height;\"Latitude\";Longitude\n1;1e3;-47;10.5\n2;7;48.25;11\n");
  expect_two_points("# made by hand\nEASTING northing Elevation\n10.5 -47 1e3\n11 48.25 7\n");
  expect_two_points("lat,lon,name,z\n-47,10.5,a,1e3\n48.25,11,,7\n");
}

TEST(PointXyz, BrokenLinesAreNamedByNumber) {
  EXPECT_EQ(read("").error, "a.csv: holds no line with a point");
  EXPECT_EQ(read("# nothing\n\n").error, "a.csv: holds no line with a point");
  EXPECT_THAT(read("1 2 3\n4 5\n").error, HasSubstr("a.csv: line 2: has 2 columns, at least 3"));
  EXPECT_THAT(read("1,2,3\n\n4,five,6\n").error, HasSubstr("a.csv: line 3: y is not a number: \"five\""));
  EXPECT_THAT(read("1,2,3\n4,5,6m\n").error, HasSubstr("line 2: z is not a number: \"6m\""));
  EXPECT_THAT(read("1;2,5;3\n").error, HasSubstr("line 1: y is not a number: \"2,5\""));
  EXPECT_THAT(read("1,2,1e999\n").error, HasSubstr("line 1: z is not a number"));
  EXPECT_THAT(read("a,b,c\n1,2,3\n").error, HasSubstr("line 1: \"a,b,c\" is neither three numbers nor a header"));
  EXPECT_THAT(read("x,y\n1,2\n").error, HasSubstr("line 1: \"x,y\" is neither"));
  EXPECT_THAT(read(std::string("1 2 \x01\x02") + std::string(100, 'z') + "\n").error,
              HasSubstr("\"??zzzzzzzzzzzzzzzzzzzzzz...\""));
  EXPECT_THAT(read("1 2 3\n" + std::string(70000, '1')).error, HasSubstr("line 2: is longer than 65536 bytes"));
}

TEST(PointXyz, NumbersThatAreNotFiniteAreHandedOut) {
  const Read r = read("1 2 nan\n1 inf 3\n");
  EXPECT_EQ(r.error, "");
  ASSERT_EQ(r.points.size(), 2u);
  EXPECT_NE(r.points[0].z, r.points[0].z);
}

TEST(PointXyz, LinesAcrossTheBuffersEnd) {
  // The buffer holds 1 MiB; these lines do not divide it.
  std::string text;
  constexpr int kLines = 100000;
  for (int i = 0; i < kLines; ++i) text += std::to_string(i) + ".125 " + std::to_string(2 * i) + " -3.5\n";
  const Read r = read(text, 777);
  EXPECT_EQ(r.error, "");
  ASSERT_EQ(r.points.size(), static_cast<std::size_t>(kLines));
  for (int i = 0; i < kLines; ++i) {
    const XyzPoint& p = r.points[static_cast<std::size_t>(i)];
    ASSERT_TRUE(p.x == i + 0.125 && p.y == 2 * i && p.z == -3.5) << i;
  }
}

}  // namespace
}  // namespace tind
