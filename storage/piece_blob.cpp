// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/piece_blob.hpp"

#include <algorithm>
#include <limits>
#include <optional>
#include <string>

#include "core/format/vn.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr std::uint8_t kCornerTag = 'C';
constexpr std::uint8_t kEdgeTag = 'E';
constexpr std::uint8_t kBodyTag = 'B';

tl::unexpected<Error> corrupt(const char* what) {
  return fail(ErrorKind::kCorrupt, std::string("broken ") + what + " record");
}

// Adds a delta from untrusted bytes; fails the reader instead of overflowing.
std::int64_t add_delta(ByteReader& in, std::int64_t value, std::int64_t delta) {
  std::int64_t sum = 0;
  if (__builtin_add_overflow(value, delta, &sum)) in.set_failed();
  return sum;
}

std::int32_t to_height(ByteReader& in, std::int64_t value) {
  if (value < std::numeric_limits<std::int32_t>::min() || value > std::numeric_limits<std::int32_t>::max()) {
    in.set_failed();
    return 0;
  }
  return static_cast<std::int32_t>(value);
}

std::uint32_t to_u32(ByteReader& in, std::uint64_t value) {
  if (value > std::numeric_limits<std::uint32_t>::max()) in.set_failed();
  return static_cast<std::uint32_t>(value);
}

}  // namespace

Bytes encode_corner(const Corner& corner) {
  ByteWriter out;
  out.fixed(kCornerTag);
  out.svarint(corner.z);
  return out.take();
}

Result<Corner> decode_corner(ByteView record) {
  ByteReader in(record);
  if (in.fixed<std::uint8_t>() != kCornerTag) return corrupt("corner");
  Corner corner;
  corner.z = to_height(in, in.svarint());
  if (!in.finished()) return corrupt("corner");
  return corner;
}

Bytes encode_edge(const EdgeChain& edge) {
  ByteWriter out;
  out.fixed(kEdgeTag);
  out.uvarint(edge.inner.size());
  out.fixed(edge.start_entry);
  out.fixed(edge.end_entry);
  for (const EdgeVertex& v : edge.inner) out.fixed(v.entry);
  std::int64_t t = 0, z = 0;
  for (const EdgeVertex& v : edge.inner) {
    out.uvarint(static_cast<std::uint64_t>(v.t - t));
    t = v.t;
  }
  out.svarints(edge.inner, [&](const EdgeVertex& v, auto put) {
    put(v.z - z);
    z = v.z;
  });
  return out.take();
}

Result<EdgeChain> decode_edge(ByteView record) {
  ByteReader in(record);
  if (in.fixed<std::uint8_t>() != kEdgeTag) return corrupt("edge");
  EdgeChain edge;
  const std::uint64_t n = in.count(3);
  edge.start_entry = in.fixed<std::uint8_t>();
  edge.end_entry = in.fixed<std::uint8_t>();
  edge.inner.resize(in.ok() ? n : 0);
  for (EdgeVertex& v : edge.inner) v.entry = in.fixed<std::uint8_t>();
  std::int64_t t = 0, z = 0;
  for (EdgeVertex& v : edge.inner) {
    const std::uint64_t step = in.uvarint();
    if (step == 0 || step > (std::uint64_t{1} << 62)) in.set_failed();
    v.t = t = add_delta(in, t, static_cast<std::int64_t>(step));
    if (!in.ok()) return corrupt("edge");
  }
  for (EdgeVertex& v : edge.inner) {
    z = add_delta(in, z, in.svarint());
    v.z = to_height(in, z);
  }
  if (!in.finished()) return corrupt("edge");
  return edge;
}

