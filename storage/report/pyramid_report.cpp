// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/pyramid_report.hpp"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numbers>
#include <thread>
#include <utility>

#include <fmt/format.h>

#include "storage/builder/output_file.hpp"
#include "storage/builder/progress.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/report/bilinear_raster.hpp"
#include "storage/report/native_posts.hpp"
#include "storage/report/pyramid_file.hpp"
#include "storage/report/source_grid.hpp"
#include "storage/report/stream_quality.hpp"

namespace tind {
namespace {

/// A level with fewer spacings along the data's longer side says nothing about it.
constexpr double kLeastSpacings = 8;
/// The coarsest level with so many points is drawn: its facets can be told apart and look like the terrain.
constexpr std::uint64_t kPicturePoints = 3000;
constexpr std::int64_t kWindowRows = 480, kWindowCols = 640;
constexpr double kReadShare = 0.1;
/// Relative difference of an error from the manifest's that summing in another order, and floats, may make.
constexpr double kSameError = 1e-4;

Result<void> cancelled() { return fail(ErrorKind::kIo, "interrupted"); }

class Measurement {
 public:
  Measurement(const ReportOptions& options, std::FILE* stream) : options_(options), stream_(stream) {
    threads_ =
        options.threads > 0 ? options.threads : static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  }

  Result<PyramidReport> run() {
    auto file = PyramidFile::open(options_.pyramid);
    if (!file) return tl::unexpected(file.error());
    auto build = rebuild_options(file->manifest(), options_.source);
    if (!build) return fail(build.error().kind, options_.pyramid + ": " + build.error().message);
    if (auto chosen = choose_levels(file->manifest()); !chosen) return tl::unexpected(chosen.error());
    std::error_code no_folder;
    const auto folder = std::filesystem::temp_directory_path(no_folder);
    if (no_folder) return fail(ErrorKind::kIo, "no folder for temporary files; set TMPDIR to one");
    scratch_dir_ = folder.string();

    Progress progress(stream_);
    progress.update(0, "reading");
    const auto source = load_source(file->manifest(), build->source, scratch_dir_, threads_,
                                    [&](double fraction) { progress.update(kReadShare * fraction, "reading"); });
    if (!source) return fail(source.error().kind, options_.pyramid + ": " + source.error().message);
    for (const std::string& note : source->source.notes()) progress.note(note);
    describe(*file, *source);
    if (levels_.empty()) choose_default_levels(*file, *source, *build);
    if (const auto pictured = options_.picture_level;
        pictured && std::find(levels_.begin(), levels_.end(), *pictured) == levels_.end()) {
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("level {} is not measured, so it cannot be drawn: add it with --levels", *pictured));
    }

    TemporaryFile temporary((folder / fmt::format("tind-report-{}.tind", ::getpid())).string());
    const auto unconstrained = open_unconstrained(*file, *build, temporary.path(), progress);
    if (!unconstrained) return tl::unexpected(unconstrained.error());
    if (auto done = measure_levels(*file, *source, *build, *unconstrained, progress); !done) {
      return tl::unexpected(done.error());
    }
    progress.update(1, "done");
    progress.finish();
    return std::move(report_);
  }

 private:
  using Unconstrained = std::optional<PyramidFile>;

  bool is_cancelled() const { return options_.cancel && options_.cancel->load(std::memory_order_relaxed); }

  Result<void> choose_levels(const Manifest& manifest) {
    const int bottom = manifest.bottom_level;
    for (const auto& level : {options_.first_level, options_.last_level, options_.picture_level}) {
      if (level && (*level < 0 || *level > bottom)) {
        return fail(ErrorKind::kInvalidInput,
                    fmt::format("{} has levels 0 to {}, not {}", options_.pyramid, bottom, *level));
      }
    }
    if (!options_.first_level && !options_.last_level) return {};
    for (int l = options_.first_level.value_or(0); l <= options_.last_level.value_or(bottom); ++l) levels_.push_back(l);
    if (!levels_.empty()) return {};
    return fail(ErrorKind::kInvalidInput, fmt::format("levels {} to {}: the first must not be deeper than the last",
                                                      *options_.first_level, *options_.last_level));
  }

