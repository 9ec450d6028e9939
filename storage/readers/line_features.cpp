// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/line_features.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include <fmt/format.h>
#include <ogr_geometry.h>
#include <ogr_spatialref.h>

#include "storage/readers/gdal_errors.hpp"
#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/line_dataset.hpp"
#include "storage/readers/sha256.hpp"

namespace tind {
namespace {

constexpr double kNoHeight = std::numeric_limits<double>::quiet_NaN();
/// Segments are halved this often at most; more means that the CRS breaks there.
constexpr int kMaxHalvings = 16;
/// Arcs become chords of this many degrees: a bend of 4e-5 of the radius.
constexpr double kArcStepDeg = 1;
/// Longitudes count modulo 360, but beyond this they are no degrees.
constexpr double kMaxLongitudeDeg = 720;

struct Xyz {
  double x, y, z;
};

/// From a layer's coordinates to longitude and latitude on WGS 84.
class ToGlobe {
 public:
  /// `crs` may be null: degrees.
  static Result<ToGlobe> make(const OGRSpatialReference* crs, const std::string& name) {
    ToGlobe out;
    if (crs == nullptr) return out;
    out.has_crs_ = true;
    if (!crs->IsGeographic() && !crs->IsProjected()) {
      return fail(
          ErrorKind::kInvalidInput,
          fmt::format("{}: its CRS '{}' has no relation to the globe; give it a geographic or projected one, for "
                      "example with ogr2ogr -a_srs EPSG:n",
                      name, crs->GetName() == nullptr ? "" : crs->GetName()));
    }
    std::unique_ptr<OGRSpatialReference> flat(crs->Clone());
    out.has_vertical_ = flat->IsCompound() != 0;
    if (out.has_vertical_) {
      out.metres_per_unit_ = flat->GetTargetLinearUnits("VERT_CS", static_cast<const char**>(nullptr));
      flat->StripVertical();
    } else if (flat->GetAxesCount() == 3) {
      flat->DemoteTo2D(nullptr);
    }
    out.in_feet_ = flat->IsProjected() && std::abs(flat->GetLinearUnits() - 1) > 1e-9;
    OGRSpatialReference globe;
    globe.importFromEPSG(4326);
    globe.SetAxisMappingStrategy(OAMS_TRADITIONAL_GIS_ORDER);
    if (flat->IsSame(&globe)) return out;
    const GdalErrors errors;
    out.transformation_.reset(OGRCreateCoordinateTransformation(flat.get(), &globe));
    if (!out.transformation_) {
      return fail(ErrorKind::kUnsupported,
                  fmt::format("{}: PROJ knows no way from its CRS '{}' to longitude and latitude{}", name,
                              crs->GetName() == nullptr ? "" : crs->GetName(), errors.detail()));
    }
    return out;
  }

  bool has_crs() const { return has_crs_; }
  bool is_straight() const { return !transformation_; }
  /// Metres per unit of Z by the CRS.
  double metres_per_unit() const { return metres_per_unit_; }
  /// Whether Z could be thought to be in the plane's unit, which is not metres.
  bool has_doubtful_unit() const { return in_feet_ && !has_vertical_; }

  /// In place; what has no place on the globe becomes NaN.
  void transform(std::size_t n, double* x, double* y) const {
    if (transformation_) {
      std::vector<int> done(n, 0);
      const GdalErrors errors;
      transformation_->Transform(static_cast<int>(n), x, y, nullptr, nullptr, done.data());
      for (std::size_t i = 0; i < n; ++i) {
        if (done[i] == 0) x[i] = y[i] = kNoHeight;
      }
    }
    for (std::size_t i = 0; i < n; ++i) {
      const bool on_globe = std::isfinite(x[i]) && std::abs(x[i]) <= kMaxLongitudeDeg && std::abs(y[i]) <= 90 + 1e-9;
      if (!on_globe) x[i] = y[i] = std::numeric_limits<double>::quiet_NaN();
    }
  }

