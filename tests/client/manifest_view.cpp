// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/manifest_view.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

namespace tind::client {
namespace {

using nlohmann::json;

/// Collects the first thing that is wrong while members are read.
class MemberReader {
 public:
  MemberReader(const json& object, std::string where) : object_(object), where_(std::move(where)) {}

  double number(const char* name) {
    const json* member = find(name);
    return member != nullptr && expect(member->is_number(), name, "a number") ? member->get<double>() : 0;
  }
  std::uint64_t count(const char* name) {
    const json* member = find(name);
    return member != nullptr && expect(member->is_number_unsigned(), name, "a count") ? member->get<std::uint64_t>()
                                                                                      : 0;
  }
  int small(const char* name, int low, int high) {
    const json* member = find(name);
    if (member == nullptr || !expect(member->is_number_integer(), name, "an integer")) return low;
    const auto value = member->get<std::int64_t>();
    return expect(value >= low && value <= high, name, fmt::format("in {}..{}", low, high)) ? static_cast<int>(value)
                                                                                            : low;
  }
  std::string string(const char* name) {
    const json* member = find(name);
    return member != nullptr && expect(member->is_string(), name, "a string") ? member->get<std::string>() : "";
  }
  const json& array(const char* name) {
    static const json kEmpty = json::array();
    const json* member = find(name);
    return member != nullptr && expect(member->is_array(), name, "an array") ? *member : kEmpty;
  }
  const json& object(const char* name) {
    static const json kEmpty = json::object();
    const json* member = find(name);
    return member != nullptr && expect(member->is_object(), name, "an object") ? *member : kEmpty;
  }
  template <std::size_t N>
  std::array<double, N> numbers(const char* name) {
    std::array<double, N> values{};
    const json& list = array(name);
    if (!expect(list.size() == N, name, fmt::format("{} numbers", N))) return values;
    for (std::size_t k = 0; k < N; ++k) {
      if (expect(list[k].is_number(), name, fmt::format("{} numbers", N))) values[k] = list[k].get<double>();
    }
    return values;
  }
  /// Leaves `into` as it is when the member is not there.
  void string_if_there(const char* name, std::string& into) {
    if (object_.contains(name)) into = string(name);
  }
  const std::string& fault() const { return fault_; }

 private:
  const json* find(const char* name) {
    const auto it = object_.find(name);
    if (it != object_.end()) return &*it;
    if (fault_.empty()) fault_ = fmt::format("{}: '{}' is missing", where_, name);
    return nullptr;
  }
  bool expect(bool good, const char* name, const std::string& what) {
    if (!good && fault_.empty()) fault_ = fmt::format("{}: '{}' is not {}", where_, name, what);
    return good;
  }

