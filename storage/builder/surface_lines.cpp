// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/surface_lines.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "storage/builder/tile_posts.hpp"
#include "storage/builder/vertex_estimate.hpp"
#include "storage/readers/noding.hpp"
#include "storage/readers/scratch_map.hpp"

namespace tind {
namespace {

// How closely lines are drawn in plan: on a slope of one in two, two tolerances to the side are one in height; beyond a
// few posts a stream would leave its valley (docs/decisions/0007-drainage.md has the figures).
constexpr double kPlanTolerances = 2;
constexpr double kMostValleyPosts = 3;
constexpr double kLeastPlanPosts = 0.5;

// Metres between post rows.
double post_spacing_m(const HeightField& field) {
  return field.dy * field.lattice.step_deg() * std::numbers::pi / 180 * field.lattice.ellipsoid.semi_major_m;
}

std::vector<LineDetail> details_of(const HeightField& field, const LevelTable& table) {
  const double post_m = post_spacing_m(field);
  std::vector<LineDetail> detail;
  for (const LevelSpec& level : table.levels) {
    const double plan_m = std::max(kPlanTolerances * level.tolerance_m, kLeastPlanPosts * post_m);
    detail.push_back({plan_m, level.tolerance_m, kMostValleyPosts * post_m});
  }
  return detail;
}

// Nested vertices keep their height on every finer level, so the finest tolerance bounds what lines may move.
double max_change_m(const LevelTable& table) { return table.levels.back().tolerance_m / 2; }

// Sets what the user left open by how many posts stand behind a vertex of the bottom level.
void choose_sizes(const HeightField& field, const LevelTable& table, const LineOptions& options, const FlowRun& run,
                  SurfaceLines& lines) {
  lines.drainage_cells = options.drainage_cells.value_or(0);
  lines.lake_area_m2 = options.lake_area_m2.value_or(0);
  if (options.drainage_cells && options.lake_area_m2) return;
  std::vector<std::int64_t> n_of_row(static_cast<std::size_t>(field.n_rows), 0);
  for_row_bands(run, field.n_rows, [&](std::int64_t row_begin, std::int64_t row_end) {
    for (std::int64_t r = row_begin; r < row_end; ++r) {
      std::int64_t n = 0;
      for (std::int64_t c = 0; c < field.n_cols; ++c) n += is_of_source(field.origin_at(r, c)) ? 1 : 0;
      n_of_row[static_cast<std::size_t>(r)] = n;
    }
  });
  std::int64_t n_posts = 0;
  double area_m2 = 0;
  const double post_m = post_spacing_m(field);
  for (std::int64_t r = 0; r < field.n_rows; ++r) {
    const std::int64_t n = n_of_row[static_cast<std::size_t>(r)];
    n_posts += n;
    const double latitude = (field.post_y(r) * field.lattice.step_deg() - 90) * std::numbers::pi / 180;
    area_m2 += static_cast<double>(n) * post_m * post_m * (field.dx / field.dy) * std::max(0.0, std::cos(latitude));
  }
  const double vertices = estimate_bottom_vertices(field, table, run.threads);
  if (!options.drainage_cells) {
    const double cells = kCellsPerVertex * static_cast<double>(n_posts) / vertices;
    lines.drainage_cells = std::max<std::int64_t>(1, std::llround(cells));
  }
  if (!options.lake_area_m2) {
    lines.lake_area_m2 = std::round(std::max(DrainageOptions().lake_area_m2, kLakePerVertex * area_m2 / vertices));
  }
}

// What is known of a chain beside its course, for the output of lines.
struct Provenance {
  const char* kind = "stream";
  std::optional<int> strahler;
  std::optional<double> area_km2;
  int first_level = 0;
};

struct Chains {
  std::vector<BreakChain> chains;
  bool have_provenance = false;
  std::vector<Provenance> provenance;  // parallel, if wanted
  std::vector<ScratchMap> kept;        // where vertices of chains are

