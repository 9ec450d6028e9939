// SPDX-License-Identifier: GPL-3.0-or-later
// Coordinate systems and transforms: only the client's source_* files include this.
#pragma once

#include <ogr_srs_api.h>

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "tests/client/byte_cursor.hpp"
#include "tests/client/las_points.hpp"

namespace tind::client {

/// A coordinate system in traditional axis order (longitude or easting first). Shared and not changed after it was
/// made.
class Crs {
 public:
  Crs() = default;
  /// Anything that GDAL understands: "EPSG:n", WKT, PROJ.
  static Outcome<Crs> from_text(const std::string& text);
  /// Takes a copy of a handle that somebody else owns; empty for null.
  static Crs copy_of(OGRSpatialReferenceH handle);
  /// What GDAL's GeoTIFF driver makes of a key directory.
  static Outcome<Crs> from_geo_keys(const GeoKeys& keys);

  bool empty() const { return handle_ == nullptr; }
  OGRSpatialReferenceH get() const { return handle_.get(); }
  std::string name() const;
  /// Longitude and latitude in degrees from Greenwich.
  bool is_plain_geographic() const;
  bool is_geographic() const;
  /// Metres in one unit of a projected system's axes; 1 for a geographic one.
  double linear_unit_m() const;
  /// Metres in one unit of the vertical part of a compound system, or of a vertical system.
  std::optional<double> vertical_unit_m() const;
  /// Without its vertical part.
  Crs horizontal() const;

 private:
  struct Release {
    void operator()(void* handle) const { OSRRelease(handle); }
  };
  explicit Crs(OGRSpatialReferenceH owned) : handle_(owned, Release()) {}
  std::shared_ptr<void> handle_;
};

/// PROJ's exact transform between two systems, point by point. Not thread safe.
class Transform {
 public:
  static Outcome<Transform> make(const Crs& from, const Crs& to);
  /// Transforms in place; z may be null. A point that cannot be transformed becomes NaN.
  void apply(std::vector<double>& x, std::vector<double>& y, std::vector<double>* z = nullptr) const;

 private:
  struct Destroy {
    void operator()(void* handle) const { OCTDestroyCoordinateTransformation(handle); }
  };
  std::unique_ptr<void, Destroy> handle_;
};

/// Turns orthometric heights into ellipsoidal ones: h = H + N.
class GeoidShift {
 public:
  /// `vertical_datum`: the heights' own system, "EPSG:5773" or a compound one, for which PROJ needs its grid; a
  /// geographic one of three dimensions says that the heights are ellipsoidal already. Where PROJ has no way from a
  /// compound system's datum to WGS 84, heights become those above the datum's own ellipsoid.
  static Outcome<GeoidShift> from_datum(const std::string& vertical_datum);
  /// `path`: a grid of N in metres that PROJ reads (.gtx, .tif); a bare name is looked for in PROJ's folders, too.
  static Outcome<GeoidShift> from_grid(const std::string& path);
  /// N in metres at each position; refuses, naming the position, where the grid has none.
  Outcome<std::vector<double>> undulation_m(const std::vector<double>& lon_deg,
                                            const std::vector<double>& lat_deg) const;

 private:
  std::shared_ptr<void> handle_;  ///< Null: nothing to add.
  std::string what_;
};

}  // namespace tind::client
