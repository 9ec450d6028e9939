// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/pixel_transform.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include "storage/readers/proj_handles.hpp"

namespace tind {

struct PixelTransform::Impl {
  ProjContext context;
  ProjObject operation;  ///< Latitude, longitude in degrees -> the CRS's own axes.
  std::string text;
  std::array<double, 6> gt{};
  double n_cols = 0, n_rows = 0;
  std::array<std::size_t, 2> axis{0, 1};  ///< CRS axis behind the raster's x and y.
  std::array<double, 2> sign{1, 1};
  bool is_geographic = false;
  double quarter_turn = 0;  ///< 90 degrees in the CRS's unit.
  std::optional<Place> turn;
  mutable std::vector<PJ_COORD> coords;

  /// Longitude and latitude become the CRS's x and y as the raster counts them.
  void to_crs(std::span<Place> places) const {
    coords.resize(places.size());
    for (std::size_t i = 0; i < places.size(); ++i)
      coords[i] = proj_coord(places[i].y, places[i].x, 0, std::numeric_limits<double>::infinity());
    run(PJ_FWD);
    for (std::size_t i = 0; i < places.size(); ++i)
      places[i] = {sign[0] * coords[i].v[axis[0]], sign[1] * coords[i].v[axis[1]]};
  }
  void from_crs(std::span<Place> places) const {
    coords.resize(places.size());
    for (std::size_t i = 0; i < places.size(); ++i) {
      coords[i] = proj_coord(0, 0, 0, std::numeric_limits<double>::infinity());
      coords[i].v[axis[0]] = sign[0] * places[i].x;
      coords[i].v[axis[1]] = sign[1] * places[i].y;
    }
    run(PJ_INV);
    for (std::size_t i = 0; i < places.size(); ++i) places[i] = {coords[i].v[1], coords[i].v[0]};
  }
  /// A place that fails becomes infinite and leaves an error number behind, which the next call would inherit.
  void run(PJ_DIRECTION direction) const {
    proj_errno_reset(operation.get());
    proj_trans_array(operation.get(), direction, coords.size(), coords.data());
    proj_errno_reset(operation.get());
  }
  Place cell_of(const Place& p) const {
    const double dx = p.x - gt[0], dy = p.y - gt[3], area = gt[1] * gt[5] - gt[2] * gt[4];
    return {(dx * gt[5] - dy * gt[2]) / area, (dy * gt[1] - dx * gt[4]) / area};
  }
  Place crs_of(const Place& c) const { return {gt[0] + c.x * gt[1] + c.y * gt[2], gt[3] + c.x * gt[4] + c.y * gt[5]}; }
  bool choose_operation(const OGRSpatialReference& crs);
  void find_turn();
};

/// PROJ may know several operations (NAD27, NAD83: dozens), each for an area. One raster gets one of them: two would
/// tear its surface apart.
bool PixelTransform::Impl::choose_operation(const OGRSpatialReference& crs) {
  const ProjObject globe(proj_create(context.get(), "EPSG:4326"));
  const ProjObject own = to_proj(context.get(), crs);
  if (!globe || !own) return false;
  operation.reset(proj_create_crs_to_crs_from_pj(context.get(), globe.get(), own.get(), nullptr, nullptr));
  if (!operation) return false;
  const std::vector<int>& mapping = crs.GetDataAxisToSRSAxisMapping();
  for (std::size_t k = 0; k < 2 && mapping.size() >= 2; ++k) {
    axis[k] = static_cast<std::size_t>(std::abs(mapping[k])) - 1;
    sign[k] = mapping[k] < 0 ? -1 : 1;
  }
  if (axis[0] > 1 || axis[1] > 1 || axis[0] == axis[1]) return false;
  // From the middle outwards: the middle itself may be off the globe.
  for (const double share : {0.5, 0.25, 0.75, 0.05, 0.95}) {
    for (const double other : {0.5, 0.25, 0.75, 0.05, 0.95}) {
      std::array<Place, 1> place{crs_of({share * n_cols, other * n_rows})};
      if (is_geographic) place[0].y = std::clamp(place[0].y, -quarter_turn, quarter_turn);
      from_crs(place);
      if (!std::isfinite(place[0].x) || !std::isfinite(place[0].y)) continue;
      to_crs(place);
      if (!std::isfinite(place[0].x) || !std::isfinite(place[0].y)) continue;
      if (ProjObject used(proj_trans_get_last_used_operation(operation.get())); used) operation = std::move(used);
      text = proj_text(context.get(), operation.get());
      return true;
    }
  }
  return false;
}

/// The coordinates repeat when one degree eastwards is the same step along x everywhere and no step along y.
void PixelTransform::Impl::find_turn() {
  std::vector<double> steps;
  for (const double latitude : {-40.0, 10.0, 50.0}) {
    for (double longitude = -170; longitude < 180; longitude += 45) {
      std::array<Place, 2> p{Place{longitude, latitude}, Place{longitude + 1, latitude}};
      to_crs(p);
      if (!std::isfinite(p[0].x) || !std::isfinite(p[1].x)) return;
      if (std::abs(p[1].y - p[0].y) > 1e-9 * std::abs(p[1].x - p[0].x)) return;
      steps.push_back(p[1].x - p[0].x);
    }
  }
  std::vector<double> sorted = steps;
  std::sort(sorted.begin(), sorted.end());
  const double step = sorted[sorted.size() / 2];
  const auto differing = std::count_if(steps.begin(), steps.end(),
                                       [&](double s) { return !(std::abs(s - step) <= 1e-9 * std::abs(step)); });
  if (step == 0 || differing > 3) return;  // the seam of x may lie in one degree of each latitude
  const Place zero = cell_of({0, 0}), whole = cell_of({360 * step, 0});
  turn = Place{whole.x - zero.x, whole.y - zero.y};
}

PixelTransform::PixelTransform(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PixelTransform::PixelTransform(PixelTransform&&) noexcept = default;
PixelTransform& PixelTransform::operator=(PixelTransform&&) noexcept = default;
PixelTransform::~PixelTransform() = default;

Result<PixelTransform> PixelTransform::create(const RasterFile& file) {
  auto impl = std::make_unique<Impl>();
  impl->context = make_proj_context();
  impl->gt = file.geotransform;
  impl->n_cols = static_cast<double>(file.info.n_cols);
  impl->n_rows = static_cast<double>(file.info.n_rows);
  impl->is_geographic = file.crs.IsGeographic() && !file.crs.IsDerivedGeographic();
  if (impl->is_geographic) impl->quarter_turn = std::numbers::pi / 2 / file.crs.GetAngularUnits();
  if (!impl->choose_operation(file.crs)) {
    return bad_raster(file, fmt::format("PROJ finds no way between its CRS \"{}\" and EPSG:4326 that works where it "
                                        "lies{}; check its CRS and geotransform with gdalinfo",
                                        file.info.crs, proj_detail(impl->context.get())));
  }
  impl->find_turn();
  return PixelTransform(std::move(impl));
}

void PixelTransform::to_cells(std::span<Place> places) const {
  impl_->to_crs(places);
  for (Place& p : places) {
    p = impl_->cell_of(p);
    if (!impl_->turn || is_inside(p)) continue;
    for (const double k : {-1.0, 1.0, -2.0, 2.0}) {
      const Place other{p.x + k * impl_->turn->x, p.y + k * impl_->turn->y};
      if (!is_inside(other)) continue;
      p = other;
      break;
    }
  }
}

void PixelTransform::to_globe(std::span<Place> places) const {
  const std::vector<Place> cells(places.begin(), places.end());
  for (Place& p : places) {
    p = impl_->crs_of(p);
    if (impl_->is_geographic) p.y = std::clamp(p.y, -impl_->quarter_turn, impl_->quarter_turn);
  }
  impl_->from_crs(places);
  if (impl_->is_geographic) return;
  // Outside a projection's outline its inverse may answer with a place that another cell has.
  std::vector<Place> back(places.begin(), places.end());
  impl_->to_crs(back);
  const Place turn = impl_->turn.value_or(Place{0, 0});
  for (std::size_t i = 0; i < places.size(); ++i) {
    const Place found = impl_->cell_of(back[i]);
    bool returns = false;
    for (const double k : {0.0, -1.0, 1.0, -2.0, 2.0}) {
      returns =
          returns || std::hypot(found.x + k * turn.x - cells[i].x, found.y + k * turn.y - cells[i].y) <= kReturnCells;
    }
    if (!returns) places[i] = {INFINITY, INFINITY};
  }
}

bool PixelTransform::is_inside(const Place& cell) const {
  return cell.x >= 0 && cell.x < impl_->n_cols && cell.y >= 0 && cell.y < impl_->n_rows;
}

const std::optional<Place>& PixelTransform::turn() const { return impl_->turn; }
const std::string& PixelTransform::operation() const { return impl_->text; }

}  // namespace tind
