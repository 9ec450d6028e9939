// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/gdal_raster.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <thread>
#include <utility>

#include <cpl_vsi.h>
#include <fmt/format.h>

#include "storage/readers/file_hashes.hpp"
#include "storage/readers/mosaic_layout.hpp"
#include "storage/readers/pixel_transform.hpp"
#include "storage/readers/raster_file.hpp"
#include "storage/readers/raster_warper.hpp"
#include "storage/readers/vertical_shift.hpp"
#include "storage/readers/warp_plan.hpp"

namespace tind {
namespace {

/// Posts are warped in blocks of this many rows and columns, so that the cells behind them lie together.
constexpr std::int64_t kBlockRows = 64, kBlockCols = 256;
/// Zeros beside voids are suspicious where everything else is higher than this.
constexpr float kStrayAboveM = 10;
constexpr std::int64_t kSuspicionValues = std::int64_t{1} << 22;
/// Of GDAL's cache of blocks, which would take a twentieth of the machine's memory: a row of large blocks of a wide
/// file.
constexpr GIntBig kCacheBytes = GIntBig{64} << 20;

/// Rows and columns of the used posts of a source.
struct PostWindow {
  std::int64_t row = 0, col = 0, n_rows = 0, n_cols = 0;
};

}  // namespace

struct RasterMosaic::Impl {
  /// A source at work; `warper` and `native` are there only while it is read.
  struct Reader {
    std::optional<RasterWarper> warper;
    std::optional<PixelTransform> native;
    std::uint64_t used = 0;  ///< Clock of the last reading by `warper`.
  };
  std::vector<RasterFile> files;       ///< Same order as RasterMosaic::sources.
  std::unique_ptr<FileHashes> hashes;  ///< Null: all are made.
  std::vector<Reader> readers;
  std::optional<VerticalShift> shift;
  Resampling resampling = Resampling::kBilinear;
  WarpGrid grid;
  std::uint64_t clock = 0;

