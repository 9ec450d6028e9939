// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/vertical_shift.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include <cpl_conv.h>
#include <cpl_vsi.h>
#include <fmt/format.h>

#include "storage/readers/gdal_errors.hpp"
#include "storage/readers/proj_handles.hpp"

namespace tind {
namespace {

constexpr char kEllipsoidal[] = "EPSG:4979";
/// Missing grids that a message names.
constexpr std::size_t kMostNamed = 6;

/// "the grid A is not there; ..." with what to do.
std::string missing_text(const std::vector<std::string>& grids) {
  const std::string what = grids.size() == 1 ? fmt::format("the grid {} is not there", grids[0])
                                             : fmt::format("none of the grids {} is there", fmt::join(grids, ", "));
  const bool egm96 = std::find(grids.begin(), grids.end(), "us_nga_egm96_15.tif") != grids.end();
  return fmt::format("{}; get it with \"projsync --file {}\"{}, or name a geoid grid of your own with --geoid FILE",
                     what, grids[0], egm96 ? " or with the Debian package proj-data" : "");
}

PJ_COORD coord_of(const Place& p, double height) {
  return proj_coord(p.x, p.y, height, std::numeric_limits<double>::infinity());
}

}  // namespace

struct VerticalShift::Impl {
  ProjContext context = make_proj_context();
  std::string asked;             ///< As the user wrote it.
  OGRSpatialReference globe;     ///< Horizontal part: the user's, or WGS 84.
  OGRSpatialReference compound;  ///< `globe` with the user's heights; empty: a grid does the work, or nothing is to do.
  bool has_own_ellipsoid = false;
  std::string ellipsoid = "WGS 84";
  double unit_m = 1;            ///< Of the CRS the user named.
  double operation_unit_m = 1;  ///< Of the heights that `operation` takes; it gives metres.
  std::string datum, text;
  ProjObject operation;  ///< Longitude, latitude in degrees, height; null: nothing to do.

  Result<void> read_datum();
  Result<void> read_geoid(const std::string& path);
  bool find_way(const ProjObject& to, const Place& middle, std::vector<std::string>& missing);
};

Result<void> VerticalShift::Impl::read_datum() {
  GdalErrors errors;
  OGRSpatialReference crs;
  bool known = crs.SetFromUserInput(asked.c_str()) == OGRERR_NONE;
  if (!known) {  // names such as "EGM96 height" are PROJ's affair
    const ProjObject named(proj_create(context.get(), asked.c_str()));
    const char* wkt = named ? proj_as_wkt(context.get(), named.get(), PJ_WKT2_2019, nullptr) : nullptr;
    known = wkt != nullptr && crs.importFromWkt(wkt) == OGRERR_NONE;
  }
  if (!known) {
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format("vertical datum \"{}\": PROJ knows no such CRS; name a vertical or compound one, for example "
                    "EPSG:5773 (EGM96 height)",
                    asked));
  }
  const char* name = crs.GetAttrValue("VERT_CS");
  if (!crs.IsVertical() && !crs.IsCompound() && crs.IsGeographic() && crs.GetAxesCount() == 3) {
    datum = fmt::format("ellipsoid of {}", crs.GetName());
    return {};
  }
  if (name == nullptr) {
    return fail(
        ErrorKind::kInvalidInput,
        fmt::format("vertical datum \"{}\": CRS \"{}\" says nothing of heights; name a vertical or compound one, "
                    "for example EPSG:5773 (EGM96 height)",
                    asked, crs.GetName() != nullptr ? crs.GetName() : "?"));
  }
  if (const char* axis = crs.GetAttrValue("VERT_CS|AXIS", 1); axis != nullptr && EQUAL(axis, "DOWN")) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("vertical datum \"{}\" counts depths; name the one that counts heights", asked));
  }
  datum = name;
  operation_unit_m = unit_m = crs.GetTargetLinearUnits("VERT_CS", nullptr);
  // The user's own horizontal datum opens ways that WGS 84 has not (NAD83(2011) to GEOID18). The posts' positions are
  // taken in it as they are: a metre aside, N is the same.
  OGRSpatialReference vertical;
  globe.importFromEPSG(4326);
  if (crs.IsCompound()) {
    const OGR_SRSNode* node = crs.GetAttrNode("COMPD_CS");
    char* wkt = nullptr;
    for (int i = 0; node != nullptr && i < node->GetChildCount() && wkt == nullptr; ++i) {
      if (EQUAL(node->GetChild(i)->GetValue(), "VERT_CS")) node->GetChild(i)->exportToWkt(&wkt);
    }
    const std::unique_ptr<OGRSpatialReference> geographic(crs.CloneGeogCS());
    const bool ok = wkt != nullptr && vertical.importFromWkt(wkt) == OGRERR_NONE && geographic != nullptr;
    CPLFree(wkt);
    if (!ok) return fail(ErrorKind::kInvalidInput, fmt::format("vertical datum \"{}\" cannot be taken apart", asked));
    globe = *geographic;
    has_own_ellipsoid = true;
  } else {
    vertical = crs;
  }
  if (compound.SetCompoundCS(datum.c_str(), &globe, &vertical) != OGRERR_NONE) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("vertical datum \"{}\" cannot be joined with WGS 84{}", asked, errors.detail()));
  }
  return {};
}