  void choose_default_levels(const PyramidFile& file, const SourceGrid& source, const BuildOptions& build) {
    const auto longest = static_cast<double>(std::max(source.n_rows, source.n_cols) - 1);
    const int bottom = file.manifest().bottom_level;
    int first = bottom;
    while (first > 0 && posts_per_spacing(file, source, build, first - 1) * kLeastSpacings <= longest) --first;
    for (int l = first; l <= bottom; ++l) levels_.push_back(l);
    if (first > 0) {
      report_.notes.push_back(fmt::format(
          "levels 0 to {} are left out: the data is less than {:.0f} of their spacings long (--levels 0- shows them)",
          first - 1, kLeastSpacings));
    }
  }

  void describe(const PyramidFile& file, const SourceGrid& source) {
    const Manifest& m = file.manifest();
    report_.name = std::filesystem::path(options_.pyramid).stem().string();
    report_.source_kind = m.source_kind;
    for (const SourceInfo& s : m.sources) report_.source_names.push_back(s.name);
    report_.n_posts = source.n_posts;
    report_.n_rows = source.n_rows;
    report_.n_cols = source.n_cols;
    report_.area_km2 = source.area_km2;
    report_.bottom_tolerance_m = m.levels.back().tolerance_m;
    report_.buffer_cells = options_.buffer_cells;
    report_.has_lines = m.lines.streams + m.lines.shores + m.lines.given > 0;
  }

  /// Spacing of a level, in posts of the source.
  static double posts_per_spacing(const PyramidFile& file, const SourceGrid& source, const BuildOptions& build,
                                  int level) {
    const Manifest& m = file.manifest();
    double post_m = m.spacing_deg[0] * m.lattice.ellipsoid.semi_major_m * std::numbers::pi / 180;
    if (build.metres == BuildOptions::Metres::kMidLatitude) {
      post_m *= std::cos((m.bounds_deg[1] + m.bounds_deg[3]) / 2 * std::numbers::pi / 180);
    } else if (build.metres == BuildOptions::Metres::kAuto) {
      post_m = source.source.own_spacing_m().value_or(post_m);
    }
    return m.levels[static_cast<std::size_t>(level)].spacing_m / post_m;
  }

  /// The pyramid of the same source and tolerances without lines; nullopt where there is nothing to compare.
  Result<Unconstrained> open_unconstrained(const PyramidFile& file, const BuildOptions& build, const std::string& path,
                                           Progress& progress) {
    if (options_.unconstrained.empty()) {
      if (!options_.streams) return Unconstrained();
      if (!report_.has_lines) {
        report_.notes.push_back("the pyramid has no lines: there is no unconstrained TIN to compare it with");
        return Unconstrained();
      }
      progress.note("building the unconstrained TIN (--unconstrained FILE.tind takes one that is there)");
      BuildOptions plain = build;
      plain.lines = LineOptions();
      plain.lines.drainage = false;
      plain.output = path;
      plain.force = true;
      plain.threads = threads_;
      plain.cancel = options_.cancel;
      Progress own(stream_);
      if (auto built = build_pyramid(plain, own); !built) return tl::unexpected(built.error());
    }
    auto other = PyramidFile::open(options_.unconstrained.empty() ? path : options_.unconstrained);
    if (!other) return tl::unexpected(other.error());
    const Manifest &a = file.manifest(), &b = other->manifest();
    const auto refuse = [&](const std::string& why) {
      return fail(ErrorKind::kInvalidInput, fmt::format("{}: {} {}; leave --unconstrained out to have one built",
                                                        other->path(), why, file.path()));
    };
    if (a.sources.size() != b.sources.size() ||
        !std::equal(a.sources.begin(), a.sources.end(), b.sources.begin(),
                    [](const SourceInfo& s, const SourceInfo& t) { return s.sha256 == t.sha256; })) {
      return refuse("was not built from the source of");
    }
    if (!std::equal(a.levels.begin(), a.levels.end(), b.levels.begin(), b.levels.end(),
                    [](const LevelInfo& s, const LevelInfo& t) { return s.tolerance_m == t.tolerance_m; })) {
      return refuse("has other tolerances than");
    }
    if (b.lattice.level != a.lattice.level || b.lattice.height_exponent != a.lattice.height_exponent) {
      return refuse("has another lattice than");
    }
    if (b.lines.streams + b.lines.shores + b.lines.given > 0) return refuse("follows lines, too, as");
    return Unconstrained(std::move(*other));
  }

