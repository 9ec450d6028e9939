// SPDX-License-Identifier: GPL-3.0-or-later
// Manifest, routes, and each tile on its own.
#include <fmt/format.h>

#include <cmath>
#include <set>
#include <nlohmann/json.hpp>

#include "tests/client/checks.hpp"
#include "tests/client/decode.hpp"
#include "tests/client/parallel.hpp"
#include "tests/client/tile_faults.hpp"

namespace tind::client {
namespace {

/// How many tiles the routes of single pieces and codes are tried on.
constexpr std::size_t kRouteSample = 60;

/// A body with status 200, or nullopt after the finding was recorded.
std::optional<Blob> fetch(Run& run, const std::string& path, const char* content_type) {
  Check& check = run.check("tiles-answer");
  check.looked_at();
  auto answer = run.source.get(path);
  if (!answer) {
    check.fail(answer.error());
    return std::nullopt;
  }
  if (answer->status != 200) {
    check.fail(fmt::format("{} answers {}", path, answer->status));
    return std::nullopt;
  }
  if (answer->content_type != content_type) {
    check.fail(fmt::format("{} has Content-Type '{}', not '{}'", path, answer->content_type, content_type));
  }
  return std::move(answer->body);
}

void check_header(Run& run, const Node& node, const VnTile& vn) {
  Check& check = run.check("tile-header");
  check.looked_at();
  const Tile& tile = vn.tile;
  const std::string name = "tile " + node.id.text() + ": ";
  const double tolerance = run.tolerance_m(node.id.level);
  const auto expect = [&](bool good, const std::string& what) {
    if (!good) check.fail(name + what);
  };
  expect(
      vn.lattice_level == run.manifest.frame.lattice_level && vn.height_exponent == run.manifest.frame.height_exponent,
      "lattice level or height exponent are not the manifest's");
  expect(vn.tolerance_m == static_cast<float>(tolerance),
         fmt::format("E_L is {} m, the manifest says {} m", vn.tolerance_m, tolerance));
  expect(tile.coverage == node.coverage,
         fmt::format("coverage is {}, the manifest's rows say {}", tile.coverage, node.coverage));
  expect(tile.coverage != 0 || tile.n_posts == 0, fmt::format("is filler, yet counts {} source posts", tile.n_posts));
  expect(tile.max_error_m >= 0 && static_cast<double>(tile.max_error_m) <= tolerance * (1 + 1e-6),
         fmt::format("stored max error {} m is above E_L {} m", tile.max_error_m, tolerance));
  expect(tile.rmse_m >= 0 && tile.rmse_m <= tile.max_error_m * 1.000001f,
         fmt::format("stored RMSE {} m is above its max error {} m", tile.rmse_m, tile.max_error_m));
  expect(tile.n_posts > 0 || (tile.max_error_m == 0 && tile.rmse_m == 0), "has errors without posts");
  for (const auto& fault : find_range_faults(tile)) check.fail(name + fault);
}

void check_alone(Run& run, const Tile& tile) {
  const LatticeFrame& frame = run.manifest.frame;
  const auto record = [&](const char* id, std::uint64_t n, const std::vector<std::string>& faults) {
    Check& check = run.check(id);
    check.looked_at(n);
    for (const auto& fault : faults) check.fail("tile " + tile.id.text() + ": " + fault);
  };
  record("outline", 1, find_outline_faults(tile, frame));
  record("interior", tile.vertices.size() - tile.ring_size(), find_interior_faults(tile, frame));
  record("triangles", tile.triangles.size(), find_triangle_faults(tile, frame));
  record("virtual-triangles", tile.vts.size(), find_vt_faults(tile));
}

/// What differs between the served tile and the one put together from its parts.
std::string describe_difference(const Tile& served, const Tile& own) {
  if (served.n_side != own.n_side) return "the numbers of border vertices differ";
  if (served.vertices.size() != own.vertices.size()) {
    return fmt::format("{} vertices served, {} in the parts", served.vertices.size(), own.vertices.size());
  }
  for (std::size_t k = 0; k < own.vertices.size(); ++k) {
    const Vertex &a = served.vertices[k], &b = own.vertices[k];
    if (a != b) {
      return fmt::format("vertex {} is ({}, {}) height {}, in the parts ({}, {}) height {}", k, a.x, a.y, a.z, b.x, b.y,
                         b.z);
    }
  }
  if (served.entries != own.entries) return "entry levels differ";
  if (served.triangles != own.triangles) return "triangles differ";
  if (served.vts != own.vts || served.runs != own.runs || served.n_gaps != own.n_gaps)
    return "virtual triangles differ";
  if (served.max_error_m != own.max_error_m || served.rmse_m != own.rmse_m) return "stored errors differ";
  return "header fields differ";
}

void check_parts(Run& run, const Tile& tile, const Blob& body) {
  Check& decode = run.check("decode");
  decode.looked_at();
  const std::string name = "tile " + tile.id.text() + ": ";
  const auto bundle = read_bundle(body);
  if (!bundle) return decode.fail(name + bundle.error());
  const auto pieces = read_pieces(*bundle, run.manifest.frame);
  if (!pieces) return decode.fail(name + pieces.error());
  Check& check = run.check("assembly");
  check.looked_at();
  if (bundle->id != tile.id) return check.fail(name + ".parts names tile " + bundle->id.text());
  const auto own = assemble_pieces(tile.id, *pieces, run.manifest.frame);
  if (!own) return check.fail(name + own.error());
  if (!(*own == tile)) check.fail(name + describe_difference(tile, *own));
}

}  // namespace

void check_manifest(Run& run) {
  Check& check = run.check("manifest");
  check.looked_at(run.manifest.levels.size());
  for (const auto& fault : find_manifest_faults(run.manifest)) check.fail(fault);
}

void check_outside(Run& run) {
  Check& check = run.check("outside");
  std::vector<TileId> absent;
  const int bottom = run.manifest.bottom_level;
  // Next to what is stored, below the bottom, and beyond the grid of tiles.
  for (const Node& node : run.pyramid.nodes()) {
    if (absent.size() >= 6) break;
    for (int d = 0; d < 4; ++d) {
      const TileId next{node.id.level, node.id.x + (d == 0 ? 1u : 0u) - (d == 1 ? 1u : 0u),
                        node.id.y + (d == 2 ? 1u : 0u) - (d == 3 ? 1u : 0u)};
      if (next.valid() && !run.manifest.has(next) && absent.size() < 6) absent.push_back(next);
    }
  }
  absent.push_back({bottom + 1, 0, 0});
  absent.push_back({0, 2, 0});
  absent.push_back({0, 0, 1});
  for (const TileId& id : absent) {
    for (const std::string& path :
         {id.text() + ".vn", id.text() + ".parts", id.text() + ".terrain", "body/" + id.text()}) {
      check.looked_at();
      const auto answer = run.source.get(run.route(path));
      if (!answer) {
        check.fail(answer.error());
      } else if (answer->status != 404) {
        check.fail(fmt::format("{} is not stored, but answers {}", run.route(path), answer->status));
      }
    }
  }
}

void fetch_tiles(Run& run) {
  auto& nodes = run.pyramid.nodes();
  for_each_parallel(nodes.size(), run.options.threads, [&](std::size_t k) {
    Node& node = nodes[k];
    const std::string name = node.id.text();
    const auto vn_body = fetch(run, run.route(name + ".vn"), "application/vnd.tind.vn");
    const auto parts_body = fetch(run, run.route(name + ".parts"), "application/vnd.tind.parts");
    if (!vn_body) return;
    Check& decode = run.check("decode");
    decode.looked_at();
    auto vn = read_vn(*vn_body);
    if (!vn) return decode.fail("tile " + name + ": " + vn.error());
    if (vn->tile.id != node.id) {
      return run.check("tile-header").fail(fmt::format("tile {}: its header says it is {}", name, vn->tile.id.text()));
    }
    check_header(run, node, *vn);
    check_alone(run, vn->tile);
    if (parts_body) check_parts(run, vn->tile, *parts_body);
    node.tile = std::make_unique<Tile>(std::move(vn->tile));
  });
  run.pyramid.unlink_unread();
}

void check_totals(Run& run) {
  Check& check = run.check("totals");
  struct Sum {
    std::uint64_t tiles = 0, triangles = 0, interior = 0, inner = 0, posts = 0, vts = 0, vertices = 0;
    std::set<std::pair<std::int64_t, std::int64_t>> corners;
    double max_error = 0, squares = 0;
  };
  std::vector<Sum> sums(run.manifest.levels.size());
  const LatticeFrame& frame = run.manifest.frame;
  bool complete = !run.pyramid.is_sample();
  for (const Node& node : run.pyramid.nodes()) {
    if (node.tile == nullptr) {
      complete = false;
      continue;
    }
    const Tile& tile = *node.tile;
    Sum& sum = sums[static_cast<std::size_t>(node.id.level)];
    ++sum.tiles;
    sum.triangles += tile.triangles.size();
    sum.vts += tile.vts.size();
    sum.vertices += tile.vertices.size();
    sum.interior += tile.vertices.size() - tile.ring_size();
    sum.posts += tile.n_posts;
    sum.max_error = std::max(sum.max_error, static_cast<double>(tile.max_error_m));
    sum.squares += static_cast<double>(tile.n_posts) * tile.rmse_m * tile.rmse_m;
    // South and west edges belong to this tile; the others only where no tile stands beyond.
    sum.inner += tile.n_side[0] + tile.n_side[3] + (node.neighbours[1] < 0 ? tile.n_side[1] : 0) +
                 (node.neighbours[2] < 0 ? tile.n_side[2] : 0);
    const std::int64_t s = frame.side(node.id.level);
    for (int c = 0; c < 4; ++c) {
      const std::int64_t y = frame.origin_y(node.id) + (c >> 1) * s;
      const bool pole = y == 0 || y == frame.height();
      sum.corners.insert({pole ? 0 : (frame.origin_x(node.id) + (c & 1) * s) % frame.width(), y});
    }
  }
  std::uint64_t bottom_posts = 0;
  for (std::size_t l = 0; l < sums.size(); ++l) {
    const Sum& sum = sums[l];
    LevelFigures& figures = run.figures(static_cast<int>(l));
    figures.tiles = sum.tiles;
    figures.vertices = complete ? sum.interior + sum.inner + sum.corners.size() : sum.vertices;
    figures.triangles = sum.triangles;
    figures.vts = sum.vts;
    figures.posts = sum.posts;
    figures.stored_max_error_m = sum.max_error;
    bottom_posts = sum.posts;
    if (!complete) continue;
    const LevelView& level = run.manifest.levels[l];
    const auto equal = [&](const char* what, double claimed, double found, double tolerance) {
      check.looked_at();
      if (std::abs(claimed - found) > tolerance) {
        check.fail(fmt::format("level {}: meta.json says {} {}, the tiles have {}", l, what, claimed, found));
      }
    };
    const auto number = [](std::uint64_t n) { return static_cast<double>(n); };
    equal("n_triangles", number(level.n_triangles), number(sum.triangles), 0);
    equal("n_posts", number(level.n_posts), number(sum.posts), 0);
    equal("n_vertices", number(level.n_vertices), number(figures.vertices), 0);
    equal("n_border_vertices", number(level.n_border_vertices), number(sum.inner + sum.corners.size()), 0);
    equal("max_error_m", level.max_error_m, sum.max_error, 1e-6 * (1 + sum.max_error));
    const double rmse = sum.posts > 0 ? std::sqrt(sum.squares / number(sum.posts)) : 0;
    equal("rmse_m", level.rmse_m, rmse, 1e-5 * (1 + rmse));
  }
  if (!complete) {
    check.skip("not every stored tile was read");
  } else if (bottom_posts > run.manifest.n_source_posts) {
    check.fail(fmt::format("the bottom tiles count {} posts, the manifest has {} source posts", bottom_posts,
                           run.manifest.n_source_posts));
  }
}

void check_pieces(Run& run) {
  Check& check = run.check("pieces");
  const auto& nodes = run.pyramid.nodes();
  const std::size_t stride = std::max<std::size_t>(1, nodes.size() / kRouteSample);
  for_each_parallel((nodes.size() + stride - 1) / stride, run.options.threads, [&](std::size_t n) {
    const TileId id = nodes[n * stride].id;
    const auto answer = run.source.get(run.route(id.text() + ".parts"));
    if (!answer || answer->status != 200) return;
    const auto bundle = read_bundle(answer->body);
    if (!bundle) return;
    const std::uint32_t x1 = (id.x + 1) % TileId::count_x(id.level), y1 = id.y + 1;
    const auto corner = [&](std::uint32_t i, std::uint32_t j) {
      const bool pole = j == 0 || j == TileId::count_y(id.level);
      return fmt::format("corner/{}/{}/{}", id.level, pole ? 0u : i, j);
    };
    const auto edge = [&](char direction, std::uint32_t i, std::uint32_t j) {
      return fmt::format("edge/{}/{}/{}/{}", id.level, direction, i, j);
    };
    const std::array<std::string, 9> routes = {corner(id.x, id.y),  edge('h', id.x, id.y), corner(x1, id.y),
                                               edge('v', x1, id.y), corner(x1, y1),        edge('h', id.x, y1),
                                               corner(id.x, y1),    edge('v', id.x, id.y), "body/" + id.text()};
    for (std::size_t k = 0; k < 9; ++k) {
      check.looked_at();
      const std::string path = run.route(routes[k]);
      const auto piece = run.source.get(path);
      if (!piece) {
        check.fail(piece.error());
      } else if (piece->status != 200) {
        check.fail(fmt::format("{} answers {}", path, piece->status));
      } else if (piece->content_type != "application/vnd.tind.piece") {
        check.fail(fmt::format("{} has Content-Type '{}'", path, piece->content_type));
      } else {
        const auto record = open_value(piece->body), stored = open_value(bundle->values[k]);
        if (!record || !stored || *record != *stored)
          check.fail(path + " is not the record in " + id.text() + ".parts");
      }
    }
  });
}

void check_codes(Run& run) {
  Check& check = run.check("codes");
  const auto& nodes = run.pyramid.nodes();
  const std::size_t stride = std::max<std::size_t>(1, nodes.size() / kRouteSample);
  for_each_parallel((nodes.size() + stride - 1) / stride, run.options.threads, [&](std::size_t n) {
    const Node& node = nodes[n * stride];
    if (node.tile == nullptr) return;
    const TileId id = node.id;
    const std::string path = run.route("codes/" + id.text());
    const auto answer = run.source.get(path);
    if (!answer) return check.fail(answer.error());
    if (answer->status != 200) return check.fail(fmt::format("{} answers {}", path, answer->status));
    const auto served = nlohmann::json::parse(answer->body.begin(), answer->body.end(), nullptr, false);
    nlohmann::json own = {{"level", id.level}, {"x", id.x}, {"y", id.y}, {"gaps", nlohmann::json::array()}};
    for (int gap = 1; gap <= id.level; ++gap) {
      const int coarse = id.level - gap;
      auto borders = nlohmann::json::array();
      for (const auto& entries : node.tile->entries) {
        check.looked_at();
        std::vector<std::uint64_t> pieces = {0};
        for (std::size_t k = 1; k + 1 < entries.size(); ++k) {
          if (entries[k] <= coarse) {
            pieces.push_back(0);
          } else {
            ++pieces.back();
          }
        }
        borders.push_back(
            {{"runs", pieces}, {"starts_inside", entries.front() > coarse}, {"ends_inside", entries.back() > coarse}});
      }
      own["gaps"].push_back({{"gap", gap}, {"level", coarse}, {"borders", borders}});
    }
    check.looked_at();
    if (served != own) {
      std::string where = "is not the JSON of docs/http.md";
      if (served.is_object() && served.contains("gaps")) {
        const auto difference = nlohmann::json::diff(own, served);
        if (!difference.empty()) where = "differs at " + difference[0].value("path", std::string("?"));
      }
      check.fail(path + " " + where);
    }
  });
}

}  // namespace tind::client
