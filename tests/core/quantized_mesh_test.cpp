// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/format/quantized_mesh.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <set>

#include "core/format/mesh_rounding.hpp"
#include "core/format/vertex_normals.hpp"

namespace tind {
namespace {

constexpr int kSteps = 32767;

Lattice make_lattice(int level, int height_exponent) {
  Lattice lattice;
  lattice.level = level;
  lattice.height_exponent = height_exponent;
  return lattice;
}

// ---- a decoder of its own, after SPECIFICATION.md ----

struct Decoded {
  double center[3], sphere[4], occlusion[3];
  double minimum, maximum;
  std::vector<int> u, v, q;
  std::vector<Triangle> triangles;
  std::array<std::vector<std::uint32_t>, 4> edges;  // west, south, east, north
  std::map<int, Bytes> extensions;

  // As loaders.gl and most others: one multiplication.
  double height(std::size_t i) const { return q[i] / 32767.0 * (maximum - minimum) + minimum; }
  // As CesiumJS and cesium-native: lerp.
  double height_lerp(std::size_t i) const {
    const double t = q[i] / 32767.0;
    return (1.0 - t) * minimum + t * maximum;
  }
};

Decoded decode(const Bytes& bytes) {
  Decoded d;
  ByteReader in(bytes);
  for (double& c : d.center) c = in.fixed<double>();
  d.minimum = static_cast<double>(in.fixed<float>());
  d.maximum = static_cast<double>(in.fixed<float>());
  for (double& c : d.sphere) c = in.fixed<double>();
  for (double& c : d.occlusion) c = in.fixed<double>();
  const auto n = in.fixed<std::uint32_t>();
  for (auto* values : {&d.u, &d.v, &d.q}) {
    int value = 0;
    for (std::uint32_t i = 0; i < n; ++i) {
      const int code = in.fixed<std::uint16_t>();
      value += (code >> 1) ^ -(code & 1);
      values->push_back(value);
    }
  }
  const bool wide = n > 65536;
  if (wide) {
    while (in.position() % 4 != 0) EXPECT_EQ(in.fixed<std::uint8_t>(), 0);
  }
  const auto index = [&]() -> std::uint32_t { return wide ? in.fixed<std::uint32_t>() : in.fixed<std::uint16_t>(); };
  const auto n_triangles = in.fixed<std::uint32_t>();
  std::uint32_t highest = 0;
  for (std::uint32_t t = 0; t < n_triangles; ++t) {
    Triangle triangle;
    for (auto& corner : triangle) {
      const std::uint32_t code = index();
      corner = highest - code;
      if (code == 0) ++highest;
    }
    d.triangles.push_back(triangle);
  }
  for (auto& edge : d.edges) {
    const auto count = in.fixed<std::uint32_t>();
    for (std::uint32_t k = 0; k < count; ++k) edge.push_back(index());
  }
  while (in.ok() && in.remaining() > 0) {
    const int id = in.fixed<std::uint8_t>();
    const auto length = in.fixed<std::uint32_t>();
    const ByteView view = in.raw(length);
    d.extensions[id] = Bytes(view.begin(), view.end());
  }
  EXPECT_TRUE(in.finished());
  return d;
}

void expect_valid(const Decoded& d) {
  std::int64_t doubled_area = 0;
  for (const Triangle& t : d.triangles) {
    for (const auto v : t) ASSERT_LT(v, d.u.size());
    const std::int64_t area = std::int64_t{d.u[t[1]] - d.u[t[0]]} * (d.v[t[2]] - d.v[t[0]]) -
                              std::int64_t{d.v[t[1]] - d.v[t[0]]} * (d.u[t[2]] - d.u[t[0]]);
    ASSERT_GT(area, 0);
    doubled_area += area;
  }
  ASSERT_EQ(doubled_area, std::int64_t{2} * kSteps * kSteps);
  for (std::size_t e = 0; e < 4; ++e) {
    const auto& along = e % 2 == 0 ? d.v : d.u;
    const auto& across = e % 2 == 0 ? d.u : d.v;
    ASSERT_GE(d.edges[e].size(), 2u);
    EXPECT_EQ(along[d.edges[e].front()], 0);
    EXPECT_EQ(along[d.edges[e].back()], kSteps);
    for (std::size_t k = 0; k < d.edges[e].size(); ++k) {
      EXPECT_EQ(across[d.edges[e][k]], e < 2 ? 0 : kSteps);
      if (k > 0) {
        EXPECT_LT(along[d.edges[e][k - 1]], along[d.edges[e][k]]);
      }
    }
  }
  // Every vertex on the border is in a list.
  std::size_t on_border = 0;
  for (std::size_t i = 0; i < d.u.size(); ++i) {
    on_border += d.u[i] == 0 || d.v[i] == 0 || d.u[i] == kSteps || d.v[i] == kSteps;
  }
  EXPECT_EQ(d.edges[0].size() + d.edges[1].size() + d.edges[2].size() + d.edges[3].size() - 4, on_border);
}

// ---- random meshes ----

// Grows a triangulation of the square by splitting triangles and edges, then flips edges at random.
class MeshMaker {
 public:
  MeshMaker(std::int64_t side, std::uint32_t seed) : side_(side), random_(seed) {
    for (const auto& [x, y] : {std::pair<std::int64_t, std::int64_t>{0, 0}, {side, 0}, {side, side}, {0, side}}) {
      points_.push_back({x, y, height()});
    }
    triangles_ = {{0, 1, 2}, {0, 2, 3}};
  }
  std::int32_t height() { return static_cast<std::int32_t>(random_() % 4000); }
  std::int64_t below(std::int64_t n) { return static_cast<std::int64_t>(random_() % static_cast<std::uint64_t>(n)); }

