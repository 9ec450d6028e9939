// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include <gdal_priv.h>
#include <ogr_spatialref.h>

#include "core/result.hpp"
#include "storage/readers/gdal_raster.hpp"

namespace tind {

/// Grids agree when they do within this share of a post.
inline constexpr double kAlignPosts = 1e-3;

/// Posts at whole or half spacings from 0 (all arc-second grids) get that very position.
double snap_origin(double degrees, double spacing);

/// What was met in the cells read so far: enough to suspect zeros that mark voids.
struct CellSigns {
  bool has_void = false, has_zero = false;
  float lowest_other = std::numeric_limits<float>::infinity();  ///< Of the cells that are neither void nor 0 m.

  void add(const CellSigns& other) {
    has_void = has_void || other.has_void;
    has_zero = has_zero || other.has_zero;
    lowest_other = std::min(lowest_other, other.lowest_other);
  }
};

/// One input of a mosaic: all that its header says, and its cells as metres. Columns and rows are the file's, row 0
/// first in the file. One thread at a time, but for read_window() and close_when_read().
struct RasterFile {
  RasterSource info;
  std::string gdal_name;
  std::string hashed_name;  ///< Of the file whose bytes stand for the input's, by any name that GDAL reads.
  OGRSpatialReference crs;  ///< Horizontal part; degrees without a CRS are EPSG:4326.
  std::array<double, 6> geotransform{};  ///< GDAL's: cell corners, whether cells are areas or points.
  std::string height_kind = "unknown";   ///< "orthometric", "ellipsoidal" or "unknown", as the file says.
  std::string vertical_datum;            ///< Name by the file's CRS; empty: it says nothing.
  std::vector<std::string> notes;
  bool has_nodata = false, has_mask = false, is_float32 = false;
  double nodata = 0;
  double scale = 1, offset = 0;  ///< metres = raw * scale + offset
  CellSigns signs;
  GDALDatasetUniquePtr dataset;  ///< Open only while rows are read.
  bool has_row_blocks = false;   ///< Rows can be read apart at no cost, as those of raw files.

  /// Whether the file's own posts can be the mosaic's: degrees from Greenwich, columns eastwards, rows northwards or
  /// southwards. Then `west`, `south` (first used post), `dx`, `dy` (positive) in degrees, and `own_grid_notes`.
  bool has_own_grid = false;
  double west = 0, south = 0, dx = 0, dy = 0;
  bool north_up = true;
  std::int64_t skip_south = 0;  ///< Rows south of the first used one (beyond the pole).
  std::vector<std::string> own_grid_notes;
  std::string why_not_own;  ///< Why not, for the user.

  /// Heights in metres of the cells [col, col + n_cols) x [row, row + n_rows), row-major in the file's order, NaN for
  /// voids; replaces `heights_m`. `n_implausible` is increased by the cells beyond +-kMaxHeightM, which are voids too;
  /// `has_void`, unless it is null, tells whether there are any.
  /// kIo: truncated or damaged. Opens the file if need be. Thread safe: but for has_row_blocks GDAL reads one window at
  /// a time, what is left to do is done side by side. Precondition: the window lies inside the raster.
  Result<void> read_window(std::int64_t col, std::int64_t row, std::int64_t n_cols, std::int64_t n_rows,
                           std::vector<float>& heights_m, std::uint64_t& n_implausible, bool* has_void = nullptr);
  /// Notes that so many more of the used rows have been read, in any order; closes the file after as many as there are.
  /// Thread safe.
  void close_when_read(std::int64_t n_rows);

 private:
  /// Turns values that are metres as they stand into heights: NaN for voids.
  CellSigns settle_metres(std::vector<float>& heights_m, std::uint64_t& n_implausible) const;

  std::unique_ptr<std::mutex> mutex_ = std::make_unique<std::mutex>();  ///< Of dataset and signs while rows are read.
  std::vector<GDALDatasetUniquePtr> idle_;  ///< More datasets, of other threads, that none of them reads from now.
  std::int64_t n_rows_read_ = 0;            ///< Of the used ones.
};

/// A failure that begins with the file's path.
tl::unexpected<Error> bad_raster(const RasterFile& file, const std::string& what);

/// Opens one input and reads all of its header. Its sha256 is the caller's to set; a name stands there until then.
/// `vertical_unit_m`: metres per unit when neither the options nor the file say it. kInvalidInput names the file, what
/// is wrong and what to try.
Result<RasterFile> inspect_raster(const std::string& path, const RasterOptions& options, double vertical_unit_m);

}  // namespace tind
