// SPDX-License-Identifier: GPL-3.0-or-later
// The tiles that globes read, and the layer.json that leads to them.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>

#include "tests/client/checks.hpp"
#include "tests/client/parallel.hpp"
#include "tests/client/post_scan.hpp"

namespace tind::client {
namespace {

constexpr double kMaxValue = 32767;

/// File order of a .terrain's edge lists.
constexpr std::array<const char*, 4> kEdgeNames = {"west", "south", "east", "north"};

std::array<double, 3> to_globe(const ManifestView& m, double lon_deg, double lat_deg, double height_m) {
  const double to_radians = std::acos(-1.0) / 180;
  const double f = 1 / m.inverse_flattening, e2 = f * (2 - f);
  const double sin_lat = std::sin(lat_deg * to_radians), cos_lat = std::cos(lat_deg * to_radians);
  const double n = m.semi_major_m / std::sqrt(1 - e2 * sin_lat * sin_lat);
  return {(n + height_m) * cos_lat * std::cos(lon_deg * to_radians),
          (n + height_m) * cos_lat * std::sin(lon_deg * to_radians), (n * (1 - e2) + height_m) * sin_lat};
}

/// Every vertex lies in the bounding sphere, within a millionth of its radius.
bool sphere_holds_all(const ManifestView& m, const TileId& id, const TerrainMesh& mesh) {
  const double side_deg = 180.0 / TileId::count_y(id.level);
  for (std::size_t k = 0; k < mesh.u.size(); ++k) {
    const auto p = to_globe(m, -180 + (id.x + mesh.u[k] / kMaxValue) * side_deg,
                            -90 + (id.y + mesh.v[k] / kMaxValue) * side_deg, mesh.height_m(k));
    const double distance =
        std::hypot(p[0] - mesh.sphere_center[0], p[1] - mesh.sphere_center[1], p[2] - mesh.sphere_center[2]);
    if (distance > mesh.sphere_radius * (1 + 1e-6) + 0.1) return false;
  }
  return true;
}

void check_heights(Run& run, const Node& node, const TerrainMesh& mesh, Check& check) {
  const double step = run.manifest.levels[static_cast<std::size_t>(node.id.level)].height_step_m;
  const double unit = run.manifest.frame.unit_m();
  const double low = node.tile->min_z * unit, high = node.tile->max_z * unit;
  const auto header_low = static_cast<double>(mesh.min_height_m), header_high = static_cast<double>(mesh.max_height_m);
  const std::string name = "tile " + node.id.text() + ": ";
  if (header_low > low + step || header_high < high - step) {
    check.fail(fmt::format("{}header heights {}..{} m do not hold the tile's {}..{} m", name, header_low, header_high,
                           low, high));
  }
  // Rounding may widen the true range by a step at each end before it is doubled. And 32767 equal steps between two
  // 32-bit floats cannot be finer than what a float resolves at the tile's height.
  const double finest =
      32767 * std::ldexp(1.0, std::ilogb(std::max({std::abs(header_low), std::abs(header_high), 1.0})) - 23);
  if (header_high - header_low > std::max(2 * (high - low + 2 * step), finest)) {
    check.fail(fmt::format("{}header heights span {} m, the tile {} m: more than twice", name, header_high - header_low,
                           high - low));
  }
  if (run.posts != nullptr) return;
  // Without a source: the decoded mesh still has to have the tile's own heights, within rounding.
  const auto [lowest, highest] = std::minmax_element(mesh.h.begin(), mesh.h.end());
  if (std::abs(mesh.height_m(static_cast<std::size_t>(lowest - mesh.h.begin())) - low) >
          0.51 * step + run.tolerance_m(node.id.level) ||
      std::abs(mesh.height_m(static_cast<std::size_t>(highest - mesh.h.begin())) - high) >
          0.51 * step + run.tolerance_m(node.id.level)) {
    check.fail(name + "the decoded mesh does not reach the tile's lowest and highest vertex within E_L");
  }
}

std::array<TerrainBorder, 4> borders_of(const TerrainMesh& mesh) {
  std::array<TerrainBorder, 4> borders;
  for (std::size_t e = 0; e < 4; ++e) {
    const auto& along = e % 2 == 0 ? mesh.v : mesh.u;
    for (const std::uint32_t k : mesh.edges[e]) {
      borders[e].positions.push_back(along[k]);
      borders[e].heights_m.push_back(mesh.height_m(k));
      if (!mesh.normals.empty()) borders[e].normals.push_back(mesh.normals[k]);
    }
  }
  return borders;
}

/// Where rounding puts a coordinate: at the nearest of 0..32767, but what is inside stays off the sides.
std::int64_t nearest_step(std::int64_t at, std::int64_t side) {
  const auto steps = static_cast<std::int64_t>(kMaxValue);
  const std::int64_t rounded = (2 * at * steps + side) / (2 * side);
  return at > 0 && at < side ? std::clamp<std::int64_t>(rounded, 1, steps - 1) : rounded;
}

/// Whether the mesh is the tile's own with every vertex where rounding puts it: then it keeps the promise. Where that
/// would turn a triangle over the server mends the mesh, which may cost more than E_L allows for.
bool is_plainly_rounded(const Run& run, const Tile& tile, const TerrainMesh& mesh) {
  using Positions = std::vector<std::array<std::int64_t, 2>>;
  Positions expected, found;
  const std::int64_t side = run.manifest.frame.side(tile.id.level);
  for (const Vertex& v : tile.vertices) expected.push_back({nearest_step(v.x, side), nearest_step(v.y, side)});
  for (std::size_t k = 0; k < mesh.u.size(); ++k) found.push_back({mesh.u[k], mesh.v[k]});
  std::sort(expected.begin(), expected.end());
  std::sort(found.begin(), found.end());
  return expected == found && mesh.triangles.size() == tile.triangles.size();
}

/// Whether a post is a vertex of the tile and of the mesh, there with its own height, at most a step away: nothing but
/// rounding its position puts the mesh off it.
class MovedVertices {
 public:
  MovedVertices(const Run& run, const Tile& tile, const TerrainMesh& mesh)
      : side_(run.manifest.frame.side(tile.id.level)), tolerance_m_(run.tolerance_m(tile.id.level)) {
    for (const Vertex& v : tile.vertices) stored_.insert({v.x, v.y});
    for (std::size_t k = 0; k < mesh.u.size(); ++k) served_m_[{mesh.u[k], mesh.v[k]}] = mesh.height_m(k);
  }
  bool operator()(double x, double y, double height_m) const {
    const std::int64_t at_x = std::llround(x), at_y = std::llround(y);
    if (!stored_.contains({at_x, at_y})) return false;
    const auto served = served_m_.find({nearest_step(at_x, side_), nearest_step(at_y, side_)});
    return served != served_m_.end() && std::abs(served->second - height_m) <= tolerance_m_;
  }