  void insert(std::int64_t x, std::int64_t y, std::int32_t z) {
    for (const LocalVertex& p : points_) {
      if (p.x == x && p.y == y) return;
    }
    const auto v = static_cast<std::uint32_t>(points_.size());
    points_.push_back({x, y, z});
    std::vector<Triangle> next;
    for (const Triangle& t : triangles_) {
      const std::array<int, 3> turn = {sign(t[0], t[1], v), sign(t[1], t[2], v), sign(t[2], t[0], v)};
      if (*std::min_element(turn.begin(), turn.end()) < 0) {
        next.push_back(t);
        continue;
      }
      for (std::size_t k = 0; k < 3; ++k) {
        if (turn[k] > 0) next.push_back({t[k], t[(k + 1) % 3], v});
      }
    }
    triangles_ = std::move(next);
  }
  void insert_random(int n, std::int64_t near_border) {
    for (int k = 0; k < n; ++k) {
      std::int64_t x = 1 + below(side_ - 1), y = 1 + below(side_ - 1);
      const auto kind = below(6);
      if (kind == 0) x = 1 + below(near_border);
      if (kind == 1) y = side_ - 1 - below(near_border);
      if (kind == 2) x = side_ / 3 + below(near_border), y = side_ / 3 + below(near_border);
      if (kind == 3) x = 0;
      if (kind == 4) y = 0;
      insert(x, y, height());
    }
  }
  void flip_random(int n) {
    for (int k = 0; k < n; ++k) {
      Triangle& s = triangles_[static_cast<std::size_t>(below(static_cast<std::int64_t>(triangles_.size())))];
      Triangle& t = triangles_[static_cast<std::size_t>(below(static_cast<std::int64_t>(triangles_.size())))];
      for (std::size_t i = 0; i < 3; ++i) {
        for (std::size_t j = 0; j < 3; ++j) {
          const std::uint32_t a = s[i], b = s[(i + 1) % 3], c = s[(i + 2) % 3];
          if (t[j] != b || t[(j + 1) % 3] != a) continue;
          const std::uint32_t d = t[(j + 2) % 3];
          if (sign(c, a, d) <= 0 || sign(d, b, c) <= 0) continue;
          s = {c, a, d};
          t = {d, b, c};
          i = j = 3;
        }
      }
    }
  }
  VirtualNode node(const TileKey& key) const {
    // Ring position of a border vertex, else -1.
    const auto ring = [&](const LocalVertex& p) -> std::int64_t {
      if (p.y == 0) return p.x;
      if (p.x == side_) return side_ + p.y;
      if (p.y == side_) return 3 * side_ - p.x;
      if (p.x == 0) return 4 * side_ - p.y;
      return -1;
    };
    std::vector<std::uint32_t> order(points_.size());
    for (std::uint32_t i = 0; i < order.size(); ++i) order[i] = i;
    std::stable_sort(order.begin(), order.end(), [&](std::uint32_t a, std::uint32_t b) {
      const auto ra = ring(points_[a]), rb = ring(points_[b]);
      return (ra < 0 ? 5 * side_ : ra) < (rb < 0 ? 5 * side_ : rb);
    });
    VirtualNode node;
    node.key = key;
    std::vector<std::uint32_t> new_index(order.size());
    for (std::uint32_t i = 0; i < order.size(); ++i) {
      new_index[order[i]] = i;
      node.vertices.push_back(points_[order[i]]);
      const auto r = ring(points_[order[i]]);
      if (r >= 0 && r % side_ != 0) ++node.n_side[static_cast<std::size_t>(r / side_)];
    }
    for (const Triangle& t : triangles_) node.triangles.push_back({new_index[t[0]], new_index[t[1]], new_index[t[2]]});
    return node;
  }

