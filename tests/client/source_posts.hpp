// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "tests/client/byte_cursor.hpp"
#include "tests/client/tile_id.hpp"

namespace tind::client {

/// What the user may say about the sources; what is absent comes from the files.
struct SourceOptions {
  std::optional<double> nodata;
  std::optional<double> metres_per_unit;
  std::string source_crs;  ///< Empty: the files' own.
  /// Classes of points to keep, LAS only; nullopt: all.
  std::optional<std::vector<int>> classes = std::vector<int>{2};
  std::string vertical_datum;  ///< The heights' own system; they become ellipsoidal. At most one of the two is set.
  std::string geoid;           ///< A grid of geoid heights to add.
};

/// What the manifest claims about the grid of posts. Reading takes it for where posts are, the checks ask if it is
/// right.
struct GridClaim {
  LatticeFrame frame;  ///< For points: kept ones are told apart on it.
  std::array<double, 2> spacing_deg{0,
                                    0};  ///< Of warped posts; zeros: there is no claim, only plain grids can be read.
  bool cubic = false;                    ///< Warped values are cubic, not bilinear.
};

/// Beyond it lies no height of any known body, but undeclared markers of voids do (docs/decisions/0002). Metres.
inline constexpr double kHighest = 30'000;

enum class SourceKind { kRaster, kWarped, kPoints };
/// "raster", "warped", "points": as the manifest's source_kind.
const char* name_of(SourceKind kind);

/// Where irregular posts are: cells of a regular grid, row-major from the south-west. Posts of cell k are those from
/// first[k] to first[k + 1].
struct PointIndex {
  double west_deg = 0, south_deg = 0, cell_deg = 1;
  std::int64_t n_rows = 0, n_cols = 0;
  std::vector<std::uint32_t> first;
};

/// How many source cells fit into a degree where they are densest.
struct NativeScale {
  double cells_per_degree = 0;
  double lon_deg = 0, lat_deg = 0;
};

/// The posts that the promise is about, made anew from the source's files. Heights in metres.
///
/// kRaster and kWarped: a grid. Row 0 is the southernmost, column 0 the westernmost; row-major; NaN where there is no
/// post. kPoints: `heights_m` holds the kept points in the order of `index`, each at its own place.
struct SourcePosts {
  SourceKind kind = SourceKind::kRaster;
  double west_deg = 0, south_deg = 0;  ///< Post (0, 0).
  double lon_spacing_deg = 0, lat_spacing_deg = 0;
  std::int64_t n_rows = 0, n_cols = 0;
  std::vector<float> heights_m;
  std::vector<double> longitudes_deg, latitudes_deg;  ///< kPoints only.
  PointIndex index;                                   ///< kPoints only.
  /// Where several sources (or both ends of a grid that closes around the globe, or all of a pole) hold different
  /// values: index -> the values beside the one in heights_m.
  std::unordered_map<std::int64_t, std::vector<float>> other_values;
  /// Posts that are one only by the last bits of a transform: whether the pyramid has them is nobody's promise.
  std::unordered_set<std::int64_t> either;
  double disagreement_m = 0;            ///< Largest distance of two values of one post.
  bool rounded = false;                 ///< A value in metres was not a float; heights_m is off by up to half an ulp.
  std::uint64_t n_posts = 0;            ///< Posts with a height, those in `either` not counted.
  std::array<NativeScale, 2> native{};  ///< kWarped: of the sources, eastward and northward.
  std::vector<std::string> names, notes;

  double longitude_of(std::int64_t at) const {
    return kind == SourceKind::kPoints ? longitudes_deg[static_cast<std::size_t>(at)]
                                       : west_deg + static_cast<double>(at % n_cols) * lon_spacing_deg;
  }
  double latitude_of(std::int64_t at) const {
    return kind == SourceKind::kPoints ? latitudes_deg[static_cast<std::size_t>(at)]
                                       : south_deg + static_cast<double>(at / n_cols) * lat_spacing_deg;
  }
  bool has(std::int64_t at) const {
    return heights_m[static_cast<std::size_t>(at)] == heights_m[static_cast<std::size_t>(at)];
  }
  bool is_uncertain(std::int64_t at) const { return !either.empty() && either.contains(at); }

  /// Makes room for the grid's n_rows x n_cols posts; refuses more than 2^31.
  Outcome<void> allocate();
  /// Adds one value to a post; keeps every different value.
  void add_value(std::int64_t at, double metres);
};

/// Reads the posts of one or more sources: rasters that GDAL opens (a .zip is looked into; band 1), or files of points
/// (.las; .xyz, .csv, .txt). Unit, scale, offset, nodata and coordinate system come from the files unless `options` say
/// otherwise. Rasters that share one grid of degrees are taken as they are; all others are warped to `claim`.
Outcome<SourcePosts> read_source_posts(const std::vector<std::string>& paths, const SourceOptions& options,
                                       const GridClaim& claim = {});

/// The longitude right behind the widest stretch of the globe without any of `lon_deg`, in [-180, 180): where data that
/// may cross longitude 180 begins. `gap_deg`: how wide that stretch is, to a tenth of a degree.
double first_longitude(const std::vector<double>& lon_deg, double* gap_deg);

}  // namespace tind::client
