// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string_view>
#include <vector>

#include "tests/client/byte_cursor.hpp"

namespace tind::client {

/// Points of a text file, in the file's own units.
struct XyzPoints {
  std::vector<double> x, y, z;
};

/// Reads lines of x, y and z, apart by blanks, commas, semicolons or tabs. A first line that is no numbers names the
/// columns: x, y, z; lon/longitude/easting, lat/latitude/northing, elevation/height/h in any case and order, other
/// columns are skipped. Without one the first three columns are x, y, z. Empty lines and lines that start with # are
/// skipped. A refusal names the line. Numbers are read with a decimal point whatever the locale.
Outcome<XyzPoints> read_xyz(std::string_view text);

}  // namespace tind::client
