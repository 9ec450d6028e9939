// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <bitset>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.hpp"

namespace tind {

/// Point classes (ASPRS: 2 is ground, 9 water) that are wanted. Files without classes are read whole.
using ClassFilter = std::bitset<256>;

/// "2", "2,9" or "all". kInvalidInput names the word that is none.
Result<ClassFilter> parse_class_filter(const std::string& text);

/// What the user may say about point files; what is absent comes from the files.
struct PointOptions {
  ClassFilter classes = ClassFilter().set(2);  ///< LAS only.
  std::string source_crs;                      ///< As "EPSG:2949"; replaces the files' own. Empty: the files' own.
  std::optional<double> metres_per_unit;       ///< Of z, e.g. 0.3048; replaces the files' own.
  std::string
      vertical_datum;  ///< What the heights are (storage/readers/vertical_shift.hpp); empty: the files' own word.
  std::string geoid;   ///< Path of a grid of geoid heights that PROJ reads (.gtx, .tif).
  std::optional<double> spacing_m;  ///< Replaces the spacing that follows from the points' density.
  std::uint64_t memory_bytes = std::uint64_t{256}
                               << 20;  ///< For points on their way; the result does not depend on it.
};

/// One input, as the manifest lists it.
struct PointFile {
  std::string path;            ///< As given (any GDAL name, /vsizip/... too).
  std::string name;            ///< File name without folders.
  std::string sha256;          ///< Of the file's bytes, lower-case hex.
  std::string crs;             ///< Name, with its code where there is one.
  std::uint64_t n_points = 0;  ///< In the file.
  std::uint64_t n_used = 0;    ///< Of those, of a wanted class, not withheld, finite, on the globe.
};

/// A point on the globe.
struct GeoPoint {
  double lon_deg = 0;  ///< >= west_deg of the source: runs past 180 when the data crosses it.
  double lat_deg = 0;
  float height_m = 0;
};

/// One or more files of points (LAS 1.0-1.4, or x, y, z as text), placed on the globe. Files are kept in a canonical
/// order that does not depend on the order of the arguments; a file given twice is used once. One thread at a time.
/// docs/decisions/0008-points.md states the rules.
class PointSource {
 public:
  /// True for names that are read as points: .las, .laz, .xyz, .csv, .txt (capitals do not matter).
  static bool is_point_file(const std::string& path);

  /// Reads all files once. kInvalidInput, kUnsupported and kIo name the file, what is wrong and what to try.
  static Result<PointSource> open(const std::vector<std::string>& paths, const PointOptions& options);
  PointSource(PointSource&&) noexcept;
  PointSource& operator=(PointSource&&) noexcept;
  ~PointSource();

  double west_deg = 0, south_deg = 0, east_deg = 0,
         north_deg = 0;  ///< Of the used points; -180 <= west < 180, east > 180 where they cross 180.
  double spacing_m = 0;  ///< D: sqrt(occupied area / used points), or the user's.
  double lon_spacing_deg = 0, lat_spacing_deg = 0;  ///< D in degrees at the middle latitude.
  std::uint64_t n_used = 0;
  std::vector<PointFile> files;
  std::string height_kind = "unknown";  ///< "orthometric", "ellipsoidal" or "unknown": of the points as they are read.
  std::string vertical_datum;           ///< Name: what the user or the first file says, else "unknown".
  std::string vertical_operation;       ///< PROJ's, that made the heights ellipsoidal; empty: none.
  std::vector<std::string> notes;       ///< Lines for the user: assumptions made.

  /// Hands out all used points, in any number of batches, files in their order and points in the file's. Stops at the
  /// sink's first failure and returns it. kIo: a read failed, or a file is not what it was at open(). kInvalidInput: a
  /// geoid grid does not reach a point.
  Result<void> read(const std::function<Result<void>(std::span<const GeoPoint>)>& sink) const;

 private:
  struct Impl;
  explicit PointSource(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace tind
