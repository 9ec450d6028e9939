// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/raster_warper.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

namespace tind {
namespace {

constexpr float kVoid = std::numeric_limits<float>::quiet_NaN();

/// Keys, "Cubic convolution interpolation for digital image processing", IEEE ASSP 29 (1981), with a = -1/2: the
/// weights of the four cells around a place `t` (0..1) behind the second one.
std::array<double, 4> keys_weights(double t) {
  const double t2 = t * t, t3 = t2 * t;
  return {-0.5 * t + t2 - 0.5 * t3, 1 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3};
}

}  // namespace

struct RasterWarper::Impl {
  RasterFile& file;
  PixelTransform transform;
  Resampling resampling;

  struct Block {
    std::vector<float> heights_m;
    std::int64_t index = -1;
    std::uint64_t used = 0;
  };
  std::int64_t blocks_across;
  std::vector<std::int32_t> slot_of;  ///< Per block of the raster: its slot, or -1.
  std::vector<bool> counted;          ///< Blocks whose implausible cells are counted.
  std::vector<Block> slots;
  std::uint64_t clock = 0;
  std::uint64_t n_implausible = 0;
  Result<void> status;

  Impl(RasterFile& f, PixelTransform t, Resampling r)
      : file(f), transform(std::move(t)), resampling(r), blocks_across((f.info.n_cols + kBlockSide - 1) / kBlockSide) {
    const auto n = static_cast<std::size_t>(blocks_across * ((f.info.n_rows + kBlockSide - 1) / kBlockSide));
    slot_of.assign(n, -1);
    counted.assign(n, false);
  }

  /// The cell's height; NaN for a void, a cell outside, and everything after a failure.
  float cell(std::int64_t c, std::int64_t r) {
    if (c < 0 || r < 0 || c >= file.info.n_cols || r >= file.info.n_rows) return kVoid;
    const std::int64_t index = r / kBlockSide * blocks_across + c / kBlockSide;
    std::int32_t slot = slot_of[static_cast<std::size_t>(index)];
    if (slot < 0) slot = load(index);
    if (slot < 0) return kVoid;
    Block& block = slots[static_cast<std::size_t>(slot)];
    block.used = ++clock;
    const std::int64_t width = std::min(kBlockSide, file.info.n_cols - c / kBlockSide * kBlockSide);
    return block.heights_m[static_cast<std::size_t>(r % kBlockSide * width + c % kBlockSide)];
  }

  std::int32_t load(std::int64_t index) {
    if (!status) return -1;
    if (slots.size() < kMostBlocks) {
      slots.emplace_back();
    } else {
      const auto oldest =
          std::min_element(slots.begin(), slots.end(), [](const Block& a, const Block& b) { return a.used < b.used; });
      std::swap(*oldest, slots.back());
      if (oldest->index >= 0)
        slot_of[static_cast<std::size_t>(oldest->index)] = static_cast<std::int32_t>(oldest - slots.begin());
      if (slots.back().index >= 0) slot_of[static_cast<std::size_t>(slots.back().index)] = -1;
    }
    Block& block = slots.back();
    block.index = -1;
    const std::int64_t col = index % blocks_across * kBlockSide, row = index / blocks_across * kBlockSide;
    std::uint64_t implausible = 0;
    status = file.read_window(col, row, std::min(kBlockSide, file.info.n_cols - col),
                              std::min(kBlockSide, file.info.n_rows - row), block.heights_m, implausible);
    if (!status) return -1;
    if (!counted[static_cast<std::size_t>(index)]) n_implausible += implausible;
    counted[static_cast<std::size_t>(index)] = true;
    block.index = index;
    const auto slot = static_cast<std::int32_t>(slots.size() - 1);
    slot_of[static_cast<std::size_t>(index)] = slot;
    return slot;
  }

  float height(const Place& at) {
    if (!transform.is_inside(at)) return kVoid;
    if (std::isnan(cell(static_cast<std::int64_t>(at.x), static_cast<std::int64_t>(at.y)))) return kVoid;
    const double x = at.x - 0.5, y = at.y - 0.5;
    const double left = std::floor(x), top = std::floor(y), fx = x - left, fy = y - top;
    const auto c = static_cast<std::int64_t>(left), r = static_cast<std::int64_t>(top);
    if (resampling == Resampling::kCubic) {
      if (const float v = cubic(c, r, fx, fy); !std::isnan(v)) return v;
    }
    double sum = 0, weights = 0;
    for (int j = 0; j < 2; ++j) {
      for (int i = 0; i < 2; ++i) {
        const float v = cell(c + i, r + j);
        if (std::isnan(v)) continue;
        const double w = (i == 0 ? 1 - fx : fx) * (j == 0 ? 1 - fy : fy);
        sum += w * static_cast<double>(v);
        weights += w;
      }
    }
    return static_cast<float>(sum / weights);  // the cell that holds the post weighs at least a quarter
  }

  /// NaN when one of the 16 cells has no height.
  float cubic(std::int64_t c, std::int64_t r, double fx, double fy) {
    const auto wx = keys_weights(fx), wy = keys_weights(fy);
    double sum = 0;
    for (int j = 0; j < 4; ++j) {
      double row = 0;
      for (int i = 0; i < 4; ++i)
        row += wx[static_cast<std::size_t>(i)] * static_cast<double>(cell(c + i - 1, r + j - 1));
      sum += wy[static_cast<std::size_t>(j)] * row;
    }
    return static_cast<float>(sum);
  }
};

RasterWarper::RasterWarper(RasterFile& file, PixelTransform transform, Resampling resampling)
    : impl_(std::make_unique<Impl>(file, std::move(transform), resampling)) {}
RasterWarper::RasterWarper(RasterWarper&&) noexcept = default;
RasterWarper& RasterWarper::operator=(RasterWarper&&) noexcept = default;
RasterWarper::~RasterWarper() = default;

Result<void> RasterWarper::sample(std::span<Place> places, float* heights_m, std::uint64_t& n_implausible) {
  impl_->transform.to_cells(places);
  impl_->status = {};
  impl_->n_implausible = 0;
  for (std::size_t i = 0; i < places.size() && impl_->status; ++i) heights_m[i] = impl_->height(places[i]);
  n_implausible += impl_->n_implausible;
  return impl_->status;
}

std::size_t RasterWarper::n_blocks() const { return impl_->slots.size(); }

void RasterWarper::clear() {
  std::fill(impl_->slot_of.begin(), impl_->slot_of.end(), -1);
  impl_->slots.clear();
  impl_->slots.shrink_to_fit();
}

const PixelTransform& RasterWarper::transform() const { return impl_->transform; }

}  // namespace tind