 private:
  std::int64_t side_;
  double tolerance_m_;
  std::set<std::pair<std::int64_t, std::int64_t>> stored_;
  std::map<std::pair<std::int64_t, std::int64_t>, double> served_m_;
};

/// Holds the decoded mesh against the source's posts.
void measure_mesh(Run& run, const Node& node, const TerrainMesh& mesh) {
  const double scale = static_cast<double>(run.manifest.frame.side(node.id.level)) / kMaxValue;
  std::vector<std::array<SurfacePoint, 3>> triangles;
  for (const Corners& t : mesh.triangles) {
    auto& p = triangles.emplace_back();
    for (std::size_t c = 0; c < 3; ++c) p[c] = {mesh.u[t[c]] * scale, mesh.v[t[c]] * scale, mesh.height_m(t[c])};
  }
  Check& check = run.check("terrain-error");
  const bool is_held = node.tile != nullptr && is_plainly_rounded(run, *node.tile, mesh);
  Check aside("aside", "", "");
  std::optional<MovedVertices> moved;  // seldom needed
  const auto is_moved = [&](double x, double y, double height_m) {
    if (!moved) moved.emplace(run, *node.tile, mesh);
    return (*moved)(x, y, height_m);
  };
  const double worst = scan_surface(run, node.id, triangles, is_held ? check : aside, "as .terrain",
                                    is_held ? IsExcused(is_moved) : nullptr);
  if (!is_held && aside.failures() > 0) {
    check.note(
        fmt::format("tile {}: rounding to 0..32767 would turn triangles over; as mended for .terrain it is off "
                    "by up to {:.3f} m",
                    node.id.text(), worst));
  }
  const std::lock_guard lock(run.figures_mutex);
  LevelFigures& figures = run.figures(node.id.level);
  figures.terrain_max_error_m = std::max(figures.terrain_max_error_m.value_or(0), worst);
}

void fetch_mesh(Run& run, std::size_t k) {
  const Node& node = run.pyramid.nodes()[k];
  const std::string path = run.route(node.id.text() + ".terrain?extensions=octvertexnormals");
  Check& answers = run.check("tiles-answer");
  answers.looked_at();
  const auto answer = run.source.get(path);
  if (!answer) return answers.fail(answer.error());
  if (answer->status != 200) return answers.fail(fmt::format("{} answers {}", path, answer->status));
  if (answer->content_type.rfind("application/vnd.quantized-mesh", 0) != 0) {
    answers.fail(fmt::format("{} has Content-Type '{}'", path, answer->content_type));
  }
  Check& decode = run.check("decode");
  decode.looked_at();
  const auto mesh = read_terrain(answer->body);
  if (!mesh) return decode.fail("tile " + node.id.text() + ": " + mesh.error());
  Check& check = run.check("terrain");
  check.looked_at();
  const std::string name = "tile " + node.id.text() + ": ";
  for (const auto& fault : find_mesh_faults(*mesh)) check.fail(name + fault);
  if (mesh->normals.empty()) check.fail(name + "has no normals, though they were asked for");
  if (!sphere_holds_all(run.manifest, node.id, *mesh)) check.fail(name + "a vertex is outside the bounding sphere");
  if (node.tile != nullptr) check_heights(run, node, *mesh, check);
  run.terrain_borders[k] = borders_of(*mesh);
  if (run.posts == nullptr) return;
  measure_mesh(run, node, *mesh);
}

/// Two borders of neighbours; empty: they agree.
std::string compare_borders(const TerrainBorder& a, const TerrainBorder& b) {
  if (a.positions.size() != b.positions.size())
    return fmt::format("{} vertices against {}", a.positions.size(), b.positions.size());
  for (std::size_t k = 0; k < a.positions.size(); ++k) {
    if (a.positions[k] != b.positions[k])
      return fmt::format("vertex {}: position {} against {}", k, a.positions[k], b.positions[k]);
    if (a.heights_m[k] != b.heights_m[k]) {
      return fmt::format("vertex {} at {}: height {} m against {} m", k, a.positions[k], a.heights_m[k],
                         b.heights_m[k]);
    }
    const bool with_normals = !a.normals.empty() && !b.normals.empty();
    if (with_normals && a.normals[k] != b.normals[k])
      return fmt::format("vertex {} at {}: another normal", k, a.positions[k]);
  }
  return "";
}

/// Tiles of one level that layer.json calls available; nullopt when the JSON is not as clients need it.
std::optional<std::set<std::pair<std::uint32_t, std::uint32_t>>> available_tiles(const nlohmann::json& ranges,
                                                                                 int level, std::uint64_t at_most) {
  std::set<std::pair<std::uint32_t, std::uint32_t>> tiles;
  if (!ranges.is_array()) return std::nullopt;
  for (const auto& range : ranges) {
    std::array<std::uint64_t, 4> v{};
    static constexpr std::array<const char*, 4> kNames = {"startX", "startY", "endX", "endY"};
    for (std::size_t k = 0; k < 4; ++k) {
      if (!range.is_object() || !range.contains(kNames[k]) || !range[kNames[k]].is_number_unsigned())
        return std::nullopt;
      v[k] = range[kNames[k]].get<std::uint64_t>();
    }
    if (v[2] < v[0] || v[3] < v[1] || v[2] >= TileId::count_x(level) || v[3] >= TileId::count_y(level))
      return std::nullopt;
    if ((v[2] - v[0] + 1) * (v[3] - v[1] + 1) > at_most) return std::nullopt;
    for (auto y = v[1]; y <= v[3]; ++y) {
      for (auto x = v[0]; x <= v[2]; ++x) tiles.emplace(static_cast<std::uint32_t>(y), static_cast<std::uint32_t>(x));
    }
  }
  return tiles;
}

}  // namespace

void fetch_terrain(Run& run) {
  run.terrain_borders.resize(run.pyramid.nodes().size());
  for_each_parallel(run.pyramid.nodes().size(), run.options.threads, [&](std::size_t k) { fetch_mesh(run, k); });
  Check& check = run.check("terrain-error");
  if (run.posts == nullptr) {
    check.skip("no --source was given");
  } else if (check.count() == 0 && check.failures() == 0) {
    check.skip("no tile with source posts could be rounded to 0..32767 without being mended");
  }
}

void check_terrain_borders(Run& run) {
  Check& check = run.check("terrain-borders");
  const auto& nodes = run.pyramid.nodes();
  for (std::size_t k = 0; k < nodes.size(); ++k) {
    for (const std::size_t e : {std::size_t{0}, std::size_t{1}}) {  // west and south; the others are the neighbours'
      const std::int32_t beyond = nodes[k].neighbours[e == 0 ? 3 : 0];
      const TerrainBorder& here = run.terrain_borders[k][e];
      if (beyond < 0 || here.positions.empty()) continue;
      const TerrainBorder& there = run.terrain_borders[static_cast<std::size_t>(beyond)][e + 2];
      if (there.positions.empty()) continue;
      check.looked_at();
      const std::string difference = compare_borders(here, there);
      if (difference.empty()) continue;
      check.fail(fmt::format("{} border of {}.terrain is not the {} border of {}.terrain: {}", kEdgeNames[e],
                             nodes[k].id.text(), kEdgeNames[e + 2], nodes[static_cast<std::size_t>(beyond)].id.text(),
                             difference));
    }
  }
}

void check_layer_json(Run& run) {
  Check& check = run.check("layer-json");
  check.looked_at();
  const std::string path = run.route("layer.json");
  const auto answer = run.source.get(path);
  if (!answer) return check.fail(answer.error());
  if (answer->status != 200) return check.fail(fmt::format("{} answers {}", path, answer->status));
  const auto layer = nlohmann::json::parse(answer->body.begin(), answer->body.end(), nullptr, false);
  if (!layer.is_object()) return check.fail("layer.json is no JSON object");
  const auto expect = [&](const char* name, bool good, const char* what) {
    if (!layer.contains(name) || !good) check.fail(fmt::format("layer.json: '{}' is not {}", name, what));
  };
  const auto is_text = [&](const char* name, const char* text) { return layer.contains(name) && layer[name] == text; };
  expect("tilejson", layer.contains("tilejson") && layer["tilejson"].is_string(), "a string");
  expect("format", is_text("format", "quantized-mesh-1.0"), "'quantized-mesh-1.0'");
  expect("version", layer.contains("version") && layer["version"].is_string(), "a string");
  expect("scheme", is_text("scheme", "tms"), "'tms'");
  expect("projection", is_text("projection", "EPSG:4326"), "'EPSG:4326'");
  expect("bounds", layer.contains("bounds") && layer["bounds"].is_array() && layer["bounds"].size() == 4,
         "four numbers");
  expect("minzoom", layer.contains("minzoom") && layer["minzoom"] == 0, "0");
  expect("maxzoom", layer.contains("maxzoom") && layer["maxzoom"] == run.manifest.bottom_level, "the bottom level");
  const bool has_tiles =
      layer.contains("tiles") && layer["tiles"].is_array() && !layer["tiles"].empty() && layer["tiles"][0].is_string();
  expect("tiles", has_tiles && layer["tiles"][0].get<std::string>().find("{z}/{x}/{y}.terrain") != std::string::npos,
         "a list with a {z}/{x}/{y}.terrain template");
  const bool has_levels = layer.contains("available") && layer["available"].is_array() &&
                          layer["available"].size() == run.manifest.levels.size();
  expect("available", has_levels, "one list per level");
  if (!has_levels) return;
  for (const LevelView& level : run.manifest.levels) {
    check.looked_at();
    const auto claimed =
        available_tiles(layer["available"][static_cast<std::size_t>(level.level)], level.level, level.n_tiles);
    std::set<std::pair<std::uint32_t, std::uint32_t>> stored;
    for (const StoredRun& row : level.rows) {
      for (std::uint32_t x = row.x_first; x <= row.x_last; ++x) stored.emplace(row.y, x);
    }
    if (!claimed) {
      check.fail(fmt::format("layer.json: 'available' of level {} is broken or names more tiles than are stored",
                             level.level));
    } else if (*claimed != stored) {
      check.fail(fmt::format("layer.json: level {} has {} tiles available, {} are stored; they differ", level.level,
                             claimed->size(), stored.size()));
    }
  }
}

}  // namespace tind::client
