// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include "core/result.hpp"
#include "storage/report/pyramid_report.hpp"

namespace tind {

/// The report as an SVG file: charts of errors, points and (where measured) streams per level, and hill-shades of the
/// source and of the TIN beside each other (where `report.window` is there). kIo when GDAL cannot make the PNG inside.
Result<std::string> draw_report(const PyramidReport& report);

}  // namespace tind
