// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/surface_sampler.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <utility>

#include "core/piece_key.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

/// A point of a plane on a row.
struct RowPoint {
  double x = 0, z = 0;
};

/// The stretch of a triangle on one row, from west to east.
struct RowStretch {
  RowPoint west, east;

  bool contains(double x) const { return x >= west.x && x <= east.x; }
  double height(double x) const {
    const double width = east.x - west.x;
    return width > 0 ? west.z + (x - west.x) / width * (east.z - west.z) : west.z;
  }
};

/// Where an edge meets row y, lower.y <= y <= upper.y. Both triangles of an edge get the same bits, so there is no gap
/// between them.
RowPoint on_edge(const LocalVertex& lower, const LocalVertex& upper, double y) {
  const auto x_low = static_cast<double>(lower.x), y_low = static_cast<double>(lower.y), z_low = double(lower.z);
  const auto y_high = static_cast<double>(upper.y);
  if (y == y_low) return {x_low, z_low};
  if (y == y_high) return {static_cast<double>(upper.x), double(upper.z)};
  const double part = (y - y_low) / (y_high - y_low);
  return {x_low + part * static_cast<double>(upper.x - lower.x), z_low + part * double(upper.z - lower.z)};
}

/// A triangle with its corners from south to north.
struct TriangleRows {
  std::array<LocalVertex, 3> v;

  TriangleRows(const VirtualNode& tile, const Triangle& t)
      : v{tile.vertices[t[0]], tile.vertices[t[1]], tile.vertices[t[2]]} {
    std::sort(v.begin(), v.end(),
              [](const LocalVertex& a, const LocalVertex& b) { return a.y != b.y ? a.y < b.y : a.x < b.x; });
  }
  double south() const { return static_cast<double>(v[0].y); }
  double north() const { return static_cast<double>(v[2].y); }
  double west() const { return static_cast<double>(std::min({v[0].x, v[1].x, v[2].x})); }
  double east() const { return static_cast<double>(std::max({v[0].x, v[1].x, v[2].x})); }
  /// Precondition: south() <= y <= north().
  RowStretch at(double y) const {
    RowStretch row{on_edge(v[0], v[2], y), on_edge(v[0], v[2], y)};
    const auto extend = [&row](const RowPoint& p) {
      if (p.x < row.west.x) row.west = p;
      if (p.x > row.east.x) row.east = p;
    };
    const auto middle = static_cast<double>(v[1].y);
    if (y <= middle) extend(on_edge(v[0], v[1], y));
    if (y >= middle) extend(on_edge(v[1], v[2], y));
    // A row along an edge: both its ends.
    for (const LocalVertex& corner : v) {
      if (static_cast<double>(corner.y) == y) extend({static_cast<double>(corner.x), double(corner.z)});
    }
    return row;
  }
};

/// The posts of a height field that lie in one tile, in [west, east) x [south, north); the north pole belongs to the
/// northernmost tiles.
struct TilePosts {
  std::vector<double> xs, ys;  ///< Ascending, in lattice steps from the SW corner.
  std::vector<std::int64_t> cols, rows;
};

TilePosts posts_in(const HeightField& field, const TileKey& key) {
  TilePosts posts;
  const double side = static_cast<double>(field.lattice.tile_side(key.level));
  const double west = side * key.x, south = side * key.y;
  const double width = static_cast<double>(field.lattice.width()), height = static_cast<double>(field.lattice.height());
  const auto clamp_to = [](double index, std::int64_t n) {
    return static_cast<std::int64_t>(std::clamp(index, 0.0, static_cast<double>(n)));
  };
  const std::int64_t r_end = clamp_to(std::ceil((south + side - field.y0) / field.dy) + 2, field.n_rows);
  for (std::int64_t r = clamp_to(std::floor((south - field.y0) / field.dy) - 1, field.n_rows); r < r_end; ++r) {
    const double y = std::min(field.post_y(r), height);
    if (y < south || (y >= south + side && !(y == height && south + side == height))) continue;
    posts.ys.push_back(y - south);
    posts.rows.push_back(r);
  }
  // Posts past the lattice's width continue at its start, so west of those before: they come first.
  for (const double turn : {width, 0.0}) {
    const std::int64_t c_end = clamp_to(std::ceil((west + turn + side - field.x0) / field.dx) + 2, field.n_cols);
    for (std::int64_t c = clamp_to(std::floor((west + turn - field.x0) / field.dx) - 1, field.n_cols); c < c_end; ++c) {
      const double unwrapped = field.post_x(c);
      if ((unwrapped >= width) != (turn > 0)) continue;
      const double x = unwrapped - turn;
      if (x < west || x >= west + side) continue;
      posts.xs.push_back(x - west);
      posts.cols.push_back(c);
    }
  }
  return posts;
}