 private:
  struct Destroy {
    void operator()(OGRCoordinateTransformation* t) const { OGRCoordinateTransformation::DestroyCT(t); }
  };
  std::unique_ptr<OGRCoordinateTransformation, Destroy> transformation_;
  bool has_crs_ = false, has_vertical_ = false, in_feet_ = false;
  double metres_per_unit_ = 1;
};

/// Takes features apart into lines on the lattice.
class LineCollector {
 public:
  LineCollector(const LineFrame& frame, const ToGlobe& to_globe, double metres_per_unit, LineFile& file)
      : frame_(frame), to_globe_(to_globe), metres_per_unit_(metres_per_unit), file_(file) {}

  Result<void> add_feature(std::int64_t id, const OGRGeometry* geometry) {
    feature_ = id;
    sha_.update(&id, sizeof id);
    if (geometry == nullptr || geometry->IsEmpty()) {
      note("features without a geometry were left out");
      return {};
    }
    return add(*geometry);
  }

  void note(const std::string& what, std::int64_t count = 1) {
    findings_.add(what, fmt::format("feature {}", feature_), count);
  }

  void set_feature(std::int64_t id) { feature_ = id; }

  void finish() {
    file_.n_points = n_points_;
    file_.sha256 = sha_.finish_hex();
    // Shapefiles of type PolyLineZ often carry zeros for want of heights.
    if (has_heights_ && !has_height_but_zero_) {
      for (SourceLine& line : file_.lines) {
        for (SourceVertex& v : line.vertices) v.height_m = kNoHeight;
      }
      file_.notes.push_back(fmt::format("{}: all heights are 0: taken as lines without heights", file_.name));
    }
    file_.has_heights = has_height_but_zero_;
    if (has_height_but_zero_ && to_globe_.has_doubtful_unit() && !frame_.metres_per_unit) {
      file_.notes.push_back(
          fmt::format("{}: its CRS is not in metres and says nothing about heights: taken as metres", file_.name));
    }
    for (const std::string& line : findings_.lines()) file_.notes.push_back(fmt::format("{}: {}", file_.name, line));
  }

 private:
  Result<void> add(const OGRGeometry& geometry) {
    if (geometry.hasCurveGeometry(0)) {
      const std::unique_ptr<OGRGeometry> chords(geometry.getLinearGeometry(kArcStepDeg));
      if (!chords || chords->hasCurveGeometry(0)) {
        note("features with curves that cannot be turned into chords were left out");
        return {};
      }
      return add(*chords);
    }
    const OGRwkbGeometryType type = wkbFlatten(geometry.getGeometryType());
    if (type == wkbPoint) {
      ++n_points_;
      return {};
    }
    if (OGR_GT_IsSubClassOf(type, wkbLineString)) return add_line(*geometry.toLineString(), std::nullopt);
    if (OGR_GT_IsSubClassOf(type, wkbPolygon)) return add_polygon(*geometry.toPolygon());
    if (OGR_GT_IsSubClassOf(type, wkbGeometryCollection)) {
      for (const OGRGeometry* part : *geometry.toGeometryCollection()) {
        if (auto added = add(*part); !added) return added;
      }
      return {};
    }
    if (OGR_GT_IsSubClassOf(type, wkbPolyhedralSurface)) {
      const OGRPolyhedralSurface& surface = *geometry.toPolyhedralSurface();
      for (int i = 0; i < surface.getNumGeometries(); ++i) {
        if (auto added = add(*surface.getGeometryRef(i)); !added) return added;
      }
      return {};
    }
    note(fmt::format("geometries of type {} were left out", OGRGeometryTypeToName(type)));
    return {};
  }

  Result<void> add_polygon(const OGRPolygon& polygon) {
    const std::size_t index = n_polygons_++;
    for (const OGRLinearRing* ring : polygon) {
      if (auto added = add_line(*ring, index); !added) return added;
    }
    return {};
  }

