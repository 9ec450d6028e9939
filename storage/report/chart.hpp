// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "storage/report/svg.hpp"

namespace tind {

/// One line of a chart: a value per level; nullopt where there is none.
struct ChartSeries {
  std::string name;
  std::string_view colour;
  std::string_view dashes = {};
  bool markers = true;
  std::vector<std::optional<double>> values;
};

/// Values per level as lines, the levels evenly spread.
struct Chart {
  std::string title;
  std::string unit;         ///< Beside the vertical axis.
  bool logarithmic = true;  ///< Else from 0 to 1; values at or below 0 are left out of a logarithmic chart.
  std::vector<std::string> level_names, level_notes;  ///< Two rows of labels below; same size as the values.
  std::string level_title;                            ///< Below them.
  std::vector<ChartSeries> series;
};

/// Height that draw_chart needs for `chart` when the part between the axes is `plot_height` high.
double chart_height(const Chart& chart, double plot_height);

/// Draws with the upper left corner of everything at `corner`.
void draw_chart(Svg& svg, const Chart& chart, SvgPoint corner, double width, double plot_height);

/// A number with at most 3 digits: 0.03, 1.5, 64, 1.2k, 19k, 2.9M.
std::string short_number(double value);

}  // namespace tind
