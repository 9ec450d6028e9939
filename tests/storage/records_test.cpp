// SPDX-License-Identifier: GPL-3.0-or-later
// Records, values and manifests: what was encoded comes back, and no bytes at all crash a decoder or make it ask for
// memory out of proportion.
#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include <gtest/gtest.h>

#include "core/format/vn.hpp"
#include "core/tessellation.hpp"
#include "storage/manifest.hpp"
#include "storage/inputs_blob.hpp"
#include "storage/piece_blob.hpp"
#include "storage/value_hash.hpp"
#include "storage/zstd_codec.hpp"
#include "tests/support/memory_watch.hpp"
#include "tests/support/test_field.hpp"
#include "tests/support/test_tile.hpp"

namespace tind::test {
namespace {

constexpr TileKey kTile{5, 20, 13};

const TestTile& real_tile() {
  static const TestTile tile = [] {
    const TestField f(place_over(5, 20, 13, 7, 2600.7, 3), rough_terrain(8, 1500));
    return build_tile(f.field, spec_from(5, 120, 3, f.field.lattice), kTile);
  }();
  return tile;
}

EdgeChain real_edge() { return edge_of_level(real_tile().lines[1], 6); }

TileBody real_body() {
  const TestTile& tile = real_tile();
  TileBody body;
  body.stats = tile.surface.stats;
  body.stats.coverage = TileCoverage::kReal;
  for (std::size_t b = 0; b < 4; ++b) body.n_side[b] = static_cast<std::uint32_t>(tile.task.borders[b].size() - 1);
  body.interior = tile.surface.interior;
  body.triangles = tile.surface.triangles;
  body.n_gaps = 2;
  body.virtual_triangles = find_virtual_triangles(body.triangles, body.n_side);
  for (VirtualTriangle& vt : body.virtual_triangles) vt.runs.assign(2u * vt.n_edges, vt.triangle % 300);
  return body;
}

// Larger than zstd's blocks of 128 KiB, so that most of it need not be unpacked.
TileBody large_body() {
  TileBody body;
  for (std::int64_t k = 0; k < 30000; ++k) {
    body.interior.push_back({static_cast<std::int64_t>(noise(1, k, 0) * 65536),
                             static_cast<std::int64_t>(noise(2, k, 0) * 65536),
                             static_cast<std::int32_t>(noise(3, k, 0) * 1e6)});
  }
  for (std::uint32_t k = 0; k < 60000; ++k) {
    const auto vertex = [&](std::int64_t seed) { return static_cast<std::uint32_t>(noise(seed, k, 0) * 30000); };
    body.triangles.push_back({vertex(4), vertex(5), vertex(6)});
  }
  return body;
}

Manifest real_manifest() {
  Manifest m;
  m.mode = "standard";
  m.lattice.level = 9;
  m.bottom_level = 1;
  m.sources = {{"a \"quoted\" \n name.tif", "00", 3, 4, 0, "", ""}};
  for (int level = 0; level < 2; ++level) {
    LevelInfo info;
    info.level = level;
    info.tolerance_m = 1;
    info.height_step_m = 0.25;
    info.rows = {{0, 0, 0, TileCoverage::kReal}, {0, 1, 1, TileCoverage::kPartial}};
    m.levels.push_back(info);
  }
  m.levels[1].rows.push_back({1, 0, 3, TileCoverage::kFiller});
  return m;
}

/// Decodes every truncation and many damaged copies of `record`; memory stays within `bytes_a_byte` of its size.
void torment(const Bytes& record, double bytes_a_byte, const std::function<bool(ByteView)>& decodes) {
  ASSERT_TRUE(decodes(record));
  const auto limit = static_cast<std::size_t>(bytes_a_byte * static_cast<double>(record.size())) + 4096;
  const auto try_one = [&](const Bytes& bytes) {
    reset_largest_request();
    const bool ok = decodes(bytes);
    EXPECT_LE(largest_request(), limit);
    return ok;
  };
  for (std::size_t n = 0; n < record.size(); ++n) {
    const Bytes cut(record.begin(), record.begin() + static_cast<std::ptrdiff_t>(n));
    EXPECT_FALSE(try_one(cut)) << "cut at " << n << " of " << record.size();
  }
  Bytes longer = record;
  longer.push_back('x');
  EXPECT_FALSE(try_one(longer));
  for (std::int64_t k = 0; k < 4000; ++k) {
    Bytes bytes = record;
    for (std::int64_t flips = 0; flips <= k % 3; ++flips) {
      // Half of the damage in the head, where the counts are.
      const double range =
          k % 2 ? static_cast<double>(bytes.size()) : std::min<double>(40, static_cast<double>(bytes.size()));
      bytes[static_cast<std::size_t>(noise(1, k, flips) * range)] ^=
          static_cast<std::uint8_t>(1 + noise(2, k, flips) * 255);
    }
    try_one(bytes);
  }
}

TEST(InputsRecord, ComesBackAndSurvivesDamage) {
  TileInputs inputs;
  for (std::size_t k = 0; k < inputs.frame.size(); ++k) {
    inputs.frame[k] = static_cast<std::uint8_t>(17 * k);
    inputs.posts[k] = static_cast<std::uint8_t>(200 - 3 * k);
  }
  inputs.n_inserted = 300;
  inputs.n_of_lines = 2;
  inputs.n_outside = std::uint64_t{1} << 40;
  inputs.n_left_out = 1;
  EXPECT_EQ(decode_inputs(encode_inputs(inputs)).value(), inputs);
  inputs.body = BodySummary{{TileCoverage::kReal, -70000, 123456, 1u << 20, 9.75f, 2.5f}, 300, 700};
  const Bytes record = encode_inputs(inputs);
  EXPECT_EQ(decode_inputs(record).value(), inputs);
  for (const float wrong : {-1.0f, std::numeric_limits<float>::infinity(), std::numeric_limits<float>::quiet_NaN()}) {
    TileInputs bad = inputs;
    bad.body->stats.max_error_m = wrong;
    EXPECT_FALSE(decode_inputs(encode_inputs(bad)));
    bad = inputs;
    bad.body->stats.rmse_m = wrong;
    EXPECT_FALSE(decode_inputs(encode_inputs(bad)));
  }
  TileInputs bad = inputs;
  bad.body->stats.coverage = static_cast<TileCoverage>(static_cast<int>(TileCoverage::kReal) + 1);
  EXPECT_FALSE(decode_inputs(encode_inputs(bad)));
  for (std::size_t n = 0; n < record.size(); ++n) EXPECT_FALSE(decode_inputs(ByteView(record).first(n))) << n;
  Bytes longer = record;
  longer.push_back(0);
  EXPECT_FALSE(decode_inputs(longer));
  Bytes other = record;
  other[0] = 'B';
  EXPECT_FALSE(decode_inputs(other));
}

// With the hash that it ought to have.
Bytes sealed(Bytes record) {
  const std::uint64_t hash = value_hash(ByteView(record).first(record.size() - 8));
  for (std::size_t k = 0; k < 8; ++k) record[record.size() - 8 + k] = static_cast<std::uint8_t>(hash >> (8 * k));
  return record;
}

TEST(InputsRecord, NoticesAnyDamage) {
  TileInputs inputs;
  inputs.n_cell_levels = 3;
  inputs.cells.resize(64);
  for (std::size_t k = 0; k < 64; k += 5) inputs.cells[k] = {k + 1, 0.25 * static_cast<double>(k), 1.5f};
  const Bytes record = encode_inputs(inputs);
  EXPECT_EQ(sealed(record), record);
  const auto head = decode_inputs_head(record);
  ASSERT_TRUE(head);
  EXPECT_TRUE(head->cells.empty());
  TileInputs whole = *head;
  whole.n_cell_levels = inputs.n_cell_levels;
  whole.cells = inputs.cells;
  EXPECT_EQ(whole, inputs);
  for (std::size_t n = 0; n < record.size(); ++n) EXPECT_FALSE(decode_inputs_head(ByteView(record).first(n))) << n;
  for (std::size_t at = 0; at < record.size(); ++at) {
    for (int bit = 0; bit < 8; ++bit) {
      Bytes damaged = record;
      damaged[at] ^= static_cast<std::uint8_t>(1 << bit);
      EXPECT_FALSE(decode_inputs(damaged)) << at;
      EXPECT_FALSE(decode_inputs_head(damaged)) << at;
      if (at + 8 < record.size()) decode_inputs(sealed(damaged));  // whatever it is, it is read to its end
    }
  }
}

TEST(InputsRecord, HasCellsOrNone) {
  TileInputs inputs;
  inputs.n_cell_levels = 2;
  inputs.vertex_posts = 0x0123456789abcdef;
  inputs.cells.resize(16);
  inputs.cells[3] = {70'000, 12.5, 3.25f};
  inputs.cells[15] = {1, 0, 0};
  const Bytes record = encode_inputs(inputs);
  EXPECT_EQ(record.size(),
            33u + 5 + 1 + 1 + 8 + 2 * 2 + 15 + 13 + 8);  // empty cells that follow each other are two bytes
  EXPECT_EQ(decode_inputs(record).value(), inputs);
  for (std::size_t n = 0; n < record.size(); ++n) EXPECT_FALSE(decode_inputs(ByteView(record).first(n))) << n;
  for (const int levels : {0, 1, 3, 6, 9, 255}) {
    Bytes other = record;
    other[39] = static_cast<std::uint8_t>(levels);
    EXPECT_FALSE(decode_inputs(sealed(other))) << levels;
  }
  for (const double wrong : {-1.0, std::numeric_limits<double>::infinity(), std::nan("")}) {
    inputs.cells[3].sum_m2 = wrong;
    EXPECT_FALSE(decode_inputs(encode_inputs(inputs)));
    inputs.cells[3] = {70'000, 12.5, static_cast<float>(wrong)};
    EXPECT_FALSE(decode_inputs(encode_inputs(inputs)));
  }
}

TEST(InputsRecord, OfManyEmptyCellsIsSmall) {
  TileInputs inputs;
  inputs.n_cell_levels = kMostCellLevels;
  inputs.cells.resize(std::size_t{1} << (2 * kMostCellLevels));
  EXPECT_LT(encode_inputs(inputs).size(), 64u);
  EXPECT_EQ(decode_inputs(encode_inputs(inputs)).value(), inputs);
  for (const std::size_t k : {std::size_t{0}, std::size_t{1}, std::size_t{777}, inputs.cells.size() - 1}) {
    inputs.cells[k] = {k + 1, 0.5, 0.25f};
  }
  Bytes record = encode_inputs(inputs);
  EXPECT_LT(record.size(), 128u);
  EXPECT_EQ(decode_inputs(record).value(), inputs);
  // A run that passes the end by one.
  inputs = {};
  inputs.n_cell_levels = 2;
  inputs.cells.resize(16);
  record = encode_inputs(inputs);
  ASSERT_EQ(record[record.size() - 9], 15);
  record[record.size() - 9] = 16;
  EXPECT_FALSE(decode_inputs(sealed(record)));
}

// 0.5.0 wrote each empty cell by itself.
TEST(InputsRecord, OfTheSecondKindIsReadAsItWasWritten) {
  TileInputs inputs;
  inputs.n_cell_levels = 2;
  inputs.vertex_posts = 0x0123456789abcdef;
  inputs.cells.resize(16);
  inputs.cells[15] = {1, 0.25, 0.5f};
  const Bytes now = encode_inputs(inputs);  // ..., 0, 14, the last cell, the check
  Bytes record(now.begin(), now.end() - 8 - 13 - 2);
  record[0] = 'J';
  ASSERT_EQ(record[38], 0);
  record.erase(record.begin() + 38);  // has_body
  record.insert(record.end(), 15, 0);
  record.insert(record.end(), now.end() - 8 - 13, now.end());
  EXPECT_EQ(decode_inputs(sealed(record)).value(), inputs);
  record[0] = 'K';
  EXPECT_FALSE(decode_inputs(sealed(record)));
}

// Builders before 0.5.0 wrote one digest of all: such a file is sound, and nothing is taken over from it.
TEST(InputsRecord, OfTheFirstKindHasNoDigests) {
  Bytes record(22, 7);
  record[0] = 'I';
  const auto inputs = decode_inputs(record);
  ASSERT_TRUE(inputs);
  EXPECT_EQ(inputs->frame, TileInputs::Digest{});
  EXPECT_EQ(inputs->posts, TileInputs::Digest{});
  EXPECT_EQ(inputs->n_left_out, 7u);
  EXPECT_TRUE(inputs->cells.empty());
  EXPECT_FALSE(decode_inputs(ByteView(record).first(21)));
  EXPECT_EQ(decode_inputs_head(record).value(), *inputs);
  EXPECT_FALSE(decode_inputs_head(ByteView(record).first(21)));
}

TEST(CornerRecord, ComesBackAndSurvivesDamage) {
  for (const std::int32_t z : {0, -1, 77, INT32_MIN, INT32_MAX})
    EXPECT_EQ(decode_corner(encode_corner({z})).value(), Corner{z});
  torment(encode_corner({INT32_MIN}), 0, [](ByteView b) { return decode_corner(b).has_value(); });
  EXPECT_FALSE(decode_corner(Bytes{'C', 0xff, 0xff, 0xff, 0xff, 0x7f}));  // beyond 32 bits
}

TEST(EdgeRecord, ComesBackAndSurvivesDamage) {
  const EdgeChain edge = real_edge();
  ASSERT_GT(edge.inner.size(), 10u);
  EXPECT_EQ(decode_edge(encode_edge(edge)).value(), edge);
  EXPECT_EQ(decode_edge(encode_edge({})).value(), EdgeChain{});
  torment(encode_edge(edge), 8, [](ByteView b) { return decode_edge(b).has_value(); });
}

TEST(EdgeRecord, RefusesVerticesAtOnePoint) {
  EdgeChain edge = real_edge();
  edge.inner[1].t = edge.inner[0].t;
  EXPECT_FALSE(decode_edge(encode_edge(edge)));
}

TEST(BodyRecord, ComesBackAndSurvivesDamage) {
  const TileBody body = real_body();
  ASSERT_GT(body.interior.size(), 50u);
  ASSERT_GT(body.virtual_triangles.size(), 10u);
  EXPECT_EQ(decode_body(encode_body(body)).value(), body);
  torment(encode_body(body), 16, [](ByteView b) { return decode_body(b).has_value(); });
}

TEST(BodySummary, IsThatOfTheBodyHoweverPacked) {
  const TileBody body = large_body();
  const Bytes record = encode_body(body);
  Bytes frame = zstd_compress(record, 3);
  frame.resize(frame.size() / 2);  // it stands at the start
  for (const Bytes& value : {record, pack_body(body), zstd_compress(record, 1), frame}) {
    const auto summary = decode_body_summary(value);
    ASSERT_TRUE(summary);
    EXPECT_EQ(summary->stats, body.stats);
    EXPECT_EQ(summary->n_interior, body.interior.size());
    EXPECT_EQ(summary->n_triangles, body.triangles.size());
  }
  EXPECT_TRUE(decode_body_summary(pack_body(TileBody{})));
  EXPECT_FALSE(decode_body_summary(encode_edge(real_edge())));
  EXPECT_FALSE(decode_body_summary({}));
  frame.resize(12);
  EXPECT_FALSE(decode_body_summary(frame));
}

TEST(BodyInterior, IsThatOfTheBodyHoweverPacked) {
  const TileBody body = real_body();
  const Bytes record = encode_body(body);
  EXPECT_EQ(decode_interior(record).value(), body.interior);
  for (const Bytes& value : {pack_body(body), zstd_compress(record, 1), zstd_compress(record, 19)}) {
    ASSERT_TRUE(is_zstd_frame(value));
    EXPECT_EQ(decode_interior(value).value(), body.interior);
  }
  EXPECT_EQ(decode_interior(pack_body(TileBody{})).value(), std::vector<LocalVertex>{});
  EXPECT_EQ(decode_interior(encode_body(TileBody{})).value(), std::vector<LocalVertex>{});
  EXPECT_FALSE(decode_interior(encode_edge(real_edge())));
  EXPECT_FALSE(decode_interior(zstd_compress(encode_edge(real_edge()), 3)));
  EXPECT_FALSE(decode_interior({}));
}

TEST(BodyInterior, LeavesWhatFollowsPacked) {
  const TileBody body = large_body();
  const Bytes record = encode_body(body);
  Bytes frame = zstd_compress(record, 3);
  EXPECT_EQ(decode_interior(frame).value(), body.interior);
  // Without the last third there is no body, but all that is asked for.
  frame.resize(frame.size() / 3 * 2);
  EXPECT_FALSE(unpack_value(frame));
  reset_largest_request();
  EXPECT_EQ(decode_interior(frame).value(), body.interior);
  EXPECT_LT(largest_request(), record.size() * 2);
  frame.resize(frame.size() / 6);
  EXPECT_FALSE(decode_interior(frame));
}

TEST(BodyInterior, SurvivesDamage) {
  const TileBody body = real_body();
  const Bytes record = encode_body(body);
  ByteWriter columns;
  write_vertices(columns, body.interior);
  for (std::size_t n = 0; n < record.size(); ++n) {
    const auto interior = decode_interior(ByteView(record).first(n));
    EXPECT_FALSE(n < columns.size() && interior) << "cut at " << n;
    EXPECT_TRUE(!interior || *interior == body.interior) << "cut at " << n;
  }
  const Bytes packed = zstd_compress(record, 3);
  for (const Bytes& value : {record, packed}) {
    for (std::int64_t k = 0; k < 3000; ++k) {
      Bytes bytes = value;
      const double range = static_cast<double>(k % 2 ? value.size() - 8 : 40);
      const auto at = static_cast<std::size_t>((is_zstd_frame(value) ? 8 : 0) + noise(1, k, 0) * range);
      bytes[at] ^= static_cast<std::uint8_t>(1 + noise(2, k, 0) * 255);
      reset_largest_request();
      const auto interior = decode_interior(bytes);
      EXPECT_LE(largest_request(), 16 * record.size() + (1 << 20));
      // Stricter than decode_body in nothing.
      const auto whole = unpack_value(bytes);
      const auto decoded = whole ? decode_body(*whole) : fail(ErrorKind::kCorrupt, "");
      if (decoded) {
        EXPECT_EQ(interior.value(), decoded->interior);
      }
    }
  }
}

TEST(Decoders, RefuseCountsThatTheBytesCannotHold) {
  // tag, count 2^60, then next to nothing
  const Bytes huge = {0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x10};
  Bytes edge = {'E'};
  edge.insert(edge.end(), huge.begin(), huge.end());
  edge.insert(edge.end(), {1, 1, 0, 0});
  const Bytes body_record = encode_body(TileBody{});  // all counts zero
  reset_largest_request();
  EXPECT_FALSE(decode_edge(edge));
  for (std::size_t at = 1; at < body_record.size(); ++at) {
    Bytes body = body_record;
    body.erase(body.begin() + static_cast<std::ptrdiff_t>(at));
    body.insert(body.begin() + static_cast<std::ptrdiff_t>(at), huge.begin(), huge.end());
    (void)decode_body(body);
  }
  EXPECT_LT(largest_request(), 4096u);
}

TEST(Value, IsTheShorterOfRecordAndFrame) {
  const Bytes small = encode_corner({5});
  EXPECT_EQ(pack_value(small), small);
  const Bytes large = encode_body(real_body());
  const Bytes packed = pack_value(large);
  EXPECT_LT(packed.size(), large.size());
  EXPECT_TRUE(is_zstd_frame(packed));
  EXPECT_EQ(unpack_value(packed).value(), large);
  EXPECT_EQ(unpack_value(small).value(), small);
}

TEST(Value, OfABodyIsShorterBySections) {
  for (const TileBody& body : {real_body(), large_body(), TileBody{}}) {
    const Bytes record = encode_body(body), packed = pack_body(body), plain = pack_value(record);
    EXPECT_EQ(unpack_value(packed).value(), record);
    EXPECT_LE(packed.size(), record.size());
    if (record.size() > 4096) {
      EXPECT_LT(packed.size(), plain.size());
    }
  }
}

TEST(Value, DoesNotDependOnWhatWasPackedBefore) {
  const Bytes first = pack_body(real_body());
  pack_body(large_body());
  pack_value(encode_edge(real_edge()));
  EXPECT_EQ(pack_body(real_body()), first);
}

TEST(Value, KeepsSectionsOfNoBytes) {
  Bytes record(1000, 7);
  const std::array<std::size_t, 4> ends = {0, 500, 500, 1000};
  const Bytes packed = pack_value(record, ends);
  EXPECT_TRUE(is_zstd_frame(packed));
  EXPECT_EQ(unpack_value(packed).value(), record);
}

TEST(Value, SurvivesDamage) {
  const Bytes record = encode_body(real_body());
  const Bytes packed = pack_value(record);
  for (std::size_t n = 4; n < packed.size(); ++n) {
    EXPECT_FALSE(unpack_value(ByteView(packed).first(n))) << n;
  }
  for (std::int64_t k = 0; k < 2000; ++k) {
    Bytes bytes = packed;
    // Behind the frame's header: the announced size stays.
    const auto at = static_cast<std::size_t>(8 + noise(1, k, 0) * static_cast<double>(bytes.size() - 8));
    bytes[at] ^= static_cast<std::uint8_t>(1 + noise(2, k, 0) * 255);
    reset_largest_request();
    if (const auto out = unpack_value(bytes)) (void)decode_body(*out);
    EXPECT_LE(largest_request(), 16 * record.size() + (1 << 20));
  }
}

TEST(Value, RefusesAFrameThatAnnouncesTooMuchOrNothing) {
  // Single segment, 8-byte content size of 256 MiB + 1 and of 2^62; then a frame without a size.
  Bytes frame = {0x28, 0xb5, 0x2f, 0xfd, 0xe0, 0x01, 0, 0, 0x10, 0, 0, 0, 0, 1, 0, 0};
  reset_largest_request();
  auto out = unpack_value(frame);
  ASSERT_FALSE(out);
  EXPECT_EQ(out.error().kind, ErrorKind::kCorrupt);
  frame[12] = 0x40;
  EXPECT_FALSE(unpack_value(frame));
  EXPECT_FALSE(unpack_value(Bytes{0x28, 0xb5, 0x2f, 0xfd, 0x00, 0x58, 1, 0, 0}));
  EXPECT_FALSE(unpack_value(Bytes{0x28, 0xb5, 0x2f, 0xfd}));
  EXPECT_LT(largest_request(), 4096u);
}

TEST(ZstdFrame, KeepsTheWindowWithinBrowsersReach) {
  // 20 MB that do not compress to nothing: the frame header's window log must not exceed 23.
  Bytes bytes(20 << 20);
  for (std::size_t k = 0; k < bytes.size(); ++k) bytes[k] = static_cast<std::uint8_t>((k * 2654435761u) >> 29);
  const Bytes frame = zstd_compress(bytes, 1);
  ASSERT_GT(frame.size(), 6u);
  ASSERT_EQ(frame[4] & 0x20, 0) << "a single segment's window is its content";
  EXPECT_LE(10 + (frame[5] >> 3), 23);
  EXPECT_EQ(frame[4] & 0x03, 0) << "no dictionary";
  EXPECT_EQ(unpack_value(frame).value(), bytes);
}

TEST(ManifestRecord, ComesBack) {
  const Manifest m = real_manifest();
  const std::string text = encode_manifest(m);
  const auto back = decode_manifest(Bytes(text.begin(), text.end()));
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(encode_manifest(*back), text);
  EXPECT_EQ(back->sources[0].name, m.sources[0].name);
  EXPECT_EQ(text.find('\n'), std::string::npos);
}

TEST(ManifestRecord, KnowsItsTiles) {
  const Manifest m = real_manifest();
  EXPECT_TRUE(m.has_tile({0, 0, 0}));
  EXPECT_TRUE(m.has_tile({0, 1, 0}));
  EXPECT_TRUE(m.has_tile({1, 1, 0}));
  EXPECT_FALSE(m.has_tile({1, 2, 0}));
  EXPECT_TRUE(m.has_tile({1, 3, 1}));
  EXPECT_FALSE(m.has_tile({1, 4, 1}));
  EXPECT_FALSE(m.has_tile({2, 0, 0}));
  EXPECT_FALSE(m.has_tile({200, 0, 0}));
}

TEST(ManifestRecord, SurvivesDamage) {
  const std::string text = encode_manifest(real_manifest());
  torment(Bytes(text.begin(), text.end()), 16, [](ByteView b) { return decode_manifest(b).has_value(); });
  const std::string deep(100000, '[');
  EXPECT_FALSE(decode_manifest(Bytes(deep.begin(), deep.end())));
}

TEST(ManifestRecord, RefusesValuesOutOfRange) {
  const auto decode_with = [](const std::string& from, const std::string& to) {
    std::string text = encode_manifest(real_manifest());
    const auto at = text.find(from);
    EXPECT_NE(at, std::string::npos) << from;
    text.replace(at, from.size(), to);
    return decode_manifest(Bytes(text.begin(), text.end()));
  };
  EXPECT_TRUE(decode_with("\"height_exponent\":0", "\"height_exponent\":3"));
  for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
           {"\"height_exponent\":0", "\"height_exponent\":17"},
           {"\"height_exponent\":0", "\"height_exponent\":-1"},
           {"\"lattice_level\":9", "\"lattice_level\":29"},
           {"\"lattice_level\":9", "\"lattice_level\":0"},
           {"\"bottom_level\":1", "\"bottom_level\":2"},
           {"\"bottom_level\":1", "\"bottom_level\":-1"},
           {"\"root_count_x\":2", "\"root_count_x\":1"},
           {"\"format\":\"tind\"", "\"format\":\"mbtiles\""},
           {"\"tolerance_m\":1.0", "\"tolerance_m\":-1.0"},
           {"\"tolerance_m\":1.0", "\"tolerance_m\":\"1\""},
           {"[0,1,1,1]", "[0,1,2,1]"},  // beyond the level
           {"[0,1,1,1]", "[0,0,1,1]"},  // overlaps the run before
           {"[0,1,1,1]", "[0,1,1,3]"},  // no such coverage
           {"[0,1,1,1]", "[0,1,-1,1]"},
           {"\"inverse_flattening\":298.257223563", "\"inverse_flattening\":0.5"}}) {
    const auto m = decode_with(from, to);
    ASSERT_FALSE(m) << to;
    EXPECT_EQ(m.error().kind, ErrorKind::kCorrupt) << to;
  }
  EXPECT_EQ(decode_with("\"format_version\":1", "\"format_version\":2").error().kind, ErrorKind::kUnsupported);
}

}  // namespace
}  // namespace tind::test