  Result<void> add_line(const OGRSimpleCurve& curve, std::optional<std::size_t> polygon) {
    const auto n = static_cast<std::size_t>(curve.getNumPoints());
    if (n == 0) {
      note("empty lines were left out");
      return {};
    }
    n_vertices_ += static_cast<std::int64_t>(n);
    if (n_vertices_ > kMaxLineVertices) return too_many();
    std::vector<Xyz> source(n);
    std::vector<double> lon(n), lat(n);
    std::int64_t n_bad_heights = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const int at = static_cast<int>(i);
      source[i] = {curve.getX(at), curve.getY(at), curve.Is3D() ? curve.getZ(at) : kNoHeight};
      sha_.update(&source[i], sizeof source[i]);
      lon[i] = source[i].x;
      lat[i] = source[i].y;
      if (!to_globe_.has_crs() && std::isfinite(lon[i]) && std::isfinite(lat[i]) &&
          (std::abs(lon[i]) > 360 || std::abs(lat[i]) > 90)) {
        return fail(ErrorKind::kInvalidInput,
                    fmt::format("{}: has no CRS, and feature {} has a vertex at ({}, {}), which are no degrees; give "
                                "it a CRS, for example with ogr2ogr -a_srs EPSG:n",
                                file_.name, feature_, lon[i], lat[i]));
      }
      if (curve.Is3D()) n_bad_heights += take_height(source[i].z) ? 0 : 1;
    }
    if (n_bad_heights > 0)
      note(fmt::format("heights that are no numbers or beyond +-{} m were left out", kMaxHeightM), n_bad_heights);
    to_globe_.transform(n, lon.data(), lat.data());
    std::int64_t n_bad = 0;
    for (std::size_t i = 0; i < n;) {
      if (std::isnan(lon[i])) {
        ++n_bad;
        ++i;
        continue;
      }
      std::size_t end = i;
      while (end < n && !std::isnan(lon[end])) ++end;
      if (auto added = add_run(source, lon, lat, i, end, polygon); !added) return added;
      i = end;
    }
    if (n_bad > 0) note("vertices that are no numbers or not on the globe were left out, the lines cut there", n_bad);
    return {};
  }

  /// Makes z metres, NaN when it is none; false: when it should have been.
  bool take_height(double& z) {
    z *= metres_per_unit_;
    if (!(std::abs(z) <= kMaxHeightM)) {
      z = kNoHeight;
      return false;
    }
    has_heights_ = true;
    has_height_but_zero_ = has_height_but_zero_ || z != 0;
    return true;
  }

  Result<void> add_run(const std::vector<Xyz>& source, const std::vector<double>& lon, const std::vector<double>& lat,
                       std::size_t begin, std::size_t end, std::optional<std::size_t> polygon) {
    SourceLine line{feature_, polygon, {}};
    for (std::size_t i = begin; i < end; ++i) {
      SourceVertex v = place(lon[i], lat[i], source[i].z, line.vertices.empty() ? nullptr : &line.vertices.back());
      if (i > begin && !to_globe_.is_straight()) {
        const SourceVertex before = line.vertices.back();
        bend(source[i - 1], source[i], before, v, kMaxHalvings, line.vertices);
        // Halving may have found the longer way around the globe.
        v = place(lon[i], lat[i], source[i].z, &line.vertices.back());
      }
      line.vertices.push_back(v);
      if (n_vertices_ > kMaxLineVertices) return too_many();
    }
    file_.lines.push_back(std::move(line));
    return {};
  }

  /// On the lattice, by whole turns near the vertex before.
  SourceVertex place(double lon, double lat, double height_m, const SourceVertex* before) const {
    const double step = frame_.lattice.step_deg(), width = static_cast<double>(frame_.lattice.width());
    SourceVertex v{(lon + 180) / step, (std::clamp(lat, -90.0, 90.0) + 90) / step, height_m};
    if (before != nullptr) v.x += width * std::floor((before->x - v.x) / width + 0.5);
    if (frame_.shift_m && !std::isnan(height_m)) v.height_m += frame_.shift_m(lon, lat);
    return v;
  }

