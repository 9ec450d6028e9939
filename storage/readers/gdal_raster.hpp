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

/// How heights between a source's cells are made where it must be warped.
enum class Resampling { kBilinear, kCubic };

/// What the user may say about the sources; what is absent comes from the files.
struct RasterOptions {
  std::optional<double> nodata;           ///< Value that marks a void, in the file's own units; replaces the file's.
  std::optional<double> metres_per_unit;  ///< Vertical unit, e.g. 0.3048; default: the file's unit, else 1.
  Resampling resampling = Resampling::kBilinear;
  std::string vertical_datum = {};  ///< CRS of the input's heights by any name that PROJ knows, e.g. "EPSG:5773".
  std::string geoid = {};           ///< Path of a grid of geoid heights that PROJ reads (.gtx, .tif).
  /// False: files are not read whole to hash them, RasterSource::sha256 is their name, and copies of a file under other
  /// names go unnoticed.
  bool hash_files = true;
  /// The hash of a single input may be missing until finish_hashing().
  bool hash_later = false;
};

/// One input of a mosaic, as the manifest lists it, and where its posts lie in the mosaic's grid.
struct RasterSource {
  std::string path;    ///< As given (any GDAL name, /vsizip/... too; a .zip path is opened through /vsizip/).
  std::string name;    ///< File name without folders.
  std::string sha256;  ///< Of the file's bytes, lower-case hex.
  std::int64_t n_cols = 0, n_rows = 0;  ///< Of the file.
  std::string crs;                      ///< Of the file, e.g. "WGS 84 / UTM zone 11N (EPSG:32611)".
  bool crs_is_assumed = false;          ///< The file names no CRS; its degrees are taken as EPSG:4326.
  bool unit_is_assumed = false;         ///< Neither the file nor the user names a vertical unit: metres.
  std::string operation;                ///< PROJ pipeline from EPSG:4326 to the file's CRS; empty: not warped.
  double native_spacing_m = 0;  ///< Mean of the cell's two sides, by the CRS's own unit (degrees: on the equator).
  /// The posts used: n_used_rows x n_used_cols from (grid_row, grid_col) of the mosaic on; columns modulo the mosaic's
  /// n_cols when it wraps (a file that goes around the globe and further has more columns than that). Not warped: the
  /// file's, without rows beyond a pole.
  std::int64_t grid_row = 0, grid_col = 0, n_used_rows = 0, n_used_cols = 0;
};

/// Native cells of one source, by rows of the file: where their centres lie and what they hold.
struct NativePosts {
  std::vector<double> lon_deg, lat_deg;  ///< Not finite: the cell is not on the globe. Longitudes -180..180.
  std::vector<float> heights_m;          ///< NaN: void. In the vertical datum of the mosaic.
};

/// Rows of the used posts of one source.
struct SourceRows {
  std::vector<float> heights_m;  ///< Row-major, NaN: void.
  std::int64_t n_rows = 0, n_cols = 0;
  bool northernmost_first = false;
  bool has_void = true;  ///< False: none is a void.

  /// By their order from the south.
  const float* row(std::int64_t r) const {
    return heights_m.data() + (northernmost_first ? n_rows - 1 - r : r) * n_cols;
  }
};

/// One or more rasters on one common grid of geographic posts. Where all are geographic and lie on one grid the posts
/// are the files' own (a post is a cell's centre); otherwise all are warped (docs/decisions/0005-warped-posts.md).
/// Sources are kept in a canonical order that does not depend on the order of the arguments. One thread at a time.
class RasterMosaic {
 public:
  /// Opens and checks all inputs: readable, a band of real numbers, a CRS of the Earth or degrees (no CRS with
  /// plausible degrees is taken as EPSG:4326 and noted in `notes`). kInvalidInput names the file, what is wrong and
  /// what to try.
  static Result<RasterMosaic> open(const std::vector<std::string>& paths, const RasterOptions& options);
  /// Waits for hashes that are still made; their sources have a name in their place until then. kIo.
  Result<void> finish_hashing();
  RasterMosaic(RasterMosaic&&) noexcept;
  RasterMosaic& operator=(RasterMosaic&&) noexcept;
  ~RasterMosaic();

  double west_deg = 0, south_deg = 0;  ///< Post (row 0 = southernmost, column 0 = westernmost); -180 <= west < 180.
  double lon_spacing_deg = 0, lat_spacing_deg = 0;
  std::int64_t n_cols = 0, n_rows = 0;  ///< Of the union's bounding grid.
  bool wraps = false;                   ///< The columns close around the globe (repeated columns are dropped).
  std::vector<RasterSource> sources;
  bool warped = false;
  std::string resampling = "none";      ///< "none", "bilinear" or "cubic".
  double native_spacing_m = 0;          ///< Of the finest source.
  std::string height_kind = "unknown";  ///< "orthometric", "ellipsoidal" or "unknown": of the posts as they are read.
  std::string vertical_datum;           ///< Name: what the user or the first file says, else "unknown".
  std::string vertical_operation;  ///< PROJ pipeline that made the heights ellipsoidal; empty: they are as in the file.
  std::vector<std::string> notes;  ///< Lines for the user: assumptions made.

  /// Heights in metres of rows [first_row, first_row + n) of the used posts of source `s`, row-major, southernmost row
  /// first; NaN where the source has a void. `n_implausible` is increased by the cells beyond +-kMaxHeightM, which are
  /// voids too. kIo when the file cannot be read (truncated, damaged), kInvalidInput when a geoid grid does not reach
  /// there. Cheapest when rows are read in ascending order; the file is closed once as many rows were read as are used.
  Result<void> read_rows(std::size_t s, std::int64_t first_row, std::int64_t n, std::vector<float>& heights_m,
                         std::uint64_t& n_implausible) const;

  /// The same in the order in which they lie in the file.
  Result<void> read_rows(std::size_t s, std::int64_t first_row, std::int64_t n, SourceRows& rows,
                         std::uint64_t& n_implausible) const;

  /// Whether several threads may call read_rows() at a time.
  bool reads_in_parallel() const;

  /// The same for a window of n_rows x n_cols from (row, col) of the used posts on, in any order of windows; the file
  /// stays open. Precondition: the window lies inside.
  Result<void> read_window(std::size_t s, std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols,
                           std::vector<float>& heights_m, std::uint64_t& n_implausible) const;

  /// Rows [first_row, first_row + n) of the file of source `s` as it is, n x n_cols, the file's first row first.
  /// Failures as read_rows().
  Result<void> read_native_rows(std::size_t s, std::int64_t first_row, std::int64_t n, NativePosts& posts) const;

  /// Lines about data that look wrong, after all rows have been read: zeros beside voids. Reads suspicious files once
  /// more. kIo.
  Result<std::vector<std::string>> suspicions() const;

 private:
  struct Impl;
  explicit RasterMosaic(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

/// No solid body that tind could meet has relief beyond this (Mars: -8 to 21 km); what lies beyond is an undeclared
/// void marker such as 32767 or -32768.
inline constexpr double kMaxHeightM = 30000.0;

}  // namespace tind