  const json& object_;
  std::string where_, fault_;
};

Outcome<LevelView> read_level(const json& object, int level) {
  const std::string where = fmt::format("level {}", level);
  if (!object.is_object()) return refuse(where + " is no object");
  MemberReader in(object, where);
  LevelView view;
  view.level = in.small("level", 0, kDeepestLevel);
  view.tolerance_m = in.number("tolerance_m");
  view.spacing_m = in.number("spacing_m");
  view.height_step_m = in.number("height_step_m");
  view.max_error_m = in.number("max_error_m");
  view.rmse_m = in.number("rmse_m");
  view.n_tiles = in.count("n_tiles");
  view.n_real = in.count("n_real");
  view.n_partial = in.count("n_partial");
  view.n_filler = in.count("n_filler");
  view.n_vertices = in.count("n_vertices");
  view.n_border_vertices = in.count("n_border_vertices");
  view.n_seed_vertices = in.count("n_seed_vertices");
  view.n_triangles = in.count("n_triangles");
  view.n_posts = in.count("n_posts");
  view.bytes = in.count("bytes");
  for (const json& row : in.array("rows")) {
    const bool four_counts = row.is_array() && row.size() == 4 &&
                             std::all_of(row.begin(), row.end(), [](const json& v) { return v.is_number_unsigned(); });
    if (!four_counts) return refuse(where + ": a row is not [y, x_first, x_last, coverage]");
    const auto y = row[0].get<std::uint64_t>(), first = row[1].get<std::uint64_t>(), last = row[2].get<std::uint64_t>(),
               coverage = row[3].get<std::uint64_t>();
    if (y >= TileId::count_y(level) || last >= TileId::count_x(level) || first > last || coverage > 2) {
      return refuse(fmt::format("{}: row [{}, {}, {}, {}] is outside the level", where, y, first, last, coverage));
    }
    view.rows.push_back({static_cast<std::uint32_t>(y), static_cast<std::uint32_t>(first),
                         static_cast<std::uint32_t>(last), static_cast<int>(coverage)});
  }
  if (!in.fault().empty()) return refuse(in.fault());
  if (view.level != level) return refuse(fmt::format("{}: says it is level {}", where, view.level));
  return view;
}

void find_row_faults(const ManifestView& m, const LevelView& level, std::vector<std::string>& faults) {
  std::uint64_t tiles = 0, by_coverage[3] = {0, 0, 0};
  for (std::size_t k = 0; k < level.rows.size(); ++k) {
    const StoredRun& run = level.rows[k];
    const std::uint64_t n = run.x_last - run.x_first + 1;
    tiles += n;
    by_coverage[run.coverage] += n;
    if (k == 0) continue;
    const StoredRun& before = level.rows[k - 1];
    const bool sorted = before.y < run.y || (before.y == run.y && before.x_last < run.x_first);
    if (!sorted) {
      faults.push_back(
          fmt::format("level {}: rows are not sorted or overlap at y {}, x {}", level.level, run.y, run.x_first));
    } else if (before.y == run.y && before.x_last + 1 == run.x_first && before.coverage == run.coverage) {
      faults.push_back(fmt::format("level {}: the run at y {}, x {} is not maximal", level.level, run.y, run.x_first));
    }
  }
  const auto count = [&](const char* name, std::uint64_t claimed, std::uint64_t found) {
    if (claimed != found) {
      faults.push_back(fmt::format("level {}: {} is {}, rows hold {}", level.level, name, claimed, found));
    }
  };
  count("n_tiles", level.n_tiles, tiles);
  count("n_filler", level.n_filler, by_coverage[0]);
  count("n_partial", level.n_partial, by_coverage[1]);
  count("n_real", level.n_real, by_coverage[2]);
  if (level.level == 0) {
    for (std::uint32_t x = 0; x < 2; ++x) {
      if (!level.has({0, x, 0})) faults.push_back(fmt::format("root tile 0/{}/0 is not stored", x));
    }
    return;
  }
  std::size_t reported = 0;
  for (const StoredRun& run : level.rows) {
    for (std::uint32_t x = run.x_first; x <= run.x_last && reported < 3; ++x) {
      const TileId id{level.level, x, run.y};
      if (!m.has(id.parent())) {
        faults.push_back(fmt::format("tile {} is stored, its parent {} is not", id.text(), id.parent().text()));
        ++reported;
      }
      for (int c = 0; c < 4; ++c) {
        const TileId sibling = id.parent().child(c);
        if (level.has(sibling)) continue;
        faults.push_back(fmt::format("tile {} is stored, its sibling {} is not", id.text(), sibling.text()));
        ++reported;
      }
    }
  }
}

bool is_power_of_two(double value) {
  int exponent = 0;
  return value > 0 && std::frexp(value, &exponent) == 0.5;
}

}  // namespace

bool LevelView::has(const TileId& id) const {
  const auto it = std::upper_bound(rows.begin(), rows.end(), id, [](const TileId& t, const StoredRun& run) {
    return t.y != run.y ? t.y < run.y : t.x < run.x_first;
  });
  if (it == rows.begin()) return false;
  const StoredRun& run = *(it - 1);
  return run.y == id.y && id.x <= run.x_last;
}

std::uint64_t ManifestView::n_tiles() const {
  std::uint64_t n = 0;
  for (const auto& level : levels) {
    for (const auto& run : level.rows) n += run.x_last - run.x_first + 1;
  }
  return n;
}

Outcome<ManifestView> read_manifest(BlobView bytes) {
  const json root = json::parse(bytes.begin(), bytes.end(), nullptr, false);
  if (root.is_discarded() || !root.is_object()) return refuse("meta.json is no JSON object");
  MemberReader in(root, "meta.json");
  ManifestView m;
  m.format = in.string("format");
  m.format_version = in.small("format_version", 0, 1'000'000);
  if (in.fault().empty() && m.format_version != 1) {
    return refuse(fmt::format("meta.json: format version {} is not 1, the one this program knows", m.format_version));
  }
  in.string("generator");
  in.string("content_hash");
  in.string("attribution");
  m.vertical_datum = in.string("vertical_datum");
  m.horizontal_crs = in.string("horizontal_crs");
  m.mode = in.string("mode");
  m.root_count_x = in.small("root_count_x", 1, 1024);
  m.frame.lattice_level = in.small("lattice_level", 0, kDeepestLevel);
  m.frame.height_exponent = in.small("height_exponent", 0, 16);
  m.bottom_level = in.small("bottom_level", 0, kDeepestLevel);
  in.number("base_height_m");
  in.count("falloff_posts");
  m.disagreement_m = in.number("disagreement_m");
  m.bounds_deg = in.numbers<4>("bounds_deg");
  m.spacing_deg = in.numbers<2>("spacing_deg");
  in.string_if_there("source_kind", m.source_kind);
  in.string_if_there("resampling", m.resampling);
  in.array("sources");
  in.object("options");
  MemberReader ellipsoid(in.object("ellipsoid"), "ellipsoid");
  ellipsoid.string("name");
  m.semi_major_m = ellipsoid.number("semi_major_m");
  m.inverse_flattening = ellipsoid.number("inverse_flattening");
  MemberReader posts(in.object("posts"), "posts");
  m.n_source_posts = posts.count("source");
  posts.count("filled");
  posts.count("falloff");
  const json& levels = in.array("levels");
  for (const std::string& fault : {in.fault(), ellipsoid.fault(), posts.fault()}) {
    if (!fault.empty()) return refuse(fault);
  }
  if (levels.size() != static_cast<std::size_t>(m.bottom_level) + 1) {
    return refuse(fmt::format("meta.json: {} levels, but bottom_level is {}", levels.size(), m.bottom_level));
  }
  if (m.bottom_level > m.frame.lattice_level) {
    return refuse(
        fmt::format("meta.json: bottom_level {} is below lattice_level {}", m.bottom_level, m.frame.lattice_level));
  }
  for (int level = 0; level <= m.bottom_level; ++level) {
    auto view = read_level(levels[static_cast<std::size_t>(level)], level);
    if (!view) return refuse("meta.json: " + view.error());
    m.levels.push_back(std::move(*view));
  }
  return m;
}

std::vector<std::string> find_manifest_faults(const ManifestView& m) {
  std::vector<std::string> faults;
  const auto expect = [&](bool good, std::string what) {
    if (!good) faults.push_back(std::move(what));
  };
  expect(m.format == "tind", fmt::format("format is '{}', not 'tind'", m.format));
  expect(m.root_count_x == 2, fmt::format("root_count_x is {}, not 2", m.root_count_x));
  expect(m.horizontal_crs == "EPSG:4326", fmt::format("horizontal_crs is '{}'", m.horizontal_crs));
  expect(m.mode == "standard" || m.mode == "non-standard", fmt::format("mode is '{}'", m.mode));
  expect(m.source_kind == "raster" || m.source_kind == "warped" || m.source_kind == "points",
         fmt::format("source_kind is '{}'", m.source_kind));
  expect(m.source_kind != "warped" || m.resampling == "bilinear" || m.resampling == "cubic",
         fmt::format("the source is warped, but resampling is '{}'", m.resampling));
  expect(m.semi_major_m > 0 && m.inverse_flattening > 0, "the ellipsoid has no size");
  const auto& [west, south, east, north] = m.bounds_deg;
  expect(west <= east && south <= north && south >= -90.0000001 && north <= 90.0000001, "bounds_deg are out of order");
  expect(m.spacing_deg[0] > 0 && m.spacing_deg[1] > 0, "spacing_deg is not positive");
  const double e_bottom = m.levels.back().tolerance_m;
  expect(e_bottom > 0, "E of the bottom level is not positive");
  expect(m.frame.unit_m() <= e_bottom / 256 || m.frame.height_exponent == 16,
         fmt::format("a height unit of {} m is more than 1/256 of E_bottom {} m", m.frame.unit_m(), e_bottom));
  for (const LevelView& level : m.levels) {
    const auto next = static_cast<std::size_t>(level.level) + 1;
    const double finer_m = next < m.levels.size() ? m.levels[next].tolerance_m : 0;
    expect(level.tolerance_m > finer_m,
           fmt::format("level {}: E_L is {} m, not above {} m (it falls from level to level)", level.level,
                       level.tolerance_m, finer_m));
    expect(level.max_error_m <= level.tolerance_m * (1 + 1e-6),
           fmt::format("level {}: max_error_m {} is above E_L {}", level.level, level.max_error_m, level.tolerance_m));
    expect(level.rmse_m <= level.max_error_m * (1 + 1e-6),
           fmt::format("level {}: rmse_m {} is above max_error_m {}", level.level, level.rmse_m, level.max_error_m));
    expect(is_power_of_two(level.height_step_m),
           fmt::format("level {}: height_step_m {} is no power of two", level.level, level.height_step_m));
    expect(level.spacing_m > 0, fmt::format("level {}: spacing_m is not positive", level.level));
    find_row_faults(m, level, faults);
  }
  return faults;
}

}  // namespace tind::client