Result<void> VerticalShift::Impl::read_geoid(const std::string& path) {
  VSIStatBufL stat;
  const bool is_bare = path.find('/') == std::string::npos, exists = VSIStatL(path.c_str(), &stat) == 0;
  const auto no_such_file = [&] {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("geoid grid {}: no such file; grids come with the Debian package proj-data "
                            "(/usr/share/proj/egm96_15.gtx) or with projsync",
                            path));
  };
  if ((!exists && !is_bare) || path.find('"') != std::string::npos) return no_such_file();
  // PROJ looks a bare name up in its own folders, not in the current one.
  const std::string place = is_bare && exists ? "./" + path : path;
  text = fmt::format(
      "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=vgridshift +grids=\"{}\" "
      "+multiplier=1 "
      "+step +proj=unitconvert +xy_in=rad +xy_out=deg",
      place);
  operation.reset(proj_create(context.get(), text.c_str()));
  if (!operation && !exists) return no_such_file();
  if (!operation) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("geoid grid {}: PROJ cannot read it{}; it reads .gtx and GeoTIFF grids of N in metres",
                            path, proj_detail(context.get())));
  }
  return {};
}

VerticalShift::VerticalShift(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
VerticalShift::VerticalShift(VerticalShift&&) noexcept = default;
VerticalShift& VerticalShift::operator=(VerticalShift&&) noexcept = default;
VerticalShift::~VerticalShift() = default;

Result<VerticalShift> VerticalShift::create(const std::string& vertical_datum, const std::string& geoid) {
  auto impl = std::make_unique<Impl>();
  impl->asked = vertical_datum;
  if (!vertical_datum.empty()) {
    if (auto ok = impl->read_datum(); !ok) return tl::unexpected(ok.error());
  }
  if (!geoid.empty()) {
    if (auto ok = impl->read_geoid(geoid); !ok) return tl::unexpected(ok.error());
    if (impl->datum.empty()) impl->datum = "heights above " + geoid.substr(geoid.find_last_of('/') + 1);
    impl->compound.Clear();
    impl->operation_unit_m = 1;
  }
  return VerticalShift(std::move(impl));
}

double VerticalShift::unit_m() const { return impl_->unit_m; }
const std::string& VerticalShift::datum() const { return impl_->datum; }
const std::string& VerticalShift::ellipsoid() const { return impl_->ellipsoid; }
const std::string& VerticalShift::operation() const { return impl_->text; }

/// Takes PROJ's best operation to `to` that works at `middle`; false: there is none. Grids that others lack are added
/// to `missing`.
bool VerticalShift::Impl::find_way(const ProjObject& to, const Place& middle, std::vector<std::string>& missing) {
  PJ_CONTEXT* c = context.get();
  const ProjObject from = to_proj(c, compound);
  const std::unique_ptr<PJ_OPERATION_FACTORY_CONTEXT, ProjDestroy> factory(
      proj_create_operation_factory_context(c, nullptr));
  if (!from || !to || !factory) return false;
  // Without these two lines PROJ answers with "no change" where it knows no way or lacks a grid.
  proj_operation_factory_context_set_allow_ballpark_transformations(c, factory.get(), 0);
  proj_operation_factory_context_set_grid_availability_use(c, factory.get(), PROJ_GRID_AVAILABILITY_IGNORED);
  proj_operation_factory_context_set_spatial_criterion(c, factory.get(), PROJ_SPATIAL_CRITERION_PARTIAL_INTERSECTION);
  proj_operation_factory_context_set_area_of_interest(c, factory.get(), middle.x, middle.y, middle.x, middle.y);
  const std::unique_ptr<PJ_OBJ_LIST, ProjDestroy> list(proj_create_operations(c, from.get(), to.get(), factory.get()));
  const int n = list ? proj_list_get_count(list.get()) : 0;
  for (int i = 0; i < n; ++i) {
    ProjObject candidate(proj_list_get(c, list.get(), i));
    if (!candidate) continue;
    if (!proj_coordoperation_is_instantiable(c, candidate.get())) {
      const int n_grids = proj_coordoperation_get_grid_used_count(c, candidate.get());
      for (int g = 0; g < n_grids; ++g) {
        const char* name = nullptr;
        int available = 0;
        proj_coordoperation_get_grid_used(c, candidate.get(), g, &name, nullptr, nullptr, nullptr, nullptr, nullptr,
                                          &available);
        if (available != 0 || name == nullptr || std::find(missing.begin(), missing.end(), name) != missing.end())
          continue;
        missing.emplace_back(name);
      }
      continue;
    }
    candidate.reset(proj_normalize_for_visualization(c, candidate.get()));
    if (!candidate) continue;
    const PJ_COORD moved = proj_trans(candidate.get(), PJ_FWD, coord_of(middle, 0));
    proj_errno_reset(candidate.get());
    if (!std::isfinite(moved.v[2])) continue;
    text = proj_text(c, candidate.get());
    operation = std::move(candidate);
    return true;
  }
  return false;
}

Result<void> VerticalShift::settle(const Place& middle) {
  Impl& s = *impl_;
  if (s.compound.IsEmpty()) return {};
  std::vector<std::string> missing, missing_own;
  if (s.find_way(ProjObject(proj_create(s.context.get(), kEllipsoidal)), middle, missing)) return {};
  if (s.has_own_ellipsoid) {
    // National geoids lead to the national datum (NAD83(2011)), a metre or so from WGS 84.
    OGRSpatialReference own = s.globe;
    own.PromoteTo3D(nullptr);
    if (s.find_way(to_proj(s.context.get(), own), middle, missing_own)) {
      s.ellipsoid = s.globe.GetName();
      return {};
    }
  }
  missing_own.insert(missing_own.end(), missing.begin(), missing.end());
  if (!missing_own.empty()) {
    missing_own.resize(std::min(missing_own.size(), kMostNamed));
    return fail(ErrorKind::kInvalidInput, fmt::format("vertical datum \"{}\": {}", s.asked, missing_text(missing_own)));
  }
  return fail(ErrorKind::kInvalidInput,
              fmt::format("vertical datum \"{}\" ({}): PROJ knows no way from it to ellipsoidal heights at longitude "
                          "{:.4f}, latitude {:.4f}; name a geoid grid with --geoid FILE",
                          s.asked, s.datum, middle.x, middle.y));
}

Result<void> VerticalShift::apply(std::span<const Place> places, float* heights_m) const {
  const Impl& s = *impl_;
  if (!s.operation) return {};
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (std::isnan(heights_m[i])) continue;
    const double height = static_cast<double>(heights_m[i]) / s.operation_unit_m;
    const PJ_COORD moved = proj_trans(s.operation.get(), PJ_FWD, coord_of(places[i], height));
    if (!std::isfinite(moved.v[2])) {
      const std::string detail = proj_detail(s.context.get());
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("{}: no geoid height at longitude {:.6f}, latitude {:.6f}{}; the data reach beyond the "
                              "grid: use one that covers them, or cut the input with gdal_translate -projwin",
                              s.datum, places[i].x, places[i].y, detail));
    }
    heights_m[i] = static_cast<float>(moved.v[2]);
  }
  return {};
}

}  // namespace tind
