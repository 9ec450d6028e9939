// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/picture.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "storage/readers/png_image.hpp"
#include "storage/report/chart.hpp"
#include "storage/report/hillshade.hpp"
#include "storage/report/svg.hpp"

namespace tind {
namespace {

constexpr double kWidth = 1320, kMargin = 36, kGap = 34, kHeadHeight = 92, kPlotHeight = 300;
constexpr double kMostImageHeight = 520;
constexpr std::string_view kInk = "#1f2a33", kGrey = "#66727a";
// One colour a surface, told apart also by readers who do not see red and green alike (Okabe and Ito 2008).
constexpr std::string_view kTin = "#0072b2", kPlain = "#56b4e9", kSpacing = "#8a949b", kPoints = "#d55e00";
constexpr std::string_view kDots = "2 4", kDashes = "7 4";

using Value = std::function<std::optional<double>(const LevelReport&)>;
using Surface = const SurfaceFigures*;

Surface get(const std::optional<SurfaceFigures>& figures) { return figures ? &*figures : nullptr; }

std::optional<double> rmse(Surface s) {
  return s && s->errors.n_posts ? std::optional(s->errors.rmse_m()) : std::nullopt;
}
std::optional<double> max_error(Surface s) {
  return s && s->errors.n_posts ? std::optional(s->errors.max_m) : std::nullopt;
}
std::optional<double> points(Surface s) { return s ? std::optional(static_cast<double>(s->n_points)) : std::nullopt; }
std::optional<double> quality(Surface s) {
  return s && s->streams && s->streams->reference_length > 0 ? std::optional(s->streams->quality()) : std::nullopt;
}

/// Adds a line unless no level has a value for it.
void add(Chart& chart, const PyramidReport& report, ChartSeries series, const Value& value) {
  bool any = false;
  for (const LevelReport& row : report.levels) {
    series.values.push_back(value(row));
    any = any || series.values.back();
  }
  if (any) chart.series.push_back(std::move(series));
}

Chart empty_chart(const PyramidReport& report, std::string title, std::string unit, bool logarithmic) {
  Chart chart{std::move(title), std::move(unit), logarithmic, {}, {}, "level (below: E_L, m)", {}};
  for (const LevelReport& row : report.levels) {
    chart.level_names.push_back(fmt::format("{}", row.level));
    chart.level_notes.push_back(short_number(row.tolerance_m));
  }
  return chart;
}

std::vector<Chart> charts_of(const PyramidReport& report) {
  const auto tin = [](const LevelReport& r) { return &r.tin; };
  const auto plain = [](const LevelReport& r) { return get(r.unconstrained); };
  const auto spacing = [](const LevelReport& r) { return get(r.same_spacing); };
  const auto same = [](const LevelReport& r) { return get(r.same_points); };
  const char* tin_name = report.has_lines ? "TIN with lines" : "TIN";

  Chart errors = empty_chart(report, "Error at the source's posts", "metres", true);
  add(errors, report, {"E_L (allowed)", kInk, kDashes, false, {}},
      [](const LevelReport& r) { return std::optional(r.tolerance_m); });
  add(errors, report, {"TIN: E_max", kTin, kDots, true, {}}, [&](const LevelReport& r) { return max_error(tin(r)); });
  add(errors, report, {"TIN: RMSE", kTin, {}, true, {}}, [&](const LevelReport& r) { return rmse(tin(r)); });
  add(errors, report, {"bilinear (points): E_max", kPoints, kDots, true, {}},
      [&](const LevelReport& r) { return max_error(same(r)); });
  add(errors, report, {"bilinear (points): RMSE", kPoints, {}, true, {}},
      [&](const LevelReport& r) { return rmse(same(r)); });
  add(errors, report, {"bilinear (spacing): RMSE", kSpacing, {}, true, {}},
      [&](const LevelReport& r) { return rmse(spacing(r)); });

  Chart counts = empty_chart(report, "Points in the data", "points", true);
  add(counts, report, {tin_name, kTin, {}, true, {}}, [&](const LevelReport& r) { return points(tin(r)); });
  add(counts, report, {"TIN without lines", kPlain, kDashes, true, {}},
      [&](const LevelReport& r) { return points(plain(r)); });
  add(counts, report, {"raster (spacing)", kSpacing, {}, true, {}},
      [&](const LevelReport& r) { return points(spacing(r)); });

  Chart streams = empty_chart(report, "Streams kept", "quality", false);
  add(streams, report, {tin_name, kTin, {}, true, {}}, [&](const LevelReport& r) { return quality(tin(r)); });
  add(streams, report, {"TIN without lines", kPlain, kDashes, true, {}},
      [&](const LevelReport& r) { return quality(plain(r)); });
  add(streams, report, {"bilinear (points)", kPoints, {}, true, {}},
      [&](const LevelReport& r) { return quality(same(r)); });
  add(streams, report, {"bilinear (spacing)", kSpacing, {}, true, {}},
      [&](const LevelReport& r) { return quality(spacing(r)); });
  streams.title += fmt::format(" (quality, {:g}-cell buffer)", report.buffer_cells);

  std::vector<Chart> charts = {std::move(errors), std::move(counts)};
  if (!streams.series.empty()) charts.push_back(std::move(streams));
  return charts;
}

/// 1, 2 or 5 times a power of ten, at most `most`.
double round_length(double most) {
  const double power = std::pow(10, std::floor(std::log10(most)));
  return most >= 5 * power ? 5 * power : most >= 2 * power ? 2 * power : power;
}

/// Where the two hill-shades lie.
struct ImageSize {
  double width = 0, height = 0, pixels_per_m = 0;
};

ImageSize image_size(const PictureWindow& w) {
  const double width_m = static_cast<double>(w.n_cols) * w.east_m, height_m = static_cast<double>(w.n_rows) * w.north_m;
  const double pixels_per_m = std::min((kWidth - 2 * kMargin - kGap) / 2 / width_m, kMostImageHeight / height_m);
  return {width_m * pixels_per_m, height_m * pixels_per_m, pixels_per_m};
}

Result<void> draw_shade(Svg& svg, const PictureWindow& w, const std::vector<float>& heights_m, double exaggeration,
                        SvgPoint corner, const ImageSize& size, const std::string& caption) {
  const ShadedGrid grid{w.n_rows, w.n_cols, w.east_m, w.north_m, heights_m};
  const auto png = encode_png(hillshade(grid, exaggeration), static_cast<int>(w.n_rows), static_cast<int>(w.n_cols));
  if (!png) return tl::unexpected(png.error());
  svg.text({corner.x, corner.y + 16}, caption, {15, kInk, SvgAnchor::kStart, true});
  svg.image({corner.x, corner.y + 28}, size.width, size.height, *png);
  svg.rectangle({corner.x, corner.y + 28}, size.width, size.height, "none", {"#b5bdc3", 1});
  return {};
}

void draw_scale_bar(Svg& svg, SvgPoint left, const ImageSize& size) {
  const double metres = round_length(size.width / size.pixels_per_m / 4), length = metres * size.pixels_per_m;
  svg.rectangle({left.x, left.y - 5}, length, 5, kInk);
  svg.text({left.x + length + 8, left.y + 1},
           metres >= 1000 ? fmt::format("{:g} km", metres / 1000) : fmt::format("{:g} m", metres), {12, kInk});
}

}  // namespace

Result<std::string> draw_report(const PyramidReport& report) {
  const std::vector<Chart> charts = charts_of(report);
  double charts_height = 0;
  for (const Chart& chart : charts) charts_height = std::max(charts_height, chart_height(chart, kPlotHeight));
  double height = kHeadHeight + charts_height + kMargin;
  ImageSize size;
  if (report.window) {
    size = image_size(*report.window);
    height += kGap + 28 + size.height + 40;
  }

  Svg svg(kWidth, height);
  svg.rectangle({0, 0}, kWidth, height, "#ffffff");
  const LevelReport& deepest = report.levels.back();
  svg.text({kMargin, 44},
           fmt::format("{}: TIN pyramid, E = {} m at level {}", report.name, short_number(deepest.tolerance_m),
                       deepest.level),
           {24, kInk, SvgAnchor::kStart, true});
  std::string sources = report.source_names.empty() ? "" : report.source_names.front();
  if (report.source_names.size() > 1) sources += fmt::format(" and {} more", report.source_names.size() - 1);
  svg.text(
      {kMargin, 68},
      fmt::format(
          "source: {}, {} {}, {:.0f} km2; at level {} the TIN has {} points ({:.2f} % of the posts, {:.1f} per km2)",
          sources, short_number(static_cast<double>(report.n_posts)),
          report.source_kind == "points" ? "points" : "posts", report.area_km2, deepest.level,
          short_number(static_cast<double>(deepest.tin.n_points)), report.percent_of_posts(deepest.tin),
          report.points_per_km2(deepest.tin)),
      {13, kGrey});

  const auto n = static_cast<double>(charts.size());
  const double chart_width = (kWidth - 2 * kMargin - (n - 1) * kGap) / n;
  // Plots stand on one line, whatever the length of their legends.
  for (std::size_t k = 0; k < charts.size(); ++k) {
    const double plot = kPlotHeight + charts_height - chart_height(charts[k], kPlotHeight);
    draw_chart(svg, charts[k], {kMargin + static_cast<double>(k) * (chart_width + kGap), kHeadHeight}, chart_width,
               plot);
  }

  if (report.window) {
    const PictureWindow& w = *report.window;
    const double top = kHeadHeight + charts_height + kGap;
    const double exaggeration = visible_exaggeration({w.n_rows, w.n_cols, w.east_m, w.north_m, w.source_m});
    const auto level = std::find_if(report.levels.begin(), report.levels.end(),
                                    [&](const LevelReport& row) { return row.level == w.level; });
    const std::string tin_caption =
        level == report.levels.end()
            ? fmt::format("TIN, level {}", w.level)
            : fmt::format("TIN, level {}: E = {} m, {} points", w.level, short_number(level->tolerance_m),
                          short_number(static_cast<double>(level->tin.n_points)));
    const double right = kMargin + size.width + kGap;
    if (auto drawn =
            draw_shade(svg, w, w.source_m, exaggeration, {kMargin, top}, size, fmt::format("Source: {}", sources));
        !drawn) {
      return tl::unexpected(drawn.error());
    }
    if (auto drawn = draw_shade(svg, w, w.tin_m, exaggeration, {right, top}, size, tin_caption); !drawn) {
      return tl::unexpected(drawn.error());
    }
    draw_scale_bar(svg, {kMargin, top + 28 + size.height + 22}, size);
    std::string note =
        fmt::format("hill-shade of the middle {} x {} posts, light from the north-west", w.n_cols, w.n_rows);
    if (exaggeration > 1) note += fmt::format(", heights x {:.0f}", exaggeration);
    svg.text({right + size.width, top + 28 + size.height + 23}, note, {12, kGrey, SvgAnchor::kEnd});
  }
  return svg.str();
}

}  // namespace tind