  Result<void> plan_warped(RasterMosaic& m);
  Result<void> settle_heights(RasterMosaic& m, const RasterOptions& options);
  /// Longitude and latitude of the mosaic's post (row, column), degrees.
  Place post(const RasterMosaic& m, std::int64_t row, std::int64_t col) const;
  Result<void> read_own(std::size_t s, const PostWindow& window, std::vector<float>& heights_m,
                        std::uint64_t& n_implausible);
  /// The same in the file's order.
  Result<void> read_own_as_it_lies(std::size_t s, const PostWindow& window, SourceRows& rows,
                                   std::uint64_t& n_implausible);
  /// Makes the sources that are not being read forget their cells, least recently read first, until what they keep is
  /// bounded, however many sources there are.
  void trim(std::size_t reading);
  Result<void> read_warped(const RasterMosaic& m, std::size_t s, const PostWindow& window,
                           std::vector<float>& heights_m, std::uint64_t& n_implausible);
};

RasterMosaic::RasterMosaic(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
RasterMosaic::RasterMosaic(RasterMosaic&&) noexcept = default;
RasterMosaic& RasterMosaic::operator=(RasterMosaic&&) noexcept = default;
RasterMosaic::~RasterMosaic() = default;

/// Gives every file its window of one common grid, in the members that otherwise describe its own grid.
Result<void> RasterMosaic::Impl::plan_warped(RasterMosaic& m) {
  std::vector<WarpExtent> extents;
  for (RasterFile& f : files) {
    const auto transform = PixelTransform::create(f);
    if (!transform) return tl::unexpected(transform.error());
    const auto extent = measure_extent(f, *transform);
    if (!extent) return tl::unexpected(extent.error());
    extents.push_back(*extent);
    f.info.operation = transform->operation();
  }
  auto planned = plan_warp(extents, files);
  if (!planned) return tl::unexpected(planned.error());
  grid = std::move(*planned);
  for (std::size_t i = 0; i < files.size(); ++i) {
    RasterFile& f = files[i];
    const WarpWindow& w = grid.windows[i];
    const std::int64_t half = 180 * grid.lon_per_degree;
    const std::int64_t col = ((w.first_col + half) % (2 * half) + 2 * half) % (2 * half) - half;
    f.dx = 1 / static_cast<double>(grid.lon_per_degree);
    f.dy = 1 / static_cast<double>(grid.lat_per_degree);
    f.west = static_cast<double>(col) / static_cast<double>(grid.lon_per_degree);
    f.south = static_cast<double>(w.first_row) / static_cast<double>(grid.lat_per_degree);
    f.info.n_used_cols = w.n_cols;
    f.info.n_used_rows = w.n_rows;
  }
  m.warped = true;
  m.resampling = resampling == Resampling::kCubic ? "cubic" : "bilinear";
  return {};
}

Place RasterMosaic::Impl::post(const RasterMosaic& m, std::int64_t row, std::int64_t col) const {
  if (!m.warped) {
    return {m.west_deg + static_cast<double>(col) * m.lon_spacing_deg,
            m.south_deg + static_cast<double>(row) * m.lat_spacing_deg};
  }
  const auto per_lon = static_cast<double>(grid.lon_per_degree), per_lat = static_cast<double>(grid.lat_per_degree);
  std::int64_t i = std::llround(m.west_deg * per_lon) + col;
  if (i >= 180 * grid.lon_per_degree) i -= 360 * grid.lon_per_degree;
  const std::int64_t j = std::llround(m.south_deg * per_lat) + row;
  return {static_cast<double>(i) / per_lon, static_cast<double>(j) / per_lat};
}

Result<void> RasterMosaic::Impl::settle_heights(RasterMosaic& m, const RasterOptions& options) {
  const RasterFile& first = files.front();
  m.vertical_datum = first.vertical_datum.empty() ? "unknown" : first.vertical_datum;
  m.height_kind = first.height_kind;
  if (!shift) {
    for (const RasterFile& s : files) {
      if (s.vertical_datum != first.vertical_datum) {
        m.notes.push_back(fmt::format("{}: its vertical datum differs from that of {}", s.info.name, first.info.name));
      }
    }
    return {};
  }
  if (auto ok = shift->settle(post(m, m.n_rows / 2, m.n_cols / 2)); !ok) return ok;
  m.height_kind = "ellipsoidal";
  m.vertical_operation = shift->operation();
  m.vertical_datum = shift->operation().empty()
                         ? shift->datum()
                         : fmt::format("{} ellipsoid, from {}", shift->ellipsoid(), shift->datum());
  for (const RasterFile& s : files) {
    if (s.height_kind == "ellipsoidal" && !shift->operation().empty()) {
      m.notes.push_back(fmt::format("{}: its CRS says that its heights are ellipsoidal; {} shifts them all the same",
                                    s.info.name, options.geoid.empty() ? "--vertical-datum" : "--geoid"));
    }
  }
  return {};
}

Result<RasterMosaic> RasterMosaic::open(const std::vector<std::string>& paths, const RasterOptions& options) {
  if (paths.empty()) return fail(ErrorKind::kInvalidInput, "no input raster given");
  auto hashes = std::make_unique<FileHashes>(std::max(1, static_cast<int>(std::thread::hardware_concurrency())));
  // What is a file for sure is hashed while headers are read; of any other name GDAL must tell which file it means.
  std::vector<std::optional<std::size_t>> hash_of(paths.size());
  for (std::size_t i = 0; options.hash_files && i < paths.size(); ++i) {
    VSIStatBufL stat;
    if (VSIStatL(paths[i].c_str(), &stat) == 0 && VSI_ISREG(stat.st_mode)) hash_of[i] = hashes->add(paths[i]);
  }
  GDALAllRegister();  // takes a while
  if (CPLGetConfigOption("GDAL_CACHEMAX", nullptr) == nullptr) GDALSetCacheMax64(kCacheBytes);
  // Rows of raw files are read once: not through a cache of theirs.
  constexpr char kOneRead[] = "GDAL_ONE_BIG_READ";
  if (CPLGetConfigOption(kOneRead, nullptr) == nullptr) CPLSetConfigOption(kOneRead, "YES");
  auto impl = std::make_unique<Impl>();
  impl->resampling = options.resampling;
  if (!options.vertical_datum.empty() || !options.geoid.empty()) {
    auto shift = VerticalShift::create(options.vertical_datum, options.geoid);
    if (!shift) return tl::unexpected(shift.error());
    impl->shift = std::move(*shift);
  }
  for (const std::string& path : paths) {
    auto file = inspect_raster(path, options, impl->shift ? impl->shift->unit_m() : 1.0);
    if (!file) return tl::unexpected(file.error());
    if (auto& hash = hash_of[impl->files.size()]; options.hash_files && !hash) hash = hashes->add(file->hashed_name);
    impl->files.push_back(std::move(*file));
  }
  if (options.hash_files && options.hash_later && paths.size() == 1) {  // of several the order depends on them
    impl->hashes = std::move(hashes);
  } else {
    for (std::size_t i = 0; options.hash_files && i < paths.size(); ++i) {
      auto hash = hashes->wait_for(*hash_of[i]);
      if (!hash) return tl::unexpected(hash.error());
      impl->files[i].info.sha256 = std::move(*hash);
    }
  }
  RasterMosaic m(std::move(impl));
  auto& files = m.impl_->files;
  std::size_t n_twice = sort_sources(files);
  if (const auto reason = why_warp(files)) {
    if (auto planned = m.impl_->plan_warped(m); !planned) return tl::unexpected(planned.error());
    n_twice += sort_sources(files);
    const WarpGrid& grid = m.impl_->grid;
    m.notes.push_back(fmt::format("{}; sources are warped to posts 1/{} x 1/{} degrees apart ({})", *reason,
                                  grid.lon_per_degree, grid.lat_per_degree, m.resampling));
  } else {
    for (RasterFile& s : files) s.notes.insert(s.notes.end(), s.own_grid_notes.begin(), s.own_grid_notes.end());
  }
  if (n_twice > 0) m.notes.push_back(fmt::format("{} inputs given twice are used once", n_twice));
  place_sources(m, files);
  if (m.warped) {
    const Place corner = m.impl_->post(m, 0, 0);
    m.west_deg = corner.x;
    m.south_deg = corner.y;
  }
  if (auto settled = m.impl_->settle_heights(m, options); !settled) return tl::unexpected(settled.error());
  m.native_spacing_m = files.front().info.native_spacing_m;
  for (const RasterFile& s : files) {
    m.sources.push_back(s.info);
    m.notes.insert(m.notes.end(), s.notes.begin(), s.notes.end());
    m.native_spacing_m = std::min(m.native_spacing_m, s.info.native_spacing_m);
  }
  m.impl_->readers.resize(files.size());
  return m;
}

Result<void> RasterMosaic::finish_hashing() {
  if (!impl_->hashes) return {};
  auto hash = impl_->hashes->wait_for(0);
  if (!hash) return tl::unexpected(hash.error());
  impl_->hashes.reset();
  impl_->files.front().info.sha256 = sources.front().sha256 = std::move(*hash);
  return {};
}

Result<void> RasterMosaic::Impl::read_own_as_it_lies(std::size_t index, const PostWindow& window, SourceRows& rows,
                                                     std::uint64_t& n_implausible) {
  RasterFile& s = files[index];
  // From rows counted northwards among the used ones to rows of the file.
  const std::int64_t from_south = s.skip_south + window.row;
  const std::int64_t file_row = s.north_up ? s.info.n_rows - from_south - window.n_rows : from_south;
  rows.n_rows = window.n_rows;
  rows.n_cols = window.n_cols;
  rows.northernmost_first = s.north_up;
  return s.read_window(window.col, file_row, window.n_cols, window.n_rows, rows.heights_m, n_implausible,
                       &rows.has_void);
}

Result<void> RasterMosaic::Impl::read_own(std::size_t index, const PostWindow& window, std::vector<float>& heights_m,
                                          std::uint64_t& n_implausible) {
  SourceRows rows;
  rows.heights_m.swap(heights_m);
  const auto read = read_own_as_it_lies(index, window, rows, n_implausible);
  rows.heights_m.swap(heights_m);
  if (!read) return read;
  if (rows.northernmost_first) {
    const std::int64_t n_cols = window.n_cols;
    for (std::int64_t low = 0, high = window.n_rows - 1; low < high; ++low, --high) {
      const auto a = heights_m.begin() + low * n_cols, b = heights_m.begin() + high * n_cols;
      std::swap_ranges(a, a + n_cols, b);
    }
  }
  return {};
}

void RasterMosaic::Impl::trim(std::size_t reading) {
  for (;;) {
    std::size_t n_blocks = 0, oldest = reading;
    for (std::size_t i = 0; i < readers.size(); ++i) {
      if (i == reading || !readers[i].warper || readers[i].warper->n_blocks() == 0) continue;
      n_blocks += readers[i].warper->n_blocks();
      if (oldest == reading || readers[i].used < readers[oldest].used) oldest = i;
    }
    if (n_blocks <= RasterWarper::kMostBlocks) return;
    readers[oldest].warper->clear();
  }
}

Result<void> RasterMosaic::Impl::read_warped(const RasterMosaic& m, std::size_t index, const PostWindow& window,
                                             std::vector<float>& heights_m, std::uint64_t& n_implausible) {
  RasterFile& s = files[index];
  auto& warper = readers[index].warper;
  if (!warper) {
    auto transform = PixelTransform::create(s);
    if (!transform) return tl::unexpected(transform.error());
    warper.emplace(s, std::move(*transform), resampling);
  }
  trim(index);
  readers[index].used = ++clock;
  const std::int64_t n = window.n_rows, n_cols = window.n_cols;
  heights_m.resize(static_cast<std::size_t>(n * n_cols));
  std::vector<Place> places;
  std::vector<float> block;
  for (std::int64_t r0 = 0; r0 < n; r0 += kBlockRows) {
    const std::int64_t r1 = std::min(r0 + kBlockRows, n);
    for (std::int64_t c0 = 0; c0 < n_cols; c0 += kBlockCols) {
      const std::int64_t c1 = std::min(c0 + kBlockCols, n_cols);
      places.clear();
      for (std::int64_t r = r0; r < r1; ++r) {
        for (std::int64_t c = c0; c < c1; ++c) {
          const std::int64_t col = s.info.grid_col + window.col + c;
          places.push_back(post(m, s.info.grid_row + window.row + r, col < m.n_cols ? col : col - m.n_cols));
        }
      }
      block.resize(places.size());
      if (auto ok = warper->sample(places, block.data(), n_implausible); !ok) return ok;
      for (std::int64_t r = r0; r < r1; ++r)
        std::copy_n(block.begin() + (r - r0) * (c1 - c0), c1 - c0, heights_m.begin() + r * n_cols + c0);
    }
  }
  return {};
}

Result<void> RasterMosaic::read_window(std::size_t index, std::int64_t first_row, std::int64_t first_col,
                                       std::int64_t n_window_rows, std::int64_t n_window_cols,
                                       std::vector<float>& heights_m, std::uint64_t& n_implausible) const {
  Impl& impl = *impl_;
  const RasterSource& s = sources[index];
  const PostWindow window{first_row, first_col, n_window_rows, n_window_cols};
  auto read = warped ? impl.read_warped(*this, index, window, heights_m, n_implausible)
                     : impl.read_own(index, window, heights_m, n_implausible);
  if (!read || !impl.shift) return read;
  std::vector<Place> places(static_cast<std::size_t>(window.n_cols));
  for (std::int64_t r = 0; r < window.n_rows; ++r) {
    for (std::int64_t c = 0; c < window.n_cols; ++c) {
      const std::int64_t col = (s.grid_col + window.col + c) % n_cols;
      places[static_cast<std::size_t>(c)] = impl.post(*this, s.grid_row + window.row + r, col);
    }
    if (auto ok = impl.shift->apply(places, heights_m.data() + r * window.n_cols); !ok) return ok;
  }
  return {};
}

Result<void> RasterMosaic::read_rows(std::size_t index, std::int64_t first_row, std::int64_t n,
                                     std::vector<float>& heights_m, std::uint64_t& n_implausible) const {
  const RasterSource& s = sources[index];
  if (auto read = read_window(index, first_row, 0, n, s.n_used_cols, heights_m, n_implausible); !read) return read;
  if (first_row + n == s.n_used_rows) impl_->readers[index].warper.reset();
  impl_->files[index].close_when_read(n);
  return {};
}

Result<void> RasterMosaic::read_rows(std::size_t index, std::int64_t first_row, std::int64_t n, SourceRows& rows,
                                     std::uint64_t& n_implausible) const {
  const std::int64_t n_used_cols = sources[index].n_used_cols;
  if (warped || impl_->shift) {
    rows = {std::move(rows.heights_m), n, n_used_cols};
    return read_rows(index, first_row, n, rows.heights_m, n_implausible);
  }
  const PostWindow window{first_row, 0, n, n_used_cols};
  if (auto read = impl_->read_own_as_it_lies(index, window, rows, n_implausible); !read) return read;
  impl_->files[index].close_when_read(n);
  return {};
}

bool RasterMosaic::reads_in_parallel() const { return !warped && !impl_->shift; }

Result<void> RasterMosaic::read_native_rows(std::size_t index, std::int64_t first_row, std::int64_t n,
                                            NativePosts& posts) const {
  Impl& impl = *impl_;
  RasterFile& s = impl.files[index];
  std::uint64_t n_implausible = 0;
  if (auto ok = s.read_window(0, first_row, s.info.n_cols, n, posts.heights_m, n_implausible); !ok) return ok;
  auto& transform = impl.readers[index].native;
  if (warped && !transform) {
    auto created = PixelTransform::create(s);
    if (!created) return tl::unexpected(created.error());
    transform = std::move(*created);
  }
  std::vector<Place> places;
  for (std::int64_t r = first_row; r < first_row + n; ++r) {
    for (std::int64_t c = 0; c < s.info.n_cols; ++c) {
      if (warped) {
        places.push_back({static_cast<double>(c) + 0.5, static_cast<double>(r) + 0.5});
      } else {
        const std::int64_t from_south = (s.north_up ? s.info.n_rows - 1 - r : r) - s.skip_south;
        const Place p = impl.post(*this, s.info.grid_row + from_south, s.info.grid_col + c);
        places.push_back({std::remainder(p.x, 360.0), std::abs(p.y) <= 90 + kAlignPosts * s.dy ? p.y : INFINITY});
      }
    }
  }
  if (warped) transform->to_globe(places);
  if (impl.shift) {
    for (std::size_t i = 0; i < places.size(); ++i) {
      if (!std::isfinite(places[i].x) || !std::isfinite(places[i].y))
        posts.heights_m[i] = std::numeric_limits<float>::quiet_NaN();
    }
    if (auto ok = impl.shift->apply(places, posts.heights_m.data()); !ok) return ok;
  }
  posts.lon_deg.resize(places.size());
  posts.lat_deg.resize(places.size());
  for (std::size_t i = 0; i < places.size(); ++i) {
    posts.lon_deg[i] = places[i].x;
    posts.lat_deg[i] = places[i].y;
  }
  if (first_row + n == s.info.n_rows) {
    transform.reset();
    s.dataset.reset();
  }
  return {};
}

Result<std::vector<std::string>> RasterMosaic::suspicions() const {
  std::vector<std::string> lines;
  for (RasterFile& s : impl_->files) {
    const float lowest = s.signs.lowest_other;
    if (!s.signs.has_void || !s.signs.has_zero || !(lowest > kStrayAboveM) || !std::isfinite(lowest)) continue;
    const std::int64_t width = s.info.n_cols, height = s.info.n_rows;
    const std::int64_t step = std::max<std::int64_t>(1, kSuspicionValues / width);
    std::vector<float> heights;
    std::uint64_t n_zero = 0, n_beside = 0, n_implausible = 0;
    for (std::int64_t begin = 0; begin < height; begin += step) {
      const std::int64_t end = std::min(begin + step, height), low = std::max<std::int64_t>(begin - 1, 0),
                         high = std::min(end + 1, height);
      if (auto ok = s.read_window(0, low, width, high - low, heights, n_implausible); !ok)
        return tl::unexpected(ok.error());
      const auto at = [&](std::int64_t r, std::int64_t c) {
        return heights[static_cast<std::size_t>((r - low) * width + c)];
      };
      for (std::int64_t r = begin; r < end; ++r) {
        for (std::int64_t c = 0; c < width; ++c) {
          if (at(r, c) != 0) continue;
          bool beside = false;
          for (std::int64_t rr = std::max(r - 1, low); rr < std::min(r + 2, high) && !beside; ++rr) {
            for (std::int64_t cc = std::max<std::int64_t>(c - 1, 0); cc < std::min(c + 2, width) && !beside; ++cc)
              beside = std::isnan(at(rr, cc));
          }
          n_beside += beside ? 1 : 0;
          ++n_zero;
        }
      }
    }
    s.dataset.reset();
    if (n_beside == 0) continue;
    lines.push_back(
        fmt::format("{}: {} posts of exactly 0 m ({} of them beside voids) while all other posts are above {:.1f} m; "
                    "if they mark voids give --nodata 0",
                    s.info.name, n_zero, n_beside, std::floor(lowest * 10) / 10));
  }
  return lines;
}

}  // namespace tind
