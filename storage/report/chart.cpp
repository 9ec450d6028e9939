// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/report/chart.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include <fmt/format.h>

namespace tind {
namespace {

constexpr double kTitleHeight = 30, kLegendRow = 18, kLabelsHeight = 58, kAxisWidth = 52, kRightMargin = 14;
constexpr std::size_t kLegendColumns = 2;
constexpr std::string_view kGrid = "#e3e6e8", kAxis = "#8a949b", kInk = "#333f48";

/// The vertical axis: a range of values over a range of y.
struct Axis {
  bool logarithmic;
  double low, high;  ///< Values (their logarithms) at the bottom and the top.
  double bottom, top;

  bool shows(double value) const { return !logarithmic || value > 0; }
  double y(double value) const {
    const double at = ((logarithmic ? std::log10(value) : value) - low) / (high - low);
    return bottom + std::clamp(at, 0.0, 1.0) * (top - bottom);
  }
};

Axis axis_of(const Chart& chart, double bottom, double top) {
  if (!chart.logarithmic) return {false, 0, 1, bottom, top};
  double least = std::numeric_limits<double>::infinity(), most = 0;
  for (const ChartSeries& s : chart.series) {
    for (const auto& v : s.values) {
      if (!v || *v <= 0) continue;
      least = std::min(least, *v);
      most = std::max(most, *v);
    }
  }
  if (most <= 0) return {true, 0, 1, bottom, top};
  const double low = std::floor(std::log10(least)), high = std::ceil(std::log10(most) + 1e-9);
  return {true, low, std::max(high, low + 1), bottom, top};
}

void draw_grid(Svg& svg, const Axis& axis, double left, double right) {
  const SvgFont label{11, kInk, SvgAnchor::kEnd};
  const auto line = [&](double value, const std::string& name) {
    svg.line({left, axis.y(value)}, {right, axis.y(value)}, {kGrid, 1});
    svg.text({left - 7, axis.y(value) + 4}, name, label);
  };
  if (axis.logarithmic) {
    for (int power = static_cast<int>(axis.low); power <= static_cast<int>(axis.high); ++power) {
      line(std::pow(10, power), short_number(std::pow(10, power)));
    }
  } else {
    for (int i = 0; i <= 5; ++i) line(i / 5.0, fmt::format("{:.1f}", i / 5.0));
  }
}

void draw_series(Svg& svg, const ChartSeries& series, const Axis& axis, const std::vector<double>& xs) {
  std::vector<SvgPoint> piece;
  const auto flush = [&] {
    if (piece.size() > 1) svg.polyline(piece, {series.colour, 2, series.dashes});
    piece.clear();
  };
  for (std::size_t i = 0; i < series.values.size(); ++i) {
    if (!series.values[i] || !axis.shows(*series.values[i])) {
      flush();
      continue;
    }
    piece.push_back({xs[i], axis.y(*series.values[i])});
  }
  flush();
  for (std::size_t i = 0; series.markers && i < series.values.size(); ++i) {
    if (series.values[i] && axis.shows(*series.values[i])) {
      svg.circle({xs[i], axis.y(*series.values[i])}, 3.2, "#ffffff", {series.colour, 2});
    }
  }
}

double legend_height(const Chart& chart) {
  const std::size_t n_rows = (chart.series.size() + kLegendColumns - 1) / kLegendColumns;
  return static_cast<double>(n_rows) * kLegendRow + 8;
}

}  // namespace

std::string short_number(double value) {
  if (value >= 1e6) return fmt::format("{:.3g}M", value / 1e6);
  if (value >= 1e3) return fmt::format("{:.3g}k", value / 1e3);
  return fmt::format("{:.3g}", value);
}

double chart_height(const Chart& chart, double plot_height) {
  return kTitleHeight + legend_height(chart) + plot_height + kLabelsHeight;
}

void draw_chart(Svg& svg, const Chart& chart, SvgPoint corner, double width, double plot_height) {
  const double left = corner.x + kAxisWidth, right = corner.x + width - kRightMargin;
  const double top = corner.y + kTitleHeight + legend_height(chart), bottom = top + plot_height;
  svg.text({corner.x, corner.y + 16}, chart.title, {15, kInk, SvgAnchor::kStart, true});

  for (std::size_t k = 0; k < chart.series.size(); ++k) {
    const ChartSeries& s = chart.series[k];
    const double x = corner.x + static_cast<double>(k % kLegendColumns) * (width / static_cast<double>(kLegendColumns));
    const std::size_t legend_row = k / kLegendColumns;
    const double y = corner.y + kTitleHeight + 6 + static_cast<double>(legend_row) * kLegendRow;
    svg.line({x, y}, {x + 26, y}, {s.colour, 2, s.dashes});
    if (s.markers) svg.circle({x + 13, y}, 3.2, "#ffffff", {s.colour, 2});
    svg.text({x + 33, y + 4}, s.name, {12, kInk});
  }

  const Axis axis = axis_of(chart, bottom, top);
  draw_grid(svg, axis, left, right);
  svg.text({corner.x + 10, (top + bottom) / 2}, chart.unit, {12, kInk, SvgAnchor::kMiddle, false, -90});
  std::vector<double> xs;
  const auto n = static_cast<double>(chart.level_names.size());
  for (std::size_t i = 0; i < chart.level_names.size(); ++i) {
    xs.push_back(left + (static_cast<double>(i) + 0.5) / n * (right - left));
    svg.line({xs[i], bottom}, {xs[i], bottom + 4}, {kAxis, 1});
    svg.text({xs[i], bottom + 18}, chart.level_names[i], {12, kInk, SvgAnchor::kMiddle, true});
    svg.text({xs[i], bottom + 33}, chart.level_notes[i], {11, "#66727a", SvgAnchor::kMiddle});
  }
  svg.text({(left + right) / 2, bottom + 51}, chart.level_title, {12, kInk, SvgAnchor::kMiddle});
  svg.line({left, top}, {left, bottom}, {kAxis, 1});
  svg.line({left, bottom}, {right, bottom}, {kAxis, 1});
  for (const ChartSeries& s : chart.series) draw_series(svg, s, axis, xs);
}

}  // namespace tind
