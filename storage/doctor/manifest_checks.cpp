// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/manifest_checks.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <nlohmann/json.hpp>
#include <string_view>

namespace tind {
namespace {

// Sums of 64-bit floats in one order are the same; a little is left for those of another compiler.
constexpr double kSlack = 1e-9;
constexpr int kMostHeightExponent = 16;
constexpr double kHeightStepsPerTolerance = 256;

class ManifestCheck {
 public:
  explicit ManifestCheck(const Manifest& manifest) : m_(manifest) {}

  Faults run(ByteView json) {
    one_of("mode", m_.mode, {"non-standard", "standard"});
    one_of("heights", m_.heights, {"orthometric", "ellipsoidal", "unknown"});
    one_of("source_kind", m_.source_kind, {"raster", "warped", "points"});
    one_of("resampling", m_.resampling, {"none", "bilinear", "cubic"});
    check_json(json);
    check_numbers();
    check_sources();
    check_levels();
    return std::move(faults_);
  }

 private:
  void fault(std::string what) { faults_.push_back({"manifest", std::move(what)}); }

  void one_of(const char* member, const std::string& value, std::initializer_list<std::string_view> allowed) {
    if (std::find(allowed.begin(), allowed.end(), value) == allowed.end()) {
      fault(fmt::format("{}: \"{}\" is none of its values", member, value));
    }
  }

  // Members that a Manifest leaves out because they are always the same.
  void check_json(ByteView text) {
    const auto json = nlohmann::json::parse(text.begin(), text.end(), nullptr, false);
    if (!json.contains("horizontal_crs") || json["horizontal_crs"] != "EPSG:4326")
      fault("horizontal_crs: not \"EPSG:4326\"");
    if (!json.contains("options") || !json["options"].is_object()) fault("options: not an object");
  }

  void check_numbers() {
    if (m_.vertical_datum.empty()) fault("vertical_datum: empty; \"unknown\" where nobody said");
    if (m_.generator.empty()) fault("generator: empty");
    if (!std::isfinite(m_.base_height_m)) fault("base_height_m: not a number");
    if (m_.falloff_posts < 0) fault("falloff_posts: negative");
    if (!(m_.disagreement_m >= 0)) fault("disagreement_m: negative");
    const auto [west, south, east, north] = m_.bounds_deg;
    if (!(west >= -360 && east <= 540 && west <= east && east - west <= 360 + kSlack && south >= -90 - kSlack &&
          south <= north && north <= 90 + kSlack)) {
      fault(fmt::format("bounds_deg: [{}, {}, {}, {}] is no part of the globe", west, south, east, north));
    }
    if (!(m_.spacing_deg[0] > 0 && m_.spacing_deg[1] > 0)) fault("spacing_deg: not positive");
    const double exponent = std::ceil(std::log2(kHeightStepsPerTolerance / m_.levels.back().tolerance_m) - kSlack);
    if (m_.lattice.height_exponent != std::clamp(exponent, 0.0, double{kMostHeightExponent})) {
      fault(fmt::format("height_exponent: {}, but the bottom level's tolerance of {} m makes {}",
                        m_.lattice.height_exponent, m_.levels.back().tolerance_m,
                        std::clamp(exponent, 0.0, double{kMostHeightExponent})));
    }
  }

  void check_sources() {
    if (m_.sources.empty()) fault("sources: none");
    const bool is_points = m_.source_kind == "points";
    for (const SourceInfo& source : m_.sources) {
      if (source.sha256.size() != 64 || source.sha256.find_first_not_of("0123456789abcdef") != std::string::npos) {
        fault(fmt::format("sources: \"{}\" has a sha256 that is none", source.name));
      }
      const bool has_grid = source.n_cols > 0 && source.n_rows > 0,
                 has_no_grid = source.n_cols == 0 && source.n_rows == 0;
      if (is_points ? !has_no_grid : !has_grid || source.n_points != 0) {
        fault(fmt::format("sources: \"{}\" has {} columns, {} rows and {} points, which no {} has", source.name,
                          source.n_cols, source.n_rows, source.n_points, is_points ? "point source" : "raster"));
      }
    }
  }

  void check_levels() {
    for (std::size_t k = 0; k < m_.levels.size(); ++k) {
      const LevelInfo& level = m_.levels[k];
      const auto fault_of = [&](const std::string& what) { fault(fmt::format("level {}: {}", k, what)); };
      int exponent = 0;
      if (std::frexp(level.height_step_m, &exponent) != 0.5) fault_of("height_step_m: not a power of two");
      if (!std::isfinite(level.tolerance_m) || !(level.spacing_m > 0)) fault_of("tolerance_m, spacing_m: not positive");
      if (k == 0) continue;
      const LevelInfo& above = m_.levels[k - 1];
      if (!(level.tolerance_m < above.tolerance_m)) fault_of("tolerance_m: not below that of the level above");
      if (std::abs(above.spacing_m - 2 * level.spacing_m) > kSlack * above.spacing_m) {
        fault_of("spacing_m: not half of that of the level above");
      }
      if (level.height_step_m > above.height_step_m) fault_of("height_step_m: above that of the level above");
    }
    if (m_.levels.front().n_tiles != kRootCountX) {
      fault(fmt::format("level 0: n_tiles: {}, but both roots are always there", m_.levels.front().n_tiles));
    }
  }