namespace {

// Writes the record and gives the ends of all but the last of its columns.
std::array<std::size_t, 4> write_body(ByteWriter& out, const TileBody& body) {
  // What is usual; more is taken where it is needed.
  out.reserve(64 + 8 * body.interior.size() + 5 * body.triangles.size() + 16 * body.virtual_triangles.size());
  out.fixed(kBodyTag);
  out.fixed(static_cast<std::uint8_t>(body.stats.coverage));
  out.svarint(body.stats.min_z);
  out.svarint(body.stats.max_z);
  out.uvarint(body.stats.n_posts);
  out.fixed(body.stats.max_error_m);
  out.fixed(body.stats.rmse_m);
  for (const std::uint32_t n : body.n_side) out.uvarint(n);
  out.uvarint(body.interior.size());
  out.uvarint(body.triangles.size());
  out.fixed(body.n_gaps);
  out.uvarint(body.virtual_triangles.size());
  const auto [x_end, y_end, z_end] = write_vertices(out, body.interior);
  write_triangles(out, body.triangles);
  const std::size_t triangles_end = out.size();
  write_virtual_triangles(out, body.virtual_triangles);
  return {x_end, y_end, z_end, triangles_end};
}

}  // namespace

Bytes encode_body(const TileBody& body) {
  ByteWriter out;
  write_body(out, body);
  return out.take();
}

Bytes pack_body(const TileBody& body) {
  ByteWriter out;
  const auto column_ends = write_body(out, body);
  return pack_value(out.take(), column_ends);
}

namespace {

// The most bytes before the arrays of a body record: three of u8, two of f32, ten varints.
constexpr std::uint64_t kLongestHeadBytes = 3 + 2 * 4 + 10 * 10;

struct BodyHead {
  TileStats stats;
  std::array<std::uint32_t, 4> n_side{};
  std::uint64_t n_interior = 0, n_triangles = 0, n_vts = 0;
  std::uint8_t n_gaps = 0;
};

// `in` may hold only the start of the record: counts are checked against the `record_bytes` that it has as a whole.
// nullopt: broken, or cut off within the head.
std::optional<BodyHead> read_body_head(ByteReader& in, std::uint64_t record_bytes) {
  BodyHead head;
  if (in.fixed<std::uint8_t>() != kBodyTag) return std::nullopt;
  const auto coverage = in.fixed<std::uint8_t>();
  if (coverage > static_cast<std::uint8_t>(TileCoverage::kReal)) return std::nullopt;
  head.stats.coverage = static_cast<TileCoverage>(coverage);
  head.stats.min_z = to_height(in, in.svarint());
  head.stats.max_z = to_height(in, in.svarint());
  head.stats.n_posts = in.uvarint();
  head.stats.max_error_m = in.fixed<float>();
  head.stats.rmse_m = in.fixed<float>();
  for (std::uint32_t& n : head.n_side) n = to_u32(in, in.uvarint());
  head.n_interior = in.uvarint();
  head.n_triangles = in.uvarint();
  head.n_gaps = in.fixed<std::uint8_t>();
  head.n_vts = in.uvarint();
  if (!in.ok() || head.n_gaps > kMaxLevel || in.position() > record_bytes) return std::nullopt;
  // Each vertex, triangle and virtual triangle takes three bytes or more.
  std::uint64_t left = record_bytes - in.position();
  for (const std::uint64_t n : {head.n_interior, head.n_triangles, head.n_vts}) {
    if (n > left / 3) return std::nullopt;
    left -= 3 * n;
  }
  return head;
}

// The three columns of `vertices`; fails the reader on anything out of range.
void read_vertices(ByteReader& in, std::vector<LocalVertex>& vertices) {
  const auto column = [&](auto take) {
    std::int64_t value = 0;
    bool overflow = false;
    in.svarints(vertices, [&](LocalVertex& v, auto get) {
      overflow |= __builtin_add_overflow(value, get(), &value);
      take(v, value);
    });
    if (overflow) in.set_failed();
  };
  column([](LocalVertex& v, std::int64_t x) { v.x = x; });
  column([](LocalVertex& v, std::int64_t y) { v.y = y; });
  bool too_large = false;
  column([&](LocalVertex& v, std::int64_t z) {
    v.z = static_cast<std::int32_t>(z);
    too_large |= v.z != z;
  });
  if (too_large) in.set_failed();
}

// The triangle list, likewise.
void read_triangles(ByteReader& in, std::vector<Triangle>& triangles) {
  std::int64_t previous = 0;
  bool bad = false;
  in.svarints(triangles, [&](Triangle& t, auto get) {
    for (std::uint32_t& index : t) {
      bad |= __builtin_add_overflow(previous, get(), &previous);
      index = static_cast<std::uint32_t>(previous);
      bad |= index != previous;
    }
  });
  if (bad) in.set_failed();
}

}  // namespace

