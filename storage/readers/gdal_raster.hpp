// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// What the user may say about the sources; what is absent comes from the files.
struct RasterOptions {
  std::optional<double> nodata;        ///< Value that marks a void, in the file's own units.
  std::optional<double> metres_per_unit;  ///< Vertical unit, e.g. 0.3048; default: the band's unit, else 1.
};

/// One input of a mosaic, as the manifest lists it.
struct RasterSource {
  std::string path;    ///< As given (any GDAL name, /vsizip/... too; a .zip path is opened through /vsizip/).
  std::string name;    ///< File name without folders.
  std::string sha256;  ///< Of the file's bytes, lower-case hex.
  std::int64_t n_cols = 0, n_rows = 0;
};

/// One or more geographic rasters on one common grid of posts (a post is a cell's centre). Sources are kept in a canonical
/// order that does not depend on the order of the arguments.
class RasterMosaic {
 public:
  /// Opens and checks all inputs: readable, one band used, north-up or south-up but not rotated, geographic CRS (no CRS with plausible
  /// degrees is taken as EPSG:4326 and noted in `notes`), same spacing and aligned to the first within 1e-3 of a post. kInvalidInput names the file, what is wrong and what to try.
  static Result<RasterMosaic> open(const std::vector<std::string>& paths, const RasterOptions& options);
  RasterMosaic(RasterMosaic&&) noexcept;
  RasterMosaic& operator=(RasterMosaic&&) noexcept;
  ~RasterMosaic();

  double west_deg = 0, south_deg = 0;            ///< Post (row 0 = southernmost, column 0 = westernmost).
  double lon_spacing_deg = 0, lat_spacing_deg = 0;
  std::int64_t n_cols = 0, n_rows = 0;           ///< Of the union's bounding grid.
  bool wraps = false;                            ///< The columns close around the globe (a repeated last column is dropped).
  std::vector<RasterSource> sources;
  std::string vertical_datum;                    ///< What the file says the heights are, else "unknown".
  std::vector<std::string> notes;                ///< Lines for the user: assumptions made.

  struct Impl;
  const Impl& impl() const { return *impl_; }

 private:
  explicit RasterMosaic(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
