// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/vertical_shift.hpp"

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

std::string how_to_get(const std::string& grid) {
  return fmt::format(
      "get it with \"projsync --file {}\" or from the Debian package proj-data, or name a geoid grid of "
      "your own with --geoid FILE",
      grid);
}

PJ_COORD coord_of(const Place& p, double height) {
  return proj_coord(p.y, p.x, height, std::numeric_limits<double>::infinity());
}

}  // namespace

struct VerticalShift::Impl {
  ProjContext context = make_proj_context();
  std::string asked;  ///< As the user wrote it.
  OGRSpatialReference compound;
  double unit_m = 1;            ///< Of the CRS the user named.
  double operation_unit_m = 1;  ///< Of the heights that `operation` takes; it gives metres.
  std::string datum, text;
  ProjObject operation;  ///< Latitude, longitude, height -> latitude, longitude, height; null: nothing to do.

  Result<void> read_datum();
  Result<void> read_geoid(const std::string& path);
};

Result<void> VerticalShift::Impl::read_datum() {
  GdalErrors errors;
  OGRSpatialReference crs;
  if (crs.SetFromUserInput(asked.c_str()) != OGRERR_NONE) {
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
  OGRSpatialReference vertical;
  if (crs.IsCompound()) {
    const OGR_SRSNode* node = crs.GetAttrNode("COMPD_CS");
    char* wkt = nullptr;
    // The last child but an authority is the vertical part.
    for (int i = 0; node != nullptr && i < node->GetChildCount() && wkt == nullptr; ++i) {
      if (std::string(node->GetChild(i)->GetValue()) == "VERT_CS") node->GetChild(i)->exportToWkt(&wkt);
    }
    const bool ok = wkt != nullptr && vertical.importFromWkt(wkt) == OGRERR_NONE;
    CPLFree(wkt);
    if (!ok) return fail(ErrorKind::kInvalidInput, fmt::format("vertical datum \"{}\" cannot be taken apart", asked));
  } else {
    vertical = crs;
  }
  OGRSpatialReference globe;
  globe.importFromEPSG(4326);
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
      "+proj=pipeline +step +proj=axisswap +order=2,1 +step +proj=unitconvert +xy_in=deg +xy_out=rad "
      "+step +proj=vgridshift +grids=\"{}\" +multiplier=1 +step +proj=unitconvert +xy_in=rad +xy_out=deg "
      "+step +proj=axisswap +order=2,1",
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
const std::string& VerticalShift::operation() const { return impl_->text; }

Result<void> VerticalShift::settle(const Place& middle) {
  Impl& s = *impl_;
  if (s.compound.IsEmpty()) return {};
  PJ_CONTEXT* context = s.context.get();
  const ProjObject from = to_proj(context, s.compound), to(proj_create(context, kEllipsoidal));
  const std::unique_ptr<PJ_OPERATION_FACTORY_CONTEXT, ProjDestroy> factory(
      proj_create_operation_factory_context(context, nullptr));
  if (!from || !to || !factory) {
    return fail(ErrorKind::kInvalidInput,
                fmt::format("vertical datum \"{}\": PROJ cannot use it{}", s.asked, proj_detail(context)));
  }
  // Without these two lines PROJ answers with "no change" where it knows no way or lacks a grid.
  proj_operation_factory_context_set_allow_ballpark_transformations(context, factory.get(), 0);
  proj_operation_factory_context_set_grid_availability_use(context, factory.get(), PROJ_GRID_AVAILABILITY_IGNORED);
  proj_operation_factory_context_set_spatial_criterion(context, factory.get(),
                                                       PROJ_SPATIAL_CRITERION_PARTIAL_INTERSECTION);
  proj_operation_factory_context_set_area_of_interest(context, factory.get(), middle.x, middle.y, middle.x, middle.y);
  const std::unique_ptr<PJ_OBJ_LIST, ProjDestroy> list(
      proj_create_operations(context, from.get(), to.get(), factory.get()));
  const int n = list ? proj_list_get_count(list.get()) : 0;
  std::string missing;
  for (int i = 0; i < n; ++i) {
    ProjObject candidate(proj_list_get(context, list.get(), i));
    if (!candidate) continue;
    const int n_grids = proj_coordoperation_get_grid_used_count(context, candidate.get());
    if (!proj_coordoperation_is_instantiable(context, candidate.get())) {
      for (int g = 0; g < n_grids && missing.empty(); ++g) {
        const char* name = nullptr;
        int available = 0;
        proj_coordoperation_get_grid_used(context, candidate.get(), g, &name, nullptr, nullptr, nullptr, nullptr,
                                          nullptr, &available);
        if (available == 0 && name != nullptr) missing = name;
      }
      continue;
    }
    const PJ_COORD moved = proj_trans(candidate.get(), PJ_FWD, coord_of(middle, 0));
    if (!std::isfinite(moved.v[2])) continue;
    proj_errno_reset(candidate.get());
    s.text = proj_text(context, candidate.get());
    s.operation = std::move(candidate);
    return {};
  }
  if (!missing.empty()) {
    return fail(ErrorKind::kInvalidInput, fmt::format("vertical datum \"{}\": the grid {} is not there; {}", s.asked,
                                                      missing, how_to_get(missing)));
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