/// The irregular posts in [west, east) x [south, north) of one tile.
void points_in(const HeightField& field, const TileKey& key, std::vector<MeshPosition>& at,
               std::vector<double>& heights_m) {
  const double side = static_cast<double>(field.lattice.tile_side(key.level));
  const double west = side * key.x, south = side * key.y, width = static_cast<double>(field.lattice.width());
  for (const double turn : {0.0, width}) {
    field.points.for_blocks(west + turn, south, west + turn + side, south + side, [&](const PointPost& p) {
      if ((p.x >= width) != (turn > 0)) return;
      const double x = p.x - turn - west, y = p.y - south;
      if (x < 0 || x >= side || y < 0 || y >= side) return;
      at.push_back({x, y});
      heights_m.push_back(static_cast<double>(p.height_m));
    });
  }
}

/// Origin of the grid post nearest to a lattice point; kBase beyond the grid.
PostOrigin nearest_origin(const HeightField& field, std::int64_t x, std::int64_t y) {
  const auto r = static_cast<std::int64_t>(std::floor((static_cast<double>(y) - field.y0) / field.dy + 0.5));
  if (r < 0 || r >= field.n_rows) return PostOrigin::kBase;
  const double width = static_cast<double>(field.lattice.width());
  double east = static_cast<double>(x) - field.x0;
  if (east < -0.5 * field.dx) east += width;
  auto c = static_cast<std::int64_t>(std::floor(east / field.dx + 0.5));
  if (field.wraps) c %= field.n_cols;
  return c >= 0 && c < field.n_cols ? field.origin_at(r, c) : PostOrigin::kBase;
}

struct SampledTile {
  LevelSurface surface;
  std::string error;
};

void measure(double surface_m, double post_m, LevelSurface& result) {
  if (std::isnan(surface_m)) {
    ++result.n_missed;
  } else {
    result.errors.add(surface_m - post_m);
  }
}

SampledTile sample_tile(const HeightField& field, const TileKey& key, const TileValues& values, float* heights_m) {
  SampledTile result;
  const auto tile = decode_tile(field.lattice, key, values);
  if (!tile) {
    result.error = tile.error().message;
    return result;
  }
  const double unit = field.lattice.height_unit_m();
  const bool on_grid = field.points.empty();
  const TilePosts posts = on_grid || heights_m ? posts_in(field, key) : TilePosts();
  const std::vector<double> surface = sample_mesh(*tile, unit, posts.xs, posts.ys);
  for (std::size_t j = 0; j < posts.rows.size(); ++j) {
    for (std::size_t i = 0; i < posts.cols.size(); ++i) {
      const double z = surface[j * posts.cols.size() + i];
      const PostOrigin origin = field.origin_at(posts.rows[j], posts.cols[i]);
      if (!is_of_source(origin) && origin != PostOrigin::kFilled) continue;
      if (heights_m) heights_m[posts.rows[j] * field.n_cols + posts.cols[i]] = static_cast<float>(z);
      if (on_grid && origin == PostOrigin::kSource) {
        measure(z, field.height_at(posts.rows[j], posts.cols[i]), result.surface);
      }
    }
  }
  if (!on_grid) {
    std::vector<MeshPosition> at;
    std::vector<double> points_m;
    points_in(field, key, at, points_m);
    const std::vector<double> there = sample_mesh(*tile, unit, at);
    for (std::size_t k = 0; k < at.size(); ++k) measure(there[k], points_m[k], result.surface);
  }
  return result;
}

}  // namespace

double SurfaceErrors::rmse_m() const { return n_posts ? std::sqrt(squares_m2 / static_cast<double>(n_posts)) : 0; }

void SurfaceErrors::add(double error_m) {
  ++n_posts;
  squares_m2 += error_m * error_m;
  max_m = std::max(max_m, std::abs(error_m));
}

void SurfaceErrors::add(const SurfaceErrors& other) {
  n_posts += other.n_posts;
  squares_m2 += other.squares_m2;
  max_m = std::max(max_m, other.max_m);
}

std::vector<double> sample_mesh(const VirtualNode& tile, double height_unit_m, std::span<const double> xs,
                                std::span<const double> ys) {
  std::vector<double> heights(xs.size() * ys.size(), kNaN);
  for (const Triangle& t : tile.triangles) {
    const TriangleRows triangle(tile, t);
    for (auto y = std::lower_bound(ys.begin(), ys.end(), triangle.south()); y != ys.end() && *y <= triangle.north();
         ++y) {
      const RowStretch row = triangle.at(*y);
      double* out = heights.data() + static_cast<std::size_t>(y - ys.begin()) * xs.size();
      for (auto x = std::lower_bound(xs.begin(), xs.end(), row.west.x); x != xs.end() && *x <= row.east.x; ++x) {
        double& z = out[x - xs.begin()];
        if (std::isnan(z)) z = row.height(*x) * height_unit_m;
      }
    }
  }
  return heights;
}