  Result<void> measure_levels(const PyramidFile& file, const SourceGrid& source, const BuildOptions& build,
                              const Unconstrained& unconstrained, Progress& progress) {
    std::optional<StreamQuality> streams;
    if (options_.streams) {
      progress.update(kReadShare, "streams of the source");
      DrainageOptions drainage = drainage_options(file.manifest());
      drainage.cells = options_.drainage_cells.value_or(drainage.cells);
      drainage.growth = options_.drainage_growth.value_or(drainage.growth);
      auto made = StreamQuality::make(source, drainage, levels_, options_.buffer_cells, scratch_dir_);
      if (!made) return tl::unexpected(made.error());
      streams.emplace(std::move(*made));
    }
    // Without streams a picture needs the heights all the same.
    ScratchMap heights_map;
    float* heights_m = streams ? streams->surface_m() : nullptr;
    const HeightField& field = source.field();
    if (!streams && options_.picture) {
      auto map =
          ScratchMap::create(scratch_dir_, static_cast<std::uint64_t>(field.n_rows * field.n_cols) * sizeof(float));
      if (!map) return tl::unexpected(map.error());
      heights_map = std::move(*map);
      heights_m = static_cast<float*>(heights_map.data());
    }
    const auto is_pictured = [&](const LevelReport& row) {
      if (!options_.picture) return false;
      if (options_.picture_level) return *options_.picture_level == row.level;
      return report_.levels.empty() || report_.levels.back().tin.n_points < kPicturePoints;
    };
    std::optional<NativeCells> native;
    if (const RasterMosaic* raster = source.source.raster(); raster && raster->warped) {
      progress.update(kReadShare, "the source's own cells");
      auto cells = NativeCells::load(*raster, field, scratch_dir_);
      if (!cells) return tl::unexpected(cells.error());
      native.emplace(std::move(*cells));
      report_.n_native_left_out = native->n_left_out;
    }
    const double n_surfaces = 1.0 + (unconstrained ? 1 : 0) + (options_.bilinear ? 2 : 0);
    double done = 0;
    const auto tick = [&](const std::string& stage) {
      progress.update(kReadShare + (1 - kReadShare) * done / (n_surfaces * static_cast<double>(levels_.size())), stage);
      done += 1;
      return !is_cancelled();
    };
    for (const int level : levels_) {
      LevelReport row;
      const LevelInfo& info = file.manifest().levels[static_cast<std::size_t>(level)];
      row.level = level;
      row.tolerance_m = info.tolerance_m;
      row.spacing_m = info.spacing_m;
      row.manifest_rmse_m = info.rmse_m;
      row.manifest_max_error_m = info.max_error_m;
      row.manifest_posts = info.n_posts;
      if (streams) row.stream_cells = streams->threshold_cells(level);

      const auto measure_tin = [&](const PyramidFile& tin, VertexCounts& counts,
                                   std::uint64_t& n_missed) -> Result<SurfaceFigures> {
        const auto surface = sample_level(tin, level, field, threads_, heights_m);
        if (!surface) return tl::unexpected(surface.error());
        const auto counted = count_vertices(tin, level, field);
        if (!counted) return tl::unexpected(counted.error());
        counts = *counted;
        n_missed = surface->n_missed;
        return SurfaceFigures{counts.data, surface->errors, std::nullopt, std::nullopt};
      };
      VertexCounts counts;
      if (!tick(fmt::format("level {}: TIN", level))) return cancelled();
      auto tin = measure_tin(file, counts, row.n_missed_posts);
      if (!tin) return tl::unexpected(tin.error());
      row.tin = *tin;
      row.n_void_points = counts.voids;
      row.n_outside_points = counts.outside;
      if (heights_m && is_pictured(row)) take_window(source, level, heights_m);
      if (streams) row.tin.streams = streams->match(level);
      warn_of_differences(row);
      if (native && native->size() > 0) {
        HeightField at_cells = field;
        at_cells.points = native->blocks();
        const auto surface = sample_level(file, level, at_cells, threads_, nullptr);
        if (!surface) return tl::unexpected(surface.error());
        row.native = surface->errors;
      }

      if (unconstrained) {
        if (!tick(fmt::format("level {}: unconstrained TIN", level))) return cancelled();
        std::uint64_t n_missed = 0;
        auto plain = measure_tin(*unconstrained, counts, n_missed);
        if (!plain) return tl::unexpected(plain.error());
        row.unconstrained = *plain;
        if (streams) row.unconstrained->streams = streams->match(level);
      }
      if (options_.bilinear && source.n_rows >= 2 && source.n_cols >= 2) {
        const auto measure_raster = [&](const RasterShape& shape) {
          const BilinearRaster raster(source, shape.n_rows, shape.n_cols);
          SurfaceFigures figures{raster.n_data_nodes(), raster.measure(heights_m), std::nullopt, shape};
          if (streams) figures.streams = streams->match(level);
          return figures;
        };
        const double step = posts_per_spacing(file, source, build, level);
        if (!tick(fmt::format("level {}: bilinear, same spacing", level))) return cancelled();
        row.same_spacing = measure_raster(shape_for_steps(source, step, step));
        if (!tick(fmt::format("level {}: bilinear, same number of points", level))) return cancelled();
        row.same_points = measure_raster(shape_for_points(source, row.tin.n_points));
      }
      report_.levels.push_back(row);
    }
    return {};
  }