  void add(BreakChain chain, Provenance of) {
    of.first_level = chain.first_level;
    if (have_provenance) provenance.push_back(of);
    chains.push_back(std::move(chain));
  }
};

Result<void> add_drainage(const HeightField& field, const LevelTable& table, const LineOptions& options,
                          ScratchPlace place, const FlowRun& run, SurfaceLines& lines, Chains& all) {
  DrainageOptions drainage_options;
  drainage_options.run = run;
  drainage_options.cells = lines.drainage_cells;
  drainage_options.growth = options.drainage_growth;
  drainage_options.lake_area_m2 = lines.lake_area_m2;
  drainage_options.sea_level_m = options.sea_level_m;
  drainage_options.bottom_level = table.bottom_level();
  drainage_options.max_change_m = max_change_m(table);
  for (const LevelSpec& level : table.levels) drainage_options.deviation_limits_m.push_back(level.tolerance_m / 2);
  std::vector<ScratchMap> scratch;
  std::string scratch_error;
  const auto allocate = [&](std::size_t n_bytes) -> void* {
    auto map = place.make(n_bytes);
    if (!map) {
      scratch_error = map.error().message;
      return nullptr;
    }
    scratch.push_back(std::move(*map));
    return scratch.back().data();
  };
  drainage_options.kept = [&](std::size_t n_bytes) -> void* {
    auto map = place.make(n_bytes);
    if (!map) return nullptr;  // there is the heap
    all.kept.push_back(std::move(*map));
    return all.kept.back().data();
  };
  auto drainage = derive_drainage(field, drainage_options, allocate);
  if (!drainage) {
    if (!scratch_error.empty()) return fail(ErrorKind::kIo, scratch_error);
    return tl::unexpected(drainage.error());
  }
  lines.drainage = drainage->counts;
  lines.counts.streams = drainage->streams.size();
  lines.counts.shores = drainage->shores.size();
  all.chains.reserve(drainage->streams.size() + drainage->shores.size());
  for (std::size_t k = 0; k < drainage->streams.size(); ++k) {
    all.add(std::move(drainage->streams[k]), {"stream", drainage->strahler[k], drainage->area_km2[k]});
  }
  for (BreakChain& shore : drainage->shores) all.add(std::move(shore), {"shore", {}, {}});
  return {};
}

// Cuts derived and given lines at each other: neither kind knows of the other.
Result<void> node_all(Chains& all) {
  std::vector<LatticeLine> lines;
  for (const BreakChain& chain : all.chains) lines.emplace_back(chain.points().begin(), chain.points().end());
  auto noded = node_lines(lines);
  if (!noded) return tl::unexpected(noded.error());
  Chains cut;
  cut.have_provenance = all.have_provenance;
  for (NodedPiece& piece : noded->pieces) {
    BreakChain chain{std::move(piece.vertices), std::numeric_limits<int>::max(), -1};
    std::size_t heaviest = 0;
    for (const std::uint32_t line : piece.lines) {
      const BreakChain& of = all.chains[line];
      chain.first_level = std::min(chain.first_level, of.first_level);
      chain.in_valley = chain.in_valley || of.in_valley;
      if (of.weight > chain.weight) {
        chain.weight = of.weight;
        heaviest = line;
      }
    }
    cut.add(std::move(chain), all.have_provenance ? all.provenance[heaviest] : Provenance());
  }
  all = std::move(cut);
  return {};
}

std::vector<OutputLayer> layers_of(const Lattice& lattice, const LevelTable& table, const LinePyramid& pyramid,
                                   const std::vector<Provenance>& provenance) {
  std::vector<OutputLayer> layers;
  for (int level = 0; level <= table.bottom_level(); ++level) {
    OutputLayer layer{fmt::format("level_{:02}", level), {}};
    for (const DrawnLine& drawn : pyramid.drawn(level)) {
      const Provenance& of = provenance[drawn.chain];
      OutputLine line{{}, of.kind, of.strahler, of.area_km2, of.first_level};
      std::int64_t x_before = drawn.vertices.front().x;
      for (const LatticePoint& p : drawn.vertices) {
        // Across longitude 180 the line goes on past it.
        std::int64_t x = p.x;
        while (x - x_before > lattice.width() / 2) x -= lattice.width();
        while (x_before - x > lattice.width() / 2) x += lattice.width();
        x_before = x;
        line.vertices.push_back({lattice.longitude_deg(x), lattice.latitude_deg(p.y), lattice.height_m(p.z)});
      }
      layer.lines.push_back(std::move(line));
    }
    if (!layer.lines.empty()) layers.push_back(std::move(layer));
  }
  return layers;
}

}  // namespace

Result<SurfaceLines> make_surface_lines(const HeightField& field, const LevelTable& table, const LineOptions& options,
                                        ScratchPlace place, int threads, const std::atomic<bool>* cancel,
                                        const std::function<void(double)>& progress,
                                        const std::function<void()>& pause) {
  SurfaceLines lines;
  Chains all;
  all.have_provenance = !options.lines_out.empty();
  if (options.drainage) {
    choose_sizes(field, table, options, {threads, cancel, {}, pause}, lines);
    if (cancel != nullptr && *cancel) return fail(ErrorKind::kInterrupted, "interrupted");
    if (auto added = add_drainage(field, table, options, place, {threads, cancel, progress, pause}, lines, all);
        !added) {
      return tl::unexpected(added.error());
    }
  }
  if (!options.given.empty()) {
    auto given = read_break_lines(options.given, break_line_options(field, max_change_m(table)));
    if (!given) return tl::unexpected(given.error());
    lines.notes = given->notes;
    lines.given = given->counts;
    lines.given_sources = given->sources;
    lines.counts.given = given->chains.size();
    for (std::size_t k = 0; k < given->chains.size(); ++k) {
      all.add(std::move(given->chains[k]), {given->is_shore[k] ? "shore" : "breakline", {}, {}});
    }
    if (options.drainage) {
      if (auto noded = node_all(all); !noded) return tl::unexpected(noded.error());
    }
  }
  if (!all.chains.empty()) {
    std::vector<ScratchMap> working;
    const auto in_maps = [&](std::vector<ScratchMap>& maps) {
      return [&](std::size_t n_bytes) -> void* {
        auto map = place.make(n_bytes);
        if (!map) return nullptr;  // there is the heap
        maps.push_back(std::move(*map));
        return maps.back().data();
      };
    };
    lines.pyramid = LinePyramid(field.lattice, std::move(all.chains), details_of(field, table), in_maps(lines.scratch),
                                in_maps(working));
    lines.counts.vertices = lines.pyramid.n_vertices(table.bottom_level());
  }
  if (!options.lines_out.empty()) lines.layers = layers_of(field.lattice, table, lines.pyramid, all.provenance);
  return lines;
}

}  // namespace tind