std::vector<double> sample_mesh(const VirtualNode& tile, double height_unit_m, std::span<const MeshPosition> at) {
  std::vector<double> heights(at.size(), kNaN);
  if (at.empty()) return heights;
  // Buckets of about one position, ordered by bucket.
  double x_max = 0, y_max = 0;
  for (const MeshPosition& p : at) {
    x_max = std::max(x_max, p.x);
    y_max = std::max(y_max, p.y);
  }
  const auto per_side = static_cast<std::size_t>(std::ceil(std::sqrt(static_cast<double>(at.size()))));
  const auto bucket = [per_side](double v, double most) {
    const double index = most > 0 ? v / most * static_cast<double>(per_side) : 0;
    return static_cast<std::size_t>(std::clamp(index, 0.0, static_cast<double>(per_side - 1)));
  };
  const auto bucket_of = [&](const MeshPosition& p) { return bucket(p.y, y_max) * per_side + bucket(p.x, x_max); };
  std::vector<std::size_t> first(per_side * per_side + 1), order(at.size());
  for (const MeshPosition& p : at) ++first[bucket_of(p) + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  std::vector<std::size_t> next(first.begin(), first.end() - 1);
  for (std::size_t k = 0; k < at.size(); ++k) order[next[bucket_of(at[k])]++] = k;

  for (const Triangle& t : tile.triangles) {
    const TriangleRows triangle(tile, t);
    const std::size_t west = bucket(triangle.west(), x_max), east = bucket(triangle.east(), x_max);
    for (std::size_t j = bucket(triangle.south(), y_max); j <= bucket(triangle.north(), y_max); ++j) {
      for (std::size_t k = first[j * per_side + west]; k < first[j * per_side + east + 1]; ++k) {
        const MeshPosition& p = at[order[k]];
        if (!std::isnan(heights[order[k]]) || p.y < triangle.south() || p.y > triangle.north()) continue;
        const RowStretch row = triangle.at(p.y);
        if (row.contains(p.x)) heights[order[k]] = row.height(p.x) * height_unit_m;
      }
    }
  }
  return heights;
}

Result<LevelSurface> sample_level(const PyramidFile& file, int level, const HeightField& field, int threads,
                                  float* heights_m) {
  const std::vector<TileKey> tiles = file.surface_tiles(level, [&](const TileKey& key) {
    const TilePosts posts = posts_in(field, key);
    return !posts.rows.empty() && !posts.cols.empty();
  });
  struct In {
    TileKey key;
    Result<TileValues> values;
  };
  LevelSurface surface;
  std::string error;
  const auto prepare = [&](std::size_t i) { return In{tiles[i], file.read_tile(tiles[i])}; };
  const auto work = [&](In&& in) {
    if (in.values) return sample_tile(field, in.key, *in.values, heights_m);
    SampledTile failed;
    failed.error = in.values.error().message;
    return failed;
  };
  const auto consume = [&](std::size_t, SampledTile&& tile) {
    error = tile.error;
    surface.errors.add(tile.surface.errors);
    surface.n_missed += tile.surface.n_missed;
    return error.empty();
  };
  if (!run_ordered<In, SampledTile>(tiles.size(), threads, prepare, work, consume)) {
    return fail(ErrorKind::kCorrupt, error);
  }
  return surface;
}

Result<VertexCounts> count_vertices(const PyramidFile& file, int level, const HeightField& field) {
  std::vector<PieceKey> keys;
  for (const TileKey& tile : file.stored_tiles(level)) {
    const auto pieces = pieces_of(tile);
    keys.insert(keys.end(), pieces.begin(), pieces.end());
  }
  std::sort(keys.begin(), keys.end());
  keys.erase(std::unique(keys.begin(), keys.end()), keys.end());

  VertexCounts counts;
  const std::int64_t side = field.lattice.tile_side(level);
  const auto count = [&](std::int64_t x, std::int64_t y) {
    switch (nearest_origin(field, x, y)) {
      case PostOrigin::kSource:
      case PostOrigin::kInterpolated:
        ++counts.data;
        return;
      case PostOrigin::kFilled:
        ++counts.voids;
        return;
      case PostOrigin::kFalloff:
      case PostOrigin::kBase:
        ++counts.outside;
        return;
    }
  };
  for (const PieceKey& key : keys) {
    const std::int64_t x = side * key.i, y = side * key.j;
    if (key.kind == PieceKind::kCorner) {
      count(x, y);
      continue;
    }
    const auto value = file.read_piece(key);
    if (!value) return tl::unexpected(value.error());
    const auto record = unpack_value(*value);
    if (!record) return tl::unexpected(record.error());
    if (key.kind == PieceKind::kBody) {
      const auto body = decode_body(*record);
      if (!body) return tl::unexpected(body.error());
      for (const LocalVertex& v : body->interior) count(x + v.x, y + v.y);
    } else {
      const auto edge = decode_edge(*record);
      if (!edge) return tl::unexpected(edge.error());
      for (const EdgeVertex& v : edge->inner) {
        count(key.kind == PieceKind::kEdgeH ? x + v.t : x, key.kind == PieceKind::kEdgeV ? y + v.t : y);
      }
    }
  }
  return counts;
}

}  // namespace tind