 private:
  int sign(std::uint32_t a, std::uint32_t b, std::uint32_t c) const {
    __extension__ using Wide = __int128;
    const LocalVertex &p = points_[a], &q = points_[b], &r = points_[c];
    const Wide cross = Wide{q.x - p.x} * (r.y - p.y) - Wide{q.y - p.y} * (r.x - p.x);
    return cross > 0 ? 1 : cross < 0 ? -1 : 0;
  }
  std::int64_t side_;
  std::mt19937_64 random_;
  std::vector<LocalVertex> points_;
  std::vector<Triangle> triangles_;
};

Decoded encode_and_decode(const Lattice& lattice, const VirtualNode& node, double step_m,
                          std::span<const VirtualNode> neighbours = {}, bool normals = false) {
  const auto bytes = encode_quantized_mesh(lattice, node, {step_m, normals, neighbours});
  EXPECT_TRUE(bytes.has_value()) << (bytes ? "" : bytes.error().message);
  return bytes ? decode(*bytes) : Decoded{};
}

// (position, height) along a border.
std::vector<std::pair<int, double>> profile(const Decoded& d, std::size_t edge) {
  std::vector<std::pair<int, double>> out;
  for (const auto v : d.edges[edge]) out.emplace_back(edge % 2 == 0 ? d.v[v] : d.u[v], d.height(v));
  return out;
}

TEST(MeshRounding, KeepsEveryTrianglePositiveOnHostileMeshes) {
  std::size_t n_dropped = 0, n_moved = 0;
  for (std::uint32_t seed = 0; seed < 120; ++seed) {
    // From one lattice step a grid step to millions of lattice steps a grid step.
    const int lattice_level = static_cast<int>(seed % 3 == 0 ? 0 : seed % 3 == 1 ? 8 : 28);
    const Lattice lattice = make_lattice(lattice_level, 5);
    const std::int64_t side = lattice.tile_side(0);
    MeshMaker maker(side, seed);
    maker.insert_random(150, std::max<std::int64_t>(2, side >> 13));
    for (std::int64_t k = 1; k < 20; ++k) {
      maker.insert(1, maker.below(side - 1) + 1, 7);      // slivers one lattice step from the border
      maker.insert(side / 2 + k, side / 2 + k * k, 100);  // many in one grid step
      maker.insert(0, side / 2 + k, 11);
    }
    maker.flip_random(20000);
    const VirtualNode node = maker.node({0, 0, 0});
    const auto mesh = round_to_grid(node, side, kSteps);
    ASSERT_TRUE(mesh.has_value()) << mesh.error().message << " seed " << seed;
    std::set<std::uint32_t> kept;
    for (const Triangle& t : mesh->triangles) kept.insert(t.begin(), t.end());
    n_dropped += node.vertices.size() - kept.size();
    for (const auto v : kept) {
      const double exact = static_cast<double>(node.vertices[v].x) * kSteps / static_cast<double>(side);
      n_moved += std::abs(mesh->positions[v][0] - exact) > 0.75;
    }
    expect_valid(encode_and_decode(lattice, node, 0.5));
    if (HasFatalFailure()) FAIL() << "seed " << seed;
  }
  // The meshes were hostile indeed: both ways out were needed.
  EXPECT_GT(n_dropped, 100u);
  EXPECT_GT(n_moved, 10u);
}

TEST(MeshRounding, KeepsWhatIsInsideOffTheSides) {
  const Lattice lattice = make_lattice(12, 5);
  const std::int64_t side = lattice.tile_side(0);
  MeshMaker maker(side, 3);
  const std::int64_t half_step = side / (2 * kSteps);
  maker.insert(half_step / 3, side / 3, 7);
  maker.insert(side - half_step / 2, side / 2, 9);
  maker.insert(side / 2, half_step / 2, 11);
  maker.insert(side / 3, side - 1, 13);
  maker.insert(0, side - half_step / 2, 17);  // on a side, beside a corner
  const VirtualNode node = maker.node({0, 0, 0});
  const auto mesh = round_to_grid(node, side, kSteps);
  ASSERT_TRUE(mesh.has_value()) << mesh.error().message;
  EXPECT_EQ(mesh->triangles, node.triangles) << "nothing was dropped or mended";
  for (std::size_t v = 0; v < node.vertices.size(); ++v) {
    const std::array<std::int64_t, 2> at = {node.vertices[v].x, node.vertices[v].y};
    for (std::size_t axis = 0; axis < 2; ++axis) {
      const bool is_inside = at[axis] > 0 && at[axis] < side;
      const auto steps = mesh->positions[v][axis];
      EXPECT_EQ(steps > 0 && steps < kSteps, is_inside) << v;
      const double exact = static_cast<double>(at[axis]), length = static_cast<double>(side);
      EXPECT_DOUBLE_EQ(served_position(exact, length), steps * length / kSteps) << v;
      EXPECT_EQ(is_served_far(exact, length), std::abs(exact * kSteps / length - steps) > 0.5) << v;
    }
  }
}

TEST(MeshRounding, RefusesWhatIsNoTriangulation) {
  const Lattice lattice = make_lattice(4, 3);
  const std::int64_t side = lattice.tile_side(2);
  MeshMaker maker(side, 3);
  maker.insert_random(40, 3);
  const VirtualNode good = maker.node({2, 1, 1});
  ASSERT_TRUE(encode_quantized_mesh(lattice, good, {}).has_value());
  VirtualNode node = good;
  std::swap(node.triangles[3][0], node.triangles[3][1]);
  EXPECT_EQ(encode_quantized_mesh(lattice, node, {}).error().kind, ErrorKind::kCorrupt);
  node = good;
  node.triangles[0][0] = 100000;
  EXPECT_EQ(encode_quantized_mesh(lattice, node, {}).error().kind, ErrorKind::kCorrupt);
  node = good;
  node.triangles.clear();
  EXPECT_EQ(encode_quantized_mesh(lattice, node, {}).error().kind, ErrorKind::kCorrupt);
  node = good;
  node.vertices.back().x = -5;
  EXPECT_EQ(encode_quantized_mesh(lattice, node, {}).error().kind, ErrorKind::kCorrupt);
}

TEST(QuantizedMesh, NeighboursDecodeToTheSameBorder) {
  double worst_lerp_m = 0;
  for (std::uint32_t seed = 0; seed < 40; ++seed) {
    const Lattice lattice = make_lattice(9, 6);
    const int level = static_cast<int>(seed % 10);
    const std::int64_t side = lattice.tile_side(level);
    MeshMaker west(side, seed), east(side, seed + 1000);
    // A high plateau beside a deep valley: very different ranges and steps.
    for (int k = 0; k < 60; ++k) {
      const std::int64_t t = 1 + west.below(side - 1);
      const auto z = west.height();
      west.insert(side, t, z);
      east.insert(0, t, z);
      west.insert(1 + west.below(side - 1), 1 + west.below(side - 1), 3000 + west.height() / 100);
      east.insert(1 + east.below(side - 1), 1 + east.below(side - 1), -20000 + 30 * east.height());
    }
    const auto level8 = static_cast<std::uint8_t>(level);
    VirtualNode w = west.node({level8, 0, 0}), e = east.node({level8, 1, 0});
    // The corners are shared too.
    e.vertices[0].z = w.vertices[1 + w.n_side[0]].z;
    e.vertices[3 + e.n_side[0] + e.n_side[1] + e.n_side[2]].z = w.vertices[2 + w.n_side[0] + w.n_side[1]].z;
    const double step_m = 0.25;
    const Decoded dw = encode_and_decode(lattice, w, step_m), de = encode_and_decode(lattice, e, step_m);
    EXPECT_EQ(profile(dw, 2), profile(de, 0)) << seed;
    for (std::size_t k = 0; k < dw.edges[2].size(); ++k) {
      const auto a = dw.edges[2][k], b = de.edges[0][k];
      worst_lerp_m = std::max(worst_lerp_m, std::abs(dw.height_lerp(a) - de.height_lerp(b)));
      EXPECT_EQ(std::fmod(dw.height(a), step_m), 0.0);
    }
  }
  EXPECT_LT(worst_lerp_m, 1e-11);
}

TEST(QuantizedMesh, OneMultiplicationGivesEveryHeightExactly) {
  for (int q = 0; q <= kSteps; ++q) ASSERT_EQ(q / 32767.0 * 32767.0, q);
}

TEST(QuantizedMesh, RangeIsExactDyadicAndWithinTwiceTheTrueOne) {
  for (std::uint32_t seed = 0; seed < 60; ++seed) {
    const Lattice lattice = make_lattice(5, 8);
    MeshMaker maker(lattice.tile_side(5), seed);
    const auto scale = std::int32_t{1} << (seed % 9);
    for (int k = 0; k < 30; ++k) {
      maker.insert(1 + maker.below(65000), 1 + maker.below(65000), 1000 * 256 + maker.height() * scale);
    }
    VirtualNode node = maker.node({5, 3, 2});
    for (int c = 0; c < 4; ++c) node.vertices[static_cast<std::size_t>(c)].z = 1000 * 256;
    const Decoded d = encode_and_decode(lattice, node, 1.0);
    expect_valid(d);
    double low = 1e9, high = -1e9;
    for (std::size_t i = 0; i < d.q.size(); ++i) {
      low = std::min(low, d.height(i));
      high = std::max(high, d.height(i));
    }
    const double step = (d.maximum - d.minimum) / kSteps;
    EXPECT_EQ(std::exp2(std::round(std::log2(step))), step);
    EXPECT_EQ(std::fmod(d.minimum, step), 0.0);
    EXPECT_EQ(d.minimum, low);
    EXPECT_LT(d.maximum - d.minimum, 2 * (high - low) + 1e-9) << seed;
    // Interior heights lose half a step at most.
    std::vector<double> expected, got;
    for (std::size_t i = 4; i < node.vertices.size(); ++i) expected.push_back(lattice.height_m(node.vertices[i].z));
    for (std::size_t i = 0; i < d.q.size(); ++i) {
      if (d.u[i] % kSteps != 0 || d.v[i] % kSteps != 0) got.push_back(d.height(i));
    }
    std::sort(expected.begin(), expected.end());
    std::sort(got.begin(), got.end());
    ASSERT_EQ(expected.size(), got.size());
    for (std::size_t i = 0; i < got.size(); ++i) EXPECT_NEAR(got[i], expected[i], step / 2);
  }
}

TEST(QuantizedMesh, HighFlatPlateauKeepsExactBorders) {
  const Lattice lattice = make_lattice(5, 8);
  MeshMaker maker(lattice.tile_side(5), 1);
  maker.insert(500, 500, 8500 * 256 + 1);
  VirtualNode node = maker.node({5, 3, 2});
  for (std::size_t c = 0; c < 4; ++c) node.vertices[c].z = 8500 * 256;
  const Decoded d = encode_and_decode(lattice, node, 0x1p-20);  // finer than a float header can carry up there
  expect_valid(d);
  for (const auto& edge : d.edges) {
    for (const auto v : edge) EXPECT_EQ(d.height(v), 8500.0);
  }
}

// At 2400 m a 32-bit float has steps of 2^-12 m: 32767 of them are 8 m, far more than a flat tile's range.
TEST(QuantizedMesh, NearlyFlatPlateauStaysWithinTwiceItsRange) {
  for (std::int32_t range = 1; range <= 16 * 16; ++range) {
    const Lattice lattice = make_lattice(5, 4);
    const double step_m = 0x1p-5;
    MeshMaker maker(lattice.tile_side(5), 1);
    maker.insert(500, 500, 2400 * 16 + range);
    VirtualNode node = maker.node({5, 3, 2});
    for (std::size_t c = 0; c < 4; ++c) node.vertices[c].z = 2400 * 16 + static_cast<std::int32_t>(c) * range / 3;
    const Decoded d = encode_and_decode(lattice, node, step_m);
    expect_valid(d);
    EXPECT_LE(d.maximum - d.minimum, 2 * range / 16.0) << range;
    for (const auto& edge : d.edges) {
      for (const auto v : edge) EXPECT_EQ(std::fmod(d.height(v), step_m), 0.0) << range;
    }
  }
}

TEST(QuantizedMesh, FlatTileHasEqualMinimumAndMaximum) {
  const Lattice lattice = make_lattice(5, 4);
  MeshMaker maker(lattice.tile_side(3), 1);
  VirtualNode node = maker.node({3, 2, 2});
  for (auto& v : node.vertices) v.z = -16 * 7;
  const Decoded d = encode_and_decode(lattice, node, 0.5);
  expect_valid(d);
  EXPECT_EQ(d.minimum, -7.0);
  EXPECT_EQ(d.maximum, -7.0);
  for (const auto v : d.q) EXPECT_EQ(v, 0);
}

TEST(QuantizedMesh, RangeHoldsBorderVerticesThatRoundingMergedToo) {
  const Lattice lattice = make_lattice(5, 8);
  MeshMaker maker(lattice.tile_side(5), 3);
  maker.insert(500, 0, 1000 * 256);
  maker.insert(501, 0, 900 * 256);  // rounds to the same step as its neighbour, which stays
  VirtualNode node = maker.node({5, 3, 2});
  for (std::size_t c = 0; c < node.vertices.size(); ++c) {
    if (node.vertices[c].z != 900 * 256) node.vertices[c].z = 1000 * 256;
  }
  const Decoded d = encode_and_decode(lattice, node, 1.0);
  expect_valid(d);
  EXPECT_EQ(d.u.size() + 1, node.vertices.size());
  EXPECT_LE(d.minimum, 900);
  EXPECT_GE(d.maximum, 1000);
}

TEST(QuantizedMesh, RangeBeyondTheStepIsRefused) {
  const Lattice lattice = make_lattice(5, 4);
  MeshMaker maker(lattice.tile_side(3), 1);
  VirtualNode node = maker.node({3, 2, 2});
  node.vertices[0].z = 16 * 9000;
  EXPECT_EQ(encode_quantized_mesh(lattice, node, {0.125, false, {}}).error().kind, ErrorKind::kUnsupported);
  EXPECT_TRUE(encode_quantized_mesh(lattice, node, {0.5, false, {}}).has_value());
}

// A grid of (n + 1)^2 vertices.
VirtualNode grid_node(std::int64_t side, std::int64_t n, std::int64_t n_extra_on_south) {
  VirtualNode node;
  node.key = {0, 0, 0};
  std::map<std::pair<std::int64_t, std::int64_t>, std::uint32_t> index;
  const auto add = [&](std::int64_t x, std::int64_t y) {
    if (index.emplace(std::pair{x, y}, static_cast<std::uint32_t>(node.vertices.size())).second) {
      node.vertices.push_back({x, y, static_cast<std::int32_t>((x ^ y) & 1023)});
    }
  };
  const std::int64_t step = side / n;
  std::vector<std::int64_t> south;
  for (std::int64_t i = 0; i <= n; ++i) {
    south.push_back(i * step);
    if (i < n_extra_on_south) south.push_back(i * step + step / 2);
  }
  for (const auto x : south) add(x, 0);
  for (std::int64_t i = 1; i <= n; ++i) add(side, i * step);
  for (std::int64_t i = n - 1; i >= 0; --i) add(i * step, side);
  for (std::int64_t i = n - 1; i > 0; --i) add(0, i * step);
  node.n_side = {static_cast<std::uint32_t>(south.size() - 2), static_cast<std::uint32_t>(n - 1),
                 static_cast<std::uint32_t>(n - 1), static_cast<std::uint32_t>(n - 1)};
  for (std::int64_t j = 1; j < n; ++j) {
    for (std::int64_t i = 1; i < n; ++i) add(i * step, j * step);
  }
  for (std::int64_t j = 0; j < n; ++j) {
    for (std::int64_t i = 0; i < n; ++i) {
      const auto at = [&](std::int64_t x, std::int64_t y) { return index.at({x, y}); };
      const std::int64_t x = i * step, y = j * step;
      node.triangles.push_back({at(x + step, y), at(x + step, y + step), at(x, y + step)});
      if (j == 0 && i < n_extra_on_south) {
        node.triangles.push_back({at(x, y), at(x + step / 2, y), at(x, y + step)});
        node.triangles.push_back({at(x + step / 2, y), at(x + step, y), at(x, y + step)});
      } else {
        node.triangles.push_back({at(x, y), at(x + step, y), at(x, y + step)});
      }
    }
  }
  return node;
}

TEST(QuantizedMesh, NeverHas65536VerticesAndWidensItsIndicesBeyond) {
  const Lattice lattice = make_lattice(2, 3);
  const std::int64_t side = lattice.tile_side(0);
  // 256 x 256 = 65,536 vertices: 255 cells do not divide the side, 256 cells have 257^2 = 66,049.
  const VirtualNode large = grid_node(side, 256, 0);
  EXPECT_EQ(large.vertices.size(), 66049u);
  expect_valid(encode_and_decode(lattice, large, 0.5));
  VirtualNode below = grid_node(side, 128, 0);  // 16,641 vertices
  expect_valid(encode_and_decode(lattice, below, 0.5));
  // Split triangles until there are 65,536 exactly.
  VirtualNode exact = below;
  const std::size_t n_triangles = exact.triangles.size();
  for (std::size_t t = 0; exact.vertices.size() < 65536; t = (t + 1) % n_triangles) {
    const Triangle corner = exact.triangles[t];
    const auto &a = exact.vertices[corner[0]], &b = exact.vertices[corner[1]], &c = exact.vertices[corner[2]];
    const auto v = static_cast<std::uint32_t>(exact.vertices.size());
    exact.vertices.push_back({(a.x + b.x + c.x) / 3, (a.y + b.y + c.y) / 3, 5});
    exact.triangles[t] = {corner[0], corner[1], v};
    exact.triangles.push_back({corner[1], corner[2], v});
    exact.triangles.push_back({corner[2], corner[0], v});
  }
  const Decoded d = encode_and_decode(lattice, exact, 0.5);
  EXPECT_EQ(d.u.size(), 65537u);
  std::int64_t doubled_area = 0;
  for (const Triangle& t : d.triangles) {
    const std::int64_t area = std::int64_t{d.u[t[1]] - d.u[t[0]]} * (d.v[t[2]] - d.v[t[0]]) -
                              std::int64_t{d.v[t[1]] - d.v[t[0]]} * (d.u[t[2]] - d.u[t[0]]);
    ASSERT_GT(area, 0);
    doubled_area += area;
  }
  EXPECT_EQ(doubled_area, std::int64_t{2} * kSteps * kSteps);
}

TEST(QuantizedMesh, BoundingSphereAndOcclusionPointHold) {
  for (int level = 0; level < 8; ++level) {
    const Lattice lattice = make_lattice(8, 3);
    MeshMaker maker(lattice.tile_side(level), 11u + static_cast<std::uint32_t>(level));
    maker.insert_random(100, 1000);
    for (int k = 1; k < 16; ++k) maker.insert(0, lattice.tile_side(level) * k / 16, 0);
    const VirtualNode node = maker.node({static_cast<std::uint8_t>(level), 1, level > 0 ? 1u : 0u});
    const Decoded d = encode_and_decode(lattice, node, 0.5);
    const double width = 180.0 / std::exp2(level);
    const double a = lattice.ellipsoid.semi_major_m, b = lattice.ellipsoid.semi_minor_m();
    const std::array<double, 3> occludee = {d.occlusion[0], d.occlusion[1], d.occlusion[2]};
    const auto visible = [](const std::array<double, 3>& point, const std::array<double, 3>& camera) {
      double to_limb = -1, dot = 0, length = 0;
      for (std::size_t k = 0; k < 3; ++k) {
        to_limb += camera[k] * camera[k];
        const double vt = point[k] - camera[k];
        dot -= vt * camera[k];
        length += vt * vt;
      }
      return !(dot > to_limb && dot * dot / length > to_limb);
    };
    std::mt19937_64 random(5);
    std::normal_distribution<double> normal;
    std::vector<std::array<double, 3>> scaled;
    for (std::size_t i = 0; i < d.u.size(); ++i) {
      const auto p = lattice.geodetic_to_ecef(-180 + (1 + d.u[i] / 32767.0) * width,
                                              -90 + ((level > 0) + d.v[i] / 32767.0) * width, d.height(i));
      const double dx = p[0] - d.sphere[0], dy = p[1] - d.sphere[1], dz = p[2] - d.sphere[2];
      EXPECT_LE(std::sqrt(dx * dx + dy * dy + dz * dz), d.sphere[3]);
      scaled.push_back({p[0] / a, p[1] / a, p[2] / b});
    }
    // Whatever camera sees a vertex must not find the tile hidden.
    int n_hidden = 0;
    for (int k = 0; k < 3000; ++k) {
      std::array<double, 3> camera = {normal(random), normal(random), normal(random)};
      const double length = std::sqrt(camera[0] * camera[0] + camera[1] * camera[1] + camera[2] * camera[2]);
      const double distance = 1.0 + std::exp2(-static_cast<double>(random() % 12));
      for (double& c : camera) c *= distance / length;
      if (visible(occludee, camera)) continue;
      ++n_hidden;
      for (const auto& p : scaled) ASSERT_FALSE(visible(p, camera)) << "level " << level;
    }
    if (level >= 2) {
      EXPECT_GT(n_hidden, 1000);  // the point is of use
    }
  }
}

TEST(QuantizedMesh, NormalsAgreeOnBothSidesOfABorder) {
  const Lattice lattice = make_lattice(6, 3);
  for (const int level : {0, 1, 6}) {
    const std::int64_t side = lattice.tile_side(level);
    const auto level8 = static_cast<std::uint8_t>(level);
    // The pair meets at the antimeridian.
    MeshMaker west(side, 21), east(side, 22);
    for (int k = 0; k < 20; ++k) {
      const std::int64_t t = 1 + west.below(side - 1);
      const auto z = west.height();
      west.insert(side, t, z);
      east.insert(0, t, z);
      west.insert(1 + west.below(side - 1), 1 + west.below(side - 1), 90 * west.height());
      east.insert(1 + east.below(side - 1), 1 + east.below(side - 1), 90 * east.height());
    }
    std::vector<VirtualNode> w = {west.node({level8, TileKey::count_x(level) - 1, 0})};
    std::vector<VirtualNode> e = {east.node({level8, 0, 0})};
    e[0].vertices[0].z = w[0].vertices[1 + w[0].n_side[0]].z;
    e[0].vertices[3 + e[0].n_side[0] + e[0].n_side[1] + e[0].n_side[2]].z =
        w[0].vertices[2 + w[0].n_side[0] + w[0].n_side[1]].z;
    const Decoded dw = encode_and_decode(lattice, w[0], 4, e, true), de = encode_and_decode(lattice, e[0], 4, w, true);
    ASSERT_EQ(dw.extensions.at(1).size(), 2 * dw.u.size());
    ASSERT_EQ(dw.edges[2].size(), de.edges[0].size());
    ASSERT_GT(dw.edges[2].size(), 15u);
    for (std::size_t k = 0; k < dw.edges[2].size(); ++k) {
      const auto a = dw.edges[2][k], b = de.edges[0][k];
      EXPECT_EQ(dw.extensions.at(1)[2 * a], de.extensions.at(1)[2 * b]);
      EXPECT_EQ(dw.extensions.at(1)[2 * a + 1], de.extensions.at(1)[2 * b + 1]);
    }
    // Without the neighbour they would not: the test can fail.
    const Decoded alone = encode_and_decode(lattice, w[0], 4, {}, true);
    EXPECT_NE(alone.extensions.at(1), dw.extensions.at(1));
    // Bit for bit, before they are packed in two bytes.
    const auto nw = vertex_normals(lattice, w[0], e), ne = vertex_normals(lattice, e[0], w);
    for (std::size_t i = 0; i < nw.size(); ++i) {
      for (std::size_t j = 0; j < ne.size(); ++j) {
        if (w[0].vertices[i].x == side && e[0].vertices[j].x == 0 && w[0].vertices[i].y == e[0].vertices[j].y) {
          EXPECT_EQ(nw[i], ne[j]);
        }
      }
    }
  }
}

TEST(QuantizedMesh, PoleNormalIsTheAxis) {
  const Lattice lattice = make_lattice(4, 3);
  MeshMaker maker(lattice.tile_side(1), 2);
  maker.insert(99, 0, 0);
  const auto normals = vertex_normals(lattice, maker.node({1, 2, 0}), {});
  const std::array<double, 3> down = {0, 0, -1};
  EXPECT_EQ(normals[0], down);
  EXPECT_EQ(normals[1], down);
}

}  // namespace
}  // namespace tind