  /// Adds the vertices between two that keep a segment which is straight in its own CRS within kMaxBendPosts.
  void bend(const Xyz& a, const Xyz& b, const SourceVertex& from, const SourceVertex& to, int n_halvings,
            std::vector<SourceVertex>& out) {
    if (n_halvings == 0 || n_vertices_ > kMaxLineVertices) return;
    std::array<double, 3> lon{}, lat{};
    for (std::size_t i = 0; i < 3; ++i) {
      const double t = static_cast<double>(i + 1) / 4;
      lon[i] = (1 - t) * a.x + t * b.x;
      lat[i] = (1 - t) * a.y + t * b.y;
    }
    to_globe_.transform(3, lon.data(), lat.data());
    SourceVertex middle;
    double bend_posts = 0;
    for (std::size_t i = 0; i < 3; ++i) {
      if (std::isnan(lon[i])) return;
      const double t = static_cast<double>(i + 1) / 4;
      const double z = i == 1 ? (1 - t) * a.z + t * b.z : kNoHeight;
      const SourceVertex v = place(lon[i], lat[i], z, &from);
      bend_posts = std::max({bend_posts, std::abs(v.x - (1 - t) * from.x - t * to.x) / frame_.dx,
                             std::abs(v.y - (1 - t) * from.y - t * to.y) / frame_.dy});
      if (i == 1) middle = v;
    }
    if (bend_posts <= kMaxBendPosts) return;
    ++n_vertices_;
    const Xyz m{(a.x + b.x) / 2, (a.y + b.y) / 2, (a.z + b.z) / 2};
    bend(a, m, from, middle, n_halvings - 1, out);
    out.push_back(middle);
    bend(m, b, middle, to, n_halvings - 1, out);
  }

  tl::unexpected<Error> too_many() const {
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format("{}: more than {} vertices; give a part of it or a simpler version", file_.name, kMaxLineVertices));
  }

  const LineFrame& frame_;
  const ToGlobe& to_globe_;
  double metres_per_unit_;
  LineFile& file_;
  FindingList findings_;
  Sha256 sha_;
  std::int64_t feature_ = 0, n_vertices_ = 0, n_points_ = 0;
  std::size_t n_polygons_ = 0;
  bool has_heights_ = false, has_height_but_zero_ = false;
};

}  // namespace

void FindingList::add(const std::string& what, const std::string& example, std::int64_t count) {
  auto at = std::find_if(findings_.begin(), findings_.end(), [&](const Finding& f) { return f.what == what; });
  if (at == findings_.end()) at = findings_.insert(at, Finding{what, 0, {}, false});
  at->count += count;
  if (std::find(at->examples.begin(), at->examples.end(), example) != at->examples.end()) return;
  if (at->examples.size() < kMaxExamples)
    at->examples.push_back(example);
  else
    at->more = true;
}

std::vector<std::string> FindingList::lines() const {
  std::vector<std::string> out;
  for (const Finding& f : findings_)
    out.push_back(fmt::format("{} {}: {}{}", f.count, f.what, fmt::join(f.examples, ", "), f.more ? ", ..." : ""));
  return out;
}

Result<LineFile> read_line_file(const std::string& spec, const LineFrame& frame) {
  auto opened = open_line_dataset(spec);
  if (!opened) return tl::unexpected(opened.error());
  LineFile file;
  file.name = opened->name;
  OGRLayer& layer = *opened->layer;
  const OGRSpatialReference* crs = layer.GetSpatialRef();
  auto to_globe = ToGlobe::make(crs != nullptr && !crs->IsEmpty() ? crs : nullptr, file.name);
  if (!to_globe) return tl::unexpected(to_globe.error());

  LineCollector collector(frame, *to_globe, frame.metres_per_unit.value_or(to_globe->metres_per_unit()), file);
  layer.ResetReading();
  while (true) {
    const GdalErrors errors;
    const OGRFeatureUniquePtr feature(layer.GetNextFeature());
    if (!feature) {
      if (!errors.failed()) break;
      return fail(ErrorKind::kIo,
                  fmt::format("{}: reading broke off after {} features: the file is truncated or damaged{}", file.name,
                              file.n_features, errors.detail()));
    }
    ++file.n_features;
    collector.set_feature(feature->GetFID());
    if (errors.failed()) collector.note(fmt::format("features are damaged{}", errors.detail()));
    if (auto added = collector.add_feature(feature->GetFID(), feature->GetGeometryRef()); !added)
      return tl::unexpected(added.error());
  }
  collector.finish();
  if (file.n_points > 0) {
    file.notes.push_back(
        fmt::format("{}: {} points were left out: break lines are lines and polygons", file.name, file.n_points));
  }
  if (file.lines.empty()) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{}: holds no lines or polygons to use ({} features, {} points){}", file.name,
                            file.n_features, file.n_points, file.notes.empty() ? "" : "; " + file.notes.front()));
  }
  if (!to_globe->has_crs())
    file.notes.push_back(fmt::format("{}: has no CRS: taken as longitude and latitude on WGS 84", file.name));
  return file;
}

}  // namespace tind