  void warn_of_differences(const LevelReport& row) {
    if (row.n_missed_posts > 0) {
      report_.notes.push_back(
          fmt::format("level {}: {} posts lie in no triangle: the file is damaged", row.level, row.n_missed_posts));
    }
    const auto differ = [](double a, double b) { return std::abs(a - b) > kSameError * std::max({a, b, 1e-3}); };
    if (differ(row.tin.errors.rmse_m(), row.manifest_rmse_m) ||
        differ(row.tin.errors.max_m, row.manifest_max_error_m)) {
      report_.notes.push_back(fmt::format(
          "level {}: RMSE {:.4f} m and E_max {:.4f} m over {} posts measured here, {:.4f} and {:.4f} m over {} "
          "by the file's manifest",
          row.level, row.tin.errors.rmse_m(), row.tin.errors.max_m, row.tin.errors.n_posts, row.manifest_rmse_m,
          row.manifest_max_error_m, row.manifest_posts));
    }
    if (row.tin.errors.max_m > row.tolerance_m * (1 + kSameError)) {
      report_.notes.push_back(fmt::format("level {}: E_max {:.4f} m is above E_L = {:.4f} m", row.level,
                                          row.tin.errors.max_m, row.tolerance_m));
    }
  }

  void take_window(const SourceGrid& source, int level, const float* heights_m) {
    const HeightField& field = source.field();
    PictureWindow w;
    w.level = level;
    w.n_rows = std::min(source.n_rows, kWindowRows);
    w.n_cols = std::min(source.n_cols, kWindowCols);
    const std::int64_t row = source.first_row + (source.n_rows - w.n_rows) / 2;
    const std::int64_t col = source.first_col + (source.n_cols - w.n_cols) / 2;
    const Lattice& lattice = field.lattice;
    const double x = field.post_x(col + w.n_cols / 2), y = field.post_y(row + w.n_rows / 2);
    const auto distance_m = [&](double dx, double dy) {
      const auto at = [&](double u, double v) {
        return lattice.geodetic_to_ecef(u * lattice.step_deg() - 180, v * lattice.step_deg() - 90, 0);
      };
      const auto from = at(x - dx / 2, y - dy / 2), to = at(x + dx / 2, y + dy / 2);
      return std::hypot(to[0] - from[0], to[1] - from[1], to[2] - from[2]);
    };
    w.east_m = distance_m(field.dx, 0);
    w.north_m = distance_m(0, field.dy);
    for (std::int64_t r = row; r < row + w.n_rows; ++r) {
      for (std::int64_t c = col; c < col + w.n_cols; ++c) {
        const bool data = is_of_source(field.origin_at(r, c));
        const auto nothing = std::numeric_limits<float>::quiet_NaN();
        w.source_m.push_back(data ? field.heights_m[r * field.n_cols + c] : nothing);
        w.tin_m.push_back(data ? heights_m[r * field.n_cols + c] : nothing);
      }
    }
    report_.window = std::move(w);
  }

  const ReportOptions& options_;
  std::FILE* stream_;
  int threads_;
  std::string scratch_dir_;
  std::vector<int> levels_;
  PyramidReport report_;
};

}  // namespace

double PyramidReport::percent_of_posts(const SurfaceFigures& figures) const {
  return n_posts ? 100.0 * static_cast<double>(figures.n_points) / static_cast<double>(n_posts) : 0;
}

double PyramidReport::points_per_km2(const SurfaceFigures& figures) const {
  return area_km2 > 0 ? static_cast<double>(figures.n_points) / area_km2 : 0;
}

Result<PyramidReport> measure_pyramid(const ReportOptions& options, std::FILE* progress) {
  return Measurement(options, progress).run();
}

}  // namespace tind
