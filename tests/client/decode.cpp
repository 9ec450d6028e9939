// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/decode.hpp"

#include <zstd.h>

#include <algorithm>
#include <limits>

namespace tind::client {
namespace {

constexpr std::uint64_t kMaxRecordBytes = std::uint64_t{256} << 20;
constexpr std::int64_t kMaxCoordinate = std::int64_t{1} << 46;

bool fits_height(std::int64_t z) {
  return z >= std::numeric_limits<std::int32_t>::min() && z <= std::numeric_limits<std::int32_t>::max();
}

/// Adds a delta that any bytes may have made as large as it gets; false when the sum leaves (-limit, limit).
bool add_delta(std::int64_t& value, std::int64_t delta, std::int64_t limit) {
  std::int64_t sum = 0;
  if (__builtin_add_overflow(value, delta, &sum) || sum <= -limit || sum >= limit) return false;
  value = sum;
  return true;
}

/// Reads n vertices as three delta chains.
bool take_vertices(ByteCursor& in, std::uint64_t n, std::vector<Vertex>& out) {
  if (!in.expect(n, 3)) return false;
  out.resize(n);
  std::int64_t value = 0;
  for (auto& v : out) {
    if (!add_delta(value, in.take_signed(), kMaxCoordinate)) return false;
    v.x = value;
  }
  value = 0;
  for (auto& v : out) {
    if (!add_delta(value, in.take_signed(), kMaxCoordinate)) return false;
    v.y = value;
  }
  value = 0;
  for (auto& v : out) {
    if (!add_delta(value, in.take_signed(), kMaxCoordinate) || !fits_height(value)) return false;
    v.z = static_cast<std::int32_t>(value);
  }
  return !in.bad();
}

bool take_triangles(ByteCursor& in, std::uint64_t n, std::uint64_t n_vertices, std::vector<Corners>& out) {
  if (!in.expect(n, 3)) return false;
  out.resize(n);
  std::int64_t index = 0;
  for (auto& corners : out) {
    for (auto& corner : corners) {
      if (!add_delta(index, in.take_signed(), kMaxCoordinate)) return false;
      if (index < 0 || static_cast<std::uint64_t>(index) >= n_vertices) return false;
      corner = static_cast<std::uint32_t>(index);
    }
  }
  return !in.bad();
}

Outcome<void> take_vts(ByteCursor& in, std::uint64_t n, Tile& tile) {
  const std::uint64_t bytes_each = 3 + std::uint64_t{tile.n_gaps};
  if (!in.expect(n, bytes_each)) return refuse("fewer bytes than the virtual triangles need");
  tile.vts.resize(n);
  for (auto& vt : tile.vts) {
    const std::uint64_t triangle = in.take_unsigned();
    const auto shape = in.take<std::uint8_t>();
    const std::uint64_t interval = in.take_unsigned();
    if (in.bad()) return refuse("virtual triangles end early");
    vt.n_edges = shape & 3;
    vt.border = (shape >> 2) & 3;
    if (triangle >= tile.triangles.size()) return refuse("a virtual triangle names a triangle that does not exist");
    if (vt.n_edges < 1 || vt.n_edges > 2 || (shape >> 4) != 0) return refuse("a virtual triangle has no valid shape");
    if (interval > tile.n_side[vt.border]) return refuse("a virtual triangle names an interval that does not exist");
    vt.triangle = static_cast<std::uint32_t>(triangle);
    vt.interval = static_cast<std::uint32_t>(interval);
    vt.first_run = static_cast<std::uint32_t>(tile.runs.size());
    for (std::size_t k = 0; k < tile.runs_size(vt); ++k) {
      const std::uint64_t run = in.take_unsigned();
      if (run > std::numeric_limits<std::uint32_t>::max()) return refuse("a run is larger than any border");
      tile.runs.push_back(static_cast<std::uint32_t>(run));
    }
    if (in.bad()) return refuse("runs end early");
  }
  return {};
}

}  // namespace

std::vector<SideVertex> ring_side(const Tile& tile, int b) {
  const auto border = static_cast<std::size_t>(b);
  const std::uint32_t n = tile.n_side[border] + 2;
  std::vector<SideVertex> side(n);
  for (std::uint32_t k = 0; k < n; ++k) {
    const Vertex& v = tile.vertices[tile.ring_index(b, k)];
    side[k] = {b == 0 || b == 2 ? v.x : v.y, v.z, tile.entries[border][k]};
  }
  return side;
}

std::vector<SideVertex> stored_side(const Tile& tile, int b) {
  auto side = ring_side(tile, b);
  if (b >= 2) std::reverse(side.begin(), side.end());
  return side;
}

Outcome<Blob> open_value(BlobView value) {
  static constexpr std::uint8_t kMagic[4] = {0x28, 0xb5, 0x2f, 0xfd};
  if (value.size() < 4 || !std::equal(kMagic, kMagic + 4, value.begin())) return Blob(value.begin(), value.end());
  const unsigned long long size = ZSTD_getFrameContentSize(value.data(), value.size());
  if (size == ZSTD_CONTENTSIZE_UNKNOWN || size == ZSTD_CONTENTSIZE_ERROR) {
    return refuse("a zstd frame does not announce its size");
  }
  if (size > kMaxRecordBytes) return refuse("a zstd frame announces more than 256 MiB");
  const std::size_t frame = ZSTD_findFrameCompressedSize(value.data(), value.size());
  if (ZSTD_isError(frame) != 0 || frame != value.size()) return refuse("a value is not exactly one zstd frame");
  Blob record(size);
  const std::size_t got = ZSTD_decompress(record.data(), record.size(), value.data(), value.size());
  if (ZSTD_isError(got) != 0) return refuse(std::string("zstd: ") + ZSTD_getErrorName(got));
  if (got != size) return refuse("a zstd frame holds less than it announces");
  return record;
}

Outcome<std::int32_t> read_corner(BlobView record) {
  ByteCursor in(record);
  if (in.take<std::uint8_t>() != 'C') return refuse("corner record: tag is not 'C'");
  const std::int64_t z = in.take_signed();
  if (in.bad()) return refuse("corner record: ends early");
  if (in.left() != 0) return refuse("corner record: bytes left over");
  if (!fits_height(z)) return refuse("corner record: height out of range");
  return static_cast<std::int32_t>(z);
}

Outcome<EdgeRecord> read_edge(BlobView record, std::int64_t side) {
  ByteCursor in(record);
  if (in.take<std::uint8_t>() != 'E') return refuse("edge record: tag is not 'E'");
  const std::uint64_t n = in.take_unsigned();
  EdgeRecord edge;
  edge.start_entry = in.take<std::uint8_t>();
  edge.end_entry = in.take<std::uint8_t>();
  if (!in.expect(n, 3)) return refuse("edge record: fewer bytes than its count needs");
  edge.inner.resize(n);
  for (auto& v : edge.inner) v.entry = in.take<std::uint8_t>();
  std::int64_t t = 0;
  for (auto& v : edge.inner) {
    const std::uint64_t step = in.take_unsigned();
    if (in.bad()) return refuse("edge record: ends early");
    if (step == 0 || step >= static_cast<std::uint64_t>(side - t)) {
      return refuse("edge record: positions do not ascend strictly inside the side");
    }
    t += static_cast<std::int64_t>(step);
    v.t = t;
  }
  std::int64_t z = 0;
  for (auto& v : edge.inner) {
    if (!add_delta(z, in.take_signed(), kMaxCoordinate) || !fits_height(z)) {
      return refuse("edge record: height out of range");
    }
    v.z = static_cast<std::int32_t>(z);
  }
  if (in.bad()) return refuse("edge record: ends early");
  if (in.left() != 0) return refuse("edge record: bytes left over");
  return edge;
}

Outcome<Tile> read_body(BlobView record) {
  ByteCursor in(record);
  if (in.take<std::uint8_t>() != 'B') return refuse("body record: tag is not 'B'");
  Tile body;
  body.coverage = in.take<std::uint8_t>();
  const std::int64_t min_z = in.take_signed(), max_z = in.take_signed();
  body.n_posts = in.take_unsigned();
  body.max_error_m = in.take<float>();
  body.rmse_m = in.take<float>();
  std::uint64_t ring = 4;
  for (auto& n : body.n_side) {
    const std::uint64_t count = in.take_unsigned();
    if (count > std::numeric_limits<std::uint32_t>::max() / 8) return refuse("body record: n_side out of range");
    n = static_cast<std::uint32_t>(count);
    ring += count;
  }
  const std::uint64_t n_interior = in.take_unsigned(), n_triangles = in.take_unsigned();
  body.n_gaps = in.take<std::uint8_t>();
  const std::uint64_t n_vts = in.take_unsigned();
  if (in.bad()) return refuse("body record: ends early");
  if (body.coverage > 2) return refuse("body record: coverage is not 0, 1 or 2");
  if (!fits_height(min_z) || !fits_height(max_z)) return refuse("body record: height out of range");
  body.min_z = static_cast<std::int32_t>(min_z);
  body.max_z = static_cast<std::int32_t>(max_z);
  if (!take_vertices(in, n_interior, body.vertices)) return refuse("body record: interior vertices are broken");
  if (!take_triangles(in, n_triangles, ring + n_interior, body.triangles)) {
    return refuse("body record: triangles are broken");
  }
  if (auto ok = take_vts(in, n_vts, body); !ok) return refuse("body record: " + ok.error());
  if (in.left() != 0) return refuse("body record: bytes left over");
  return body;
}

Outcome<VnTile> read_vn(BlobView bytes) {
  ByteCursor in(bytes);
  const BlobView magic = in.take_bytes(4);
  static constexpr std::uint8_t kMagic[4] = {'T', 'V', 'N', '1'};
  if (magic.size() != 4 || !std::equal(magic.begin(), magic.end(), kMagic)) return refuse(".vn: magic is not 'TVN1'");
  VnTile vn;
  Tile& tile = vn.tile;
  tile.id.level = in.take<std::uint8_t>();
  vn.lattice_level = in.take<std::uint8_t>();
  vn.height_exponent = in.take<std::uint8_t>();
  tile.coverage = in.take<std::uint8_t>();
  tile.id.x = in.take<std::uint32_t>();
  tile.id.y = in.take<std::uint32_t>();
  vn.tolerance_m = in.take<float>();
  tile.max_error_m = in.take<float>();
  tile.rmse_m = in.take<float>();
  tile.min_z = in.take<std::int32_t>();
  tile.max_z = in.take<std::int32_t>();
  std::uint64_t n = 4;
  for (auto& side : tile.n_side) n += side = in.take<std::uint32_t>();
  const std::uint64_t n_interior = in.take<std::uint32_t>();
  const std::uint64_t n_triangles = in.take<std::uint32_t>();
  const std::uint64_t n_vts = in.take<std::uint32_t>();
  tile.n_gaps = in.take<std::uint8_t>();
  const BlobView reserved = in.take_bytes(3);
  tile.n_posts = in.take<std::uint64_t>();
  if (in.bad()) return refuse(".vn: ends inside its header");
  if (!tile.id.valid()) return refuse(".vn: no such tile as its header names");
  if (tile.coverage > 2) return refuse(".vn: coverage is not 0, 1 or 2");
  if (reserved[0] != 0 || reserved[1] != 0 || reserved[2] != 0) return refuse(".vn: reserved bytes are not 0");
  for (std::size_t b = 0; b < 4; ++b) {
    const BlobView entries = in.take_bytes(std::size_t{tile.n_side[b]} + 2);
    if (in.bad()) return refuse(".vn: ends inside the entry levels");
    tile.entries[b].assign(entries.begin(), entries.end());
  }
  if (!take_vertices(in, n + n_interior, tile.vertices)) return refuse(".vn: vertices are broken or end early");
  if (!take_triangles(in, n_triangles, n + n_interior, tile.triangles)) {
    return refuse(".vn: triangles are broken or end early");
  }
  if (auto ok = take_vts(in, n_vts, tile); !ok) return refuse(".vn: " + ok.error());
  if (in.left() != 0) return refuse(".vn: bytes left over");
  return vn;
}

Outcome<Bundle> read_bundle(BlobView bytes) {
  ByteCursor in(bytes);
  const BlobView magic = in.take_bytes(4);
  static constexpr std::uint8_t kMagic[4] = {'T', 'V', 'P', '1'};
  if (magic.size() != 4 || !std::equal(magic.begin(), magic.end(), kMagic)) {
    return refuse(".parts: magic is not 'TVP1'");
  }
  Bundle bundle;
  bundle.id.level = in.take<std::uint8_t>();
  const auto count = in.take<std::uint8_t>();
  const auto reserved = in.take<std::uint16_t>();
  bundle.id.x = in.take<std::uint32_t>();
  bundle.id.y = in.take<std::uint32_t>();
  std::array<std::uint32_t, 9> lengths{};
  for (auto& length : lengths) length = in.take<std::uint32_t>();
  if (in.bad()) return refuse(".parts: ends inside its header");
  if (count != 9 || reserved != 0 || !bundle.id.valid()) return refuse(".parts: header is broken");
  for (std::size_t k = 0; k < 9; ++k) {
    bundle.values[k] = in.take_bytes(lengths[k]);
    if (in.bad()) return refuse(".parts: ends inside value " + std::to_string(k));
  }
  if (in.left() != 0) return refuse(".parts: bytes left over");
  return bundle;
}

Outcome<Pieces> read_pieces(const Bundle& bundle, const LatticeFrame& frame) {
  static constexpr std::array<const char*, 9> kNames = {"C0", "B0", "C1", "B1", "C2", "B2", "C3", "B3", "body"};
  if (bundle.id.level > frame.lattice_level) return refuse("level is below the lattice");
  Pieces pieces;
  for (std::size_t k = 0; k < 9; ++k) {
    const auto named = [&](const std::string& why) { return refuse(std::string(kNames[k]) + ": " + why); };
    auto record = open_value(bundle.values[k]);
    if (!record) return named(record.error());
    if (k == 8) {
      auto body = read_body(*record);
      if (!body) return named(body.error());
      pieces.body = std::move(*body);
    } else if (k % 2 == 0) {
      auto z = read_corner(*record);
      if (!z) return named(z.error());
      pieces.corner_z[k / 2] = *z;
    } else {
      auto edge = read_edge(*record, frame.side(bundle.id.level));
      if (!edge) return named(edge.error());
      pieces.edges[k / 2] = std::move(*edge);
    }
  }
  return pieces;
}

Outcome<Tile> assemble_pieces(const TileId& id, const Pieces& pieces, const LatticeFrame& frame) {
  const std::int64_t s = frame.side(id.level);
  const std::array<Vertex, 4> corners = {Vertex{0, 0, pieces.corner_z[0]}, Vertex{s, 0, pieces.corner_z[1]},
                                         Vertex{s, s, pieces.corner_z[2]}, Vertex{0, s, pieces.corner_z[3]}};
  Tile tile = pieces.body;
  tile.id = id;
  tile.vertices.clear();
  for (std::size_t b = 0; b < 4; ++b) {
    const EdgeRecord& edge = pieces.edges[b];
    if (edge.inner.size() != tile.n_side[b]) {
      return refuse(std::string("the ") + kBorderNames[b] + " edge record has " + std::to_string(edge.inner.size()) +
                    " inner vertices, the body counts " + std::to_string(tile.n_side[b]));
    }
    auto inner = edge.inner;
    std::uint8_t first = edge.start_entry, last = edge.end_entry;
    if (b >= 2) {  // north and west run against their stored direction
      std::reverse(inner.begin(), inner.end());
      std::swap(first, last);
    }
    tile.vertices.push_back(corners[b]);
    tile.entries[b].push_back(first);
    for (const SideVertex& v : inner) {
      const Vertex on_side[4] = {{v.t, 0, v.z}, {s, v.t, v.z}, {v.t, s, v.z}, {0, v.t, v.z}};
      tile.vertices.push_back(on_side[b]);
      tile.entries[b].push_back(v.entry);
    }
    tile.entries[b].push_back(last);
  }
  tile.vertices.insert(tile.vertices.end(), pieces.body.vertices.begin(), pieces.body.vertices.end());
  return tile;
}

}  // namespace tind::client