Result<BodySummary> decode_body_summary(ByteView value) {
  std::uint64_t record_bytes = value.size();
  const auto start = unpack_start(value, [&](ByteView so_far, std::uint64_t whole_bytes) {
    record_bytes = whole_bytes;
    return so_far.size() >= kLongestHeadBytes;
  });
  if (!start) return tl::unexpected(start.error());
  ByteReader in(*start);
  const auto head = read_body_head(in, record_bytes);
  if (!head) return corrupt("body");
  return BodySummary{head->stats, head->n_interior, head->n_triangles};
}

Result<std::vector<LocalVertex>> decode_interior(ByteView value) {
  std::uint64_t record_bytes = value.size();
  std::size_t n_counted = 0;               // bytes whose varints are counted
  std::optional<std::uint64_t> n_missing;  // varints of the columns that are still to come
  const auto enough = [&](ByteView so_far, std::uint64_t whole_bytes) {
    record_bytes = whole_bytes;
    if (!n_missing) {
      ByteReader in(so_far);
      const auto head = read_body_head(in, whole_bytes);
      if (!head) return so_far.size() >= kLongestHeadBytes;  // then it is broken, and more bytes would not mend it
      n_counted = in.position();
      n_missing = 3 * head->n_interior;
    }
    std::uint64_t n_ends = 0;  // a varint ends with a byte below 0x80
    for (const std::uint8_t byte : so_far.subspan(n_counted)) n_ends += byte < 0x80;
    n_counted = so_far.size();
    *n_missing -= std::min(*n_missing, n_ends);
    return *n_missing == 0;
  };
  const auto start = unpack_start(value, enough);
  if (!start) return tl::unexpected(start.error());
  ByteReader in(*start);
  const auto head = read_body_head(in, record_bytes);
  if (!head) return corrupt("body");
  std::vector<LocalVertex> interior(head->n_interior);
  read_vertices(in, interior);
  if (!in.ok()) return corrupt("body");
  return interior;
}

Result<TileBody> decode_body(ByteView record) {
  ByteReader in(record);
  const auto head = read_body_head(in, record.size());
  if (!head) return corrupt("body");
  const std::uint64_t n_triangles = head->n_triangles, n_vts = head->n_vts;
  TileBody body;
  body.stats = head->stats;
  body.n_side = head->n_side;
  body.n_gaps = head->n_gaps;
  body.interior.resize(head->n_interior);
  read_vertices(in, body.interior);
  if (!in.ok()) return corrupt("body");
  body.triangles.resize(n_triangles);
  read_triangles(in, body.triangles);
  if (!in.ok()) return corrupt("body");
  // At most two border edges a triangle, so what is reserved stays in proportion to the bytes.
  if (n_vts > n_triangles) return corrupt("body");
  body.virtual_triangles.reserve(n_vts);
  for (std::uint64_t i = 0; i < n_vts; ++i) {
    VirtualTriangle vt;
    vt.triangle = to_u32(in, in.uvarint());
    const auto shape = in.fixed<std::uint8_t>();
    vt.n_edges = shape & 3;
    vt.border = (shape >> 2) & 3;
    vt.interval = to_u32(in, in.uvarint());
    if (!in.ok() || vt.n_edges < 1 || vt.n_edges > 2 || (shape >> 4) != 0) return corrupt("body");
    vt.runs.resize(std::size_t{vt.n_edges} * body.n_gaps);
    for (std::uint32_t& run : vt.runs) run = to_u32(in, in.uvarint());
    body.virtual_triangles.push_back(std::move(vt));
  }
  if (!in.finished()) return corrupt("body");
  return body;
}

}  // namespace tind
