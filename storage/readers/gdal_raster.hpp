// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// What the user may say about the sources; what is absent comes from the files.
struct RasterOptions {
  std::optional<double> nodata;           ///< Value that marks a void, in the file's own units; replaces the file's.
  std::optional<double> metres_per_unit;  ///< Vertical unit, e.g. 0.3048; default: the file's unit, else 1.
};

/// One input of a mosaic, as the manifest lists it, and where its posts lie in the mosaic's grid.
struct RasterSource {
  std::string path;    ///< As given (any GDAL name, /vsizip/... too; a .zip path is opened through /vsizip/).
  std::string name;    ///< File name without folders.
  std::string sha256;  ///< Of the file's bytes, lower-case hex.
  std::int64_t n_cols = 0, n_rows = 0;  ///< Of the file.
  /// The posts used: n_used_rows x n_used_cols from (grid_row, grid_col) of the mosaic on; columns modulo the mosaic's
  /// n_cols when it wraps. Fewer than the file's when it repeats columns or has rows beyond a pole.
  std::int64_t grid_row = 0, grid_col = 0, n_used_rows = 0, n_used_cols = 0;
};

/// One or more geographic rasters on one common grid of posts (a post is a cell's centre). Sources are kept in a
/// canonical order that does not depend on the order of the arguments. One thread at a time.
class RasterMosaic {
 public:
  /// Opens and checks all inputs: readable, a band of real numbers, not rotated, geographic CRS (no CRS with plausible
  /// degrees is taken as EPSG:4326 and noted in `notes`), same spacing and aligned to the first within 1e-3 of a post.
  /// kInvalidInput names the file, what is wrong and what to try.
  static Result<RasterMosaic> open(const std::vector<std::string>& paths, const RasterOptions& options);
  RasterMosaic(RasterMosaic&&) noexcept;
  RasterMosaic& operator=(RasterMosaic&&) noexcept;
  ~RasterMosaic();

  double west_deg = 0, south_deg = 0;  ///< Post (row 0 = southernmost, column 0 = westernmost); -180 <= west < 180.
  double lon_spacing_deg = 0, lat_spacing_deg = 0;
  std::int64_t n_cols = 0, n_rows = 0;  ///< Of the union's bounding grid.
  bool wraps = false;                   ///< The columns close around the globe (repeated columns are dropped).
  std::vector<RasterSource> sources;
  std::string vertical_datum;      ///< What the first file says the heights are, else "unknown".
  std::vector<std::string> notes;  ///< Lines for the user: assumptions made.

  /// Heights in metres of rows [first_row, first_row + n) of the used posts of source `s`, row-major, southernmost row
  /// first; NaN where the source has a void. `n_implausible` is increased by the posts beyond +-kMaxHeightM, which are
  /// voids too. kIo when the file cannot be read (truncated, damaged). Cheapest when rows are read in ascending order.
  Result<void> read_rows(std::size_t s, std::int64_t first_row, std::int64_t n, std::vector<float>& heights_m,
                         std::uint64_t& n_implausible) const;

 private:
  struct Impl;
  explicit RasterMosaic(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// No solid body that tind could meet has relief beyond this (Mars: -8 to 21 km); what lies beyond is an undeclared
/// void marker such as 32767 or -32768.
inline constexpr double kMaxHeightM = 30000.0;

}  // namespace tind