  const Manifest& m_;
  Faults faults_;
};

std::string row_text(const TileRun& run) {
  return fmt::format("[{}, {}, {}, {}]", run.y, run.x_first, run.x_last, static_cast<int>(run.coverage));
}

bool same(const TileRun& a, const TileRun& b) {
  return a.y == b.y && a.x_first == b.x_first && a.x_last == b.x_last && a.coverage == b.coverage;
}

// Where two lists of rows part, with the first tile there.
std::string find_row_fault(int level, const std::vector<TileRun>& said, const std::vector<TileRun>& counted) {
  const std::size_t n = std::min(said.size(), counted.size());
  std::size_t k = 0;
  while (k < n && same(said[k], counted[k])) ++k;
  if (k == said.size() && k == counted.size()) return "";
  const TileRun& run = k < counted.size() ? counted[k] : said[k];
  return fmt::format("rows: the {}th is {}, the stored tiles make {}, from {} on", k,
                     k < said.size() ? row_text(said[k]) : "missing",
                     k < counted.size() ? row_text(counted[k]) : "none",
                     name_of(TileKey{static_cast<std::uint8_t>(level), run.x_first, run.y}));
}

}  // namespace

Faults check_manifest(const Manifest& manifest, ByteView json) { return ManifestCheck(manifest).run(json); }

Faults compare_level(const LevelInfo& said, const LevelInfo& counted) {
  Faults faults;
  const auto fault = [&](const std::string& what) {
    faults.push_back({"manifest", fmt::format("level {}: {}", said.level, what)});
  };
  const auto equal = [&](const char* member, std::uint64_t a, std::uint64_t b) {
    if (a != b) fault(fmt::format("{}: {}, the file has {}", member, a, b));
  };
  const auto near = [&](const char* member, double a, double b) {
    if (!(std::abs(a - b) <= kSlack * std::max(std::abs(a), std::abs(b)))) {
      fault(fmt::format("{}: {}, the file has {}", member, a, b));
    }
  };
  equal("n_tiles", said.n_tiles, counted.n_tiles);
  equal("n_real", said.n_real, counted.n_real);
  equal("n_partial", said.n_partial, counted.n_partial);
  equal("n_filler", said.n_filler, counted.n_filler);
  equal("n_vertices", said.n_vertices, counted.n_vertices);
  equal("n_border_vertices", said.n_border_vertices, counted.n_border_vertices);
  equal("n_seed_vertices", said.n_seed_vertices, counted.n_seed_vertices);
  equal("n_triangles", said.n_triangles, counted.n_triangles);
  equal("n_posts", said.n_posts, counted.n_posts);
  near("max_error_m", said.max_error_m, counted.max_error_m);
  near("rmse_m", said.rmse_m, counted.rmse_m);
  equal("bytes", said.bytes, counted.bytes);
  if (const std::string what = find_row_fault(said.level, said.rows, counted.rows); !what.empty()) fault(what);
  return faults;
}

Faults check_posts(const Manifest& manifest, std::uint64_t n_posts, const PostBox& box) {
  Faults faults;
  if (manifest.shard_count > 1) return faults;  // the rest is in other files
  if (manifest.n_source_posts != n_posts) {
    faults.push_back({"manifest", fmt::format("posts: {} of the source, the tiles of a level have {}",
                                              manifest.n_source_posts, n_posts)});
  }
  const auto [west, south, east, north] = manifest.bounds_deg;
  // Across longitude 180 the tiles' box is the whole globe.
  if (!box || west < -180 || east >= 180 - kSlack) return faults;
  const double side = 180 / std::ldexp(1.0, manifest.bottom_level);
  const std::array<double, 4> off = {west - (*box)[0], south - (*box)[1], (*box)[2] - east, (*box)[3] - north};
  constexpr const char* kNames[] = {"west", "south", "east", "north"};
  for (std::size_t k = 0; k < 4; ++k) {
    // A post on a line is in the tile beyond; points are rounded to the lattice.
    if (off[k] >= -side * kSlack * 1e4 && off[k] <= side * (1 + kSlack * 1e4)) continue;
    faults.push_back({"manifest", fmt::format("bounds_deg: the {} end is at {}, the tiles with source posts end at {}",
                                              kNames[k], manifest.bounds_deg[k], (*box)[k])});
  }
  return faults;
}

}  // namespace tind
