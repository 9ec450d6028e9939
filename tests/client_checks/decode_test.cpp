// SPDX-License-Identifier: GPL-3.0-or-later
// The client's decoders: bytes written down by hand from docs/format.md, and damaged ones.
#include "tests/client/decode.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <zstd.h>

#include "tests/client/http_source.hpp"
#include "tests/client/manifest_view.hpp"
#include "tests/client/terrain_decode.hpp"
#include "tests/client_checks/memory_pyramid.hpp"

namespace tind::client {
namespace {

using testing::HasSubstr;

TEST(ByteCursor, ReadsVarintsToTheirLimits) {
  const Blob bytes = {0x00, 0x01, 0x7f, 0x80, 0x01, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x01};
  ByteCursor in(bytes);
  EXPECT_EQ(in.take_signed(), 0);
  EXPECT_EQ(in.take_signed(), -1);
  EXPECT_EQ(in.take_signed(), -64);
  EXPECT_EQ(in.take_unsigned(), 128u);
  EXPECT_EQ(in.take_unsigned(), ~std::uint64_t{0});
  EXPECT_FALSE(in.bad());
  EXPECT_EQ(in.left(), 0u);
  EXPECT_EQ(in.take<std::uint32_t>(), 0u);
  EXPECT_TRUE(in.bad());
}

TEST(ByteCursor, RefusesVarintsBeyond64Bits) {
  const Blob too_big = {0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x02};
  ByteCursor in(too_big);
  in.take_unsigned();
  EXPECT_TRUE(in.bad());
  const Blob too_long(11, 0x80);
  ByteCursor longer(too_long);
  longer.take_unsigned();
  EXPECT_TRUE(longer.bad());
}

TEST(Corner, IsATagAndAHeight) {
  EXPECT_EQ(read_corner(Blob{'C', 0x03}).value(), -2);
  EXPECT_FALSE(read_corner(Blob{'E', 0x03}));
  EXPECT_FALSE(read_corner(Blob{'C'}));
  EXPECT_FALSE(read_corner(Blob{'C', 0x03, 0x00}));
  EXPECT_FALSE(read_corner(Blob{'C', 0x80, 0x80, 0x80, 0x80, 0x20})) << "height beyond 32 bits";
}

TEST(Edge, HoldsEntriesPositionsHeights) {
  const auto edge = read_edge(Blob{'E', 2, 0, 3, 5, 6, 10, 20, 0x04, 0x01}, 100);
  ASSERT_TRUE(edge.has_value()) << edge.error();
  EXPECT_EQ(edge->start_entry, 0);
  EXPECT_EQ(edge->end_entry, 3);
  EXPECT_EQ(edge->inner, (std::vector<SideVertex>{{10, 2, 5}, {30, 1, 6}}));
}

TEST(Edge, RefusesPositionsOutsideTheSide) {
  EXPECT_FALSE(read_edge(Blob{'E', 1, 0, 0, 1, 0, 0}, 100)) << "no step";
  EXPECT_FALSE(read_edge(Blob{'E', 1, 0, 0, 1, 100, 0}, 100)) << "on the end corner";
  EXPECT_TRUE(read_edge(Blob{'E', 1, 0, 0, 1, 99, 0}, 100));
  EXPECT_FALSE(read_edge(Blob{'E', 0xff, 0xff, 0xff, 0xff, 0x0f, 0, 0}, 100)) << "a count that the bytes cannot hold";
}

TEST(Value, IsARecordOrExactlyOneFrame) {
  const Blob record = {'C', 0x03};
  EXPECT_EQ(open_value(record).value(), record);
  const Blob long_record(1000, 7);
  Blob frame(ZSTD_compressBound(long_record.size()));
  frame.resize(ZSTD_compress(frame.data(), frame.size(), long_record.data(), long_record.size(), 3));
  EXPECT_EQ(open_value(frame).value(), long_record);
  Blob longer = frame;
  longer.push_back(0);
  EXPECT_FALSE(open_value(longer));
  Blob shorter = frame;
  shorter.pop_back();
  EXPECT_FALSE(open_value(shorter));
}

TEST(VnTile, EveryTruncationIsRefused) {
  test::MemoryPyramid pyramid(test::small_world().tind);
  const Blob bytes = pyramid.body_of("0/0/0.vn");
  ASSERT_TRUE(read_vn(bytes).has_value());
  for (std::size_t n = 0; n < bytes.size(); ++n) {
    EXPECT_FALSE(read_vn(BlobView(bytes).first(n))) << n << " of " << bytes.size() << " bytes";
  }
  Blob longer = bytes;
  longer.push_back(0);
  EXPECT_FALSE(read_vn(longer));
}

TEST(Bundle, EveryTruncationIsRefused) {
  test::MemoryPyramid pyramid(test::small_world().tind);
  const Blob bytes = pyramid.body_of("0/1/0.parts");
  ASSERT_TRUE(read_bundle(bytes).has_value());
  for (std::size_t n = 0; n < bytes.size(); ++n) EXPECT_FALSE(read_bundle(BlobView(bytes).first(n))) << n;
}

TEST(Terrain, EveryTruncationIsRefused) {
  test::MemoryPyramid pyramid(test::small_world().tind);
  const Blob bytes = pyramid.body_of("1/0/0.terrain");
  const auto mesh = read_terrain(bytes);
  ASSERT_TRUE(mesh.has_value()) << mesh.error();
  const std::size_t without_extension = bytes.size() - 5 - 2 * mesh->u.size();
  for (std::size_t n = 0; n < bytes.size(); ++n) {
    EXPECT_EQ(read_terrain(BlobView(bytes).first(n)).has_value(), n == without_extension) << n;
  }
}

TEST(Decoders, SurviveFlippedBytes) {
  test::MemoryPyramid pyramid(test::small_world().tind);
  for (const std::string path : {"2/7/2.vn", "2/7/2.parts", "2/7/2.terrain"}) {
    const Blob good = pyramid.body_of(path);
    ASSERT_FALSE(good.empty()) << path;
    std::size_t refused = 0;
    for (std::size_t k = 0; k < good.size(); ++k) {
      Blob bytes = good;
      bytes[k] ^= static_cast<std::uint8_t>(1u << (k % 8));
      bool taken = true;
      if (path.ends_with(".vn")) {
        taken = read_vn(bytes).has_value();
      } else if (path.ends_with(".parts")) {
        const auto bundle = read_bundle(bytes);
        const LatticeFrame frame{pyramid.manifest().lattice.level, pyramid.manifest().lattice.height_exponent};
        const auto pieces = bundle ? read_pieces(*bundle, frame) : refuse("");
        taken = pieces && assemble_pieces(bundle->id, *pieces, frame).has_value();
      } else {
        taken = read_terrain(bytes).has_value();
      }
      refused += taken ? 0 : 1;
    }
    EXPECT_GT(refused, 0u) << path;
  }
}

TEST(Url, IsCutIntoServerAndDataset) {
  EXPECT_EQ(parse_dataset_url("http://127.0.0.1:8080/demo")->name, "demo");
  EXPECT_EQ(parse_dataset_url("http://127.0.0.1:8080/demo/")->name, "demo");
  EXPECT_EQ(parse_dataset_url("http://127.0.0.1:8080/demo/")->base, "http://127.0.0.1:8080");
  EXPECT_EQ(parse_dataset_url("http://h:1")->name, "");
  EXPECT_EQ(parse_dataset_url("http://h:1/")->name, "");
  for (const char* bad : {"", "demo", "ftp://h/x", "http://", "http:///x", "http://h/a/b", "http://h/a?b"}) {
    EXPECT_FALSE(parse_dataset_url(bad)) << bad;
  }
}

TEST(Manifest, RefusesWhatCannotBeWorkedWith) {
  EXPECT_THAT(read_manifest(Blob{'['}).error(), HasSubstr("JSON"));
  const std::string text = R"({"format":"tind","format_version":2})";
  EXPECT_THAT(read_manifest(Blob(text.begin(), text.end())).error(), HasSubstr("version 2"));
}

}  // namespace
}  // namespace tind::client
