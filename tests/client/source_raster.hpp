// SPDX-License-Identifier: GPL-3.0-or-later
// One raster as the client reads it: only the client's source_* files include this.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "tests/client/source_crs.hpp"
#include "tests/client/source_posts.hpp"

namespace tind::client {

/// Cells of a window, row-major from its north-west (the file's own order): metres, NaN where void or outside.
struct CellWindow {
  std::int64_t column0 = 0, row0 = 0, n_columns = 0, n_rows = 0;
  std::vector<double> heights_m;

  double at(std::int64_t column, std::int64_t row) const {
    const std::int64_t c = column - column0, r = row - row0;
    if (c < 0 || r < 0 || c >= n_columns || r >= n_rows) return kVoid;
    return heights_m[static_cast<std::size_t>(r * n_columns + c)];
  }
  static constexpr double kVoid = std::numeric_limits<double>::quiet_NaN();
};

/// Metres in one unit of the vertical datum that the user names, if any.
std::optional<double> datum_unit_m(const SourceOptions& options);

/// An open raster: band 1, its grid, its coordinate system, and how its values become metres.
class SourceRaster {
 public:
  /// Opens what GDAL opens; a .zip is looked into.
  static Outcome<SourceRaster> open(const std::string& path, const SourceOptions& options);

  const std::string& name() const { return name_; }
  std::int64_t n_columns() const { return n_columns_; }
  std::int64_t n_rows() const { return n_rows_; }
  /// GDAL's affine transform: x = t[0] + column * t[1] + row * t[2], y = t[3] + column * t[4] + row * t[5].
  const std::array<double, 6>& transform() const { return transform_; }
  const Crs& crs() const { return crs_; }
  /// Degrees from Greenwich along parallels and meridians, columns eastward: its cells' centres are posts as they are.
  bool is_plain_grid() const { return is_plain_grid_; }
  /// Reads the part of the window that is inside the raster; `window`'s numbers say which, on return only that part.
  Outcome<void> read(CellWindow& window) const;

 private:
  struct Close {
    void operator()(void* dataset) const;
  };
  std::unique_ptr<void, Close> dataset_;
  void* band_ = nullptr;
  void* mask_ = nullptr;  ///< Null: no mask band of its own.
  std::string name_;
  std::int64_t n_columns_ = 0, n_rows_ = 0;
  std::array<double, 6> transform_{};
  Crs crs_;
  bool is_plain_grid_ = false, is_float_ = false, has_nodata_ = false;
  double nodata_ = 0, scale_ = 1, offset_ = 0, unit_m_ = 1;
};

}  // namespace tind::client
