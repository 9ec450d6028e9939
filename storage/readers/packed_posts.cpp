// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/packed_posts.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <utility>

#include "core/registers.hpp"

namespace tind {
namespace {

constexpr std::int64_t kSide = PostPage::kSide;
constexpr std::size_t kPagePosts = std::size_t{kSide} * kSide;
constexpr float kLowestM = -4096, kQuarterM = 0.25F;
// Pages that a thread holds: a row of them over a tile of some levels.
constexpr std::size_t kHeldPages = 64;

struct Range {
  std::uint16_t low = 65535, high = 0;
};

// False: not all heights are such quarters. Widens the range by those that are.
TIND_WIDE bool pack(const float* heights_m, std::int64_t n, std::uint16_t* quarters, Range& range) {
  std::uint32_t differences = 0;
  std::uint16_t low = range.low, high = range.high;
  for (std::int64_t k = 0; k < n; ++k) {
    // In range, as a post is within kMaxHeightM.
    const auto quarter = static_cast<std::uint16_t>(static_cast<std::int32_t>((heights_m[k] - kLowestM) / kQuarterM));
    quarters[k] = quarter;
    low = quarter < low ? quarter : low;
    high = quarter > high ? quarter : high;
    // By bits: there is a zero below zero, too.
    const float same = static_cast<float>(quarter) * kQuarterM + kLowestM;
    differences |= std::bit_cast<std::uint32_t>(same) ^ std::bit_cast<std::uint32_t>(heights_m[k]);
  }
  range = {low, high};
  return differences == 0;
}

float height_of(std::uint16_t quarter) { return static_cast<float>(quarter) * kQuarterM + kLowestM; }

TIND_WIDE void unpack(const std::uint16_t* quarters, std::size_t n, float* heights_m) {
  for (std::size_t k = 0; k < n; ++k) heights_m[k] = static_cast<float>(quarters[k]) * kQuarterM + kLowestM;
}

}  // namespace

PackedPosts::PackedPosts(std::int64_t n_rows, std::int64_t n_cols, std::int64_t margin)
    : PostPages(n_rows, n_cols, kHeldPages), n_rows_(n_rows), n_cols_(n_cols), margin_(margin) {}

Result<std::unique_ptr<PackedPosts>> PackedPosts::create(std::int64_t n_rows, std::int64_t n_cols,
                                                         std::int64_t margin) {
  std::unique_ptr<PackedPosts> result(new PackedPosts(n_rows, n_cols, margin));
  const auto n_pages = static_cast<std::size_t>(result->n_page_rows() * result->n_page_cols());
  PostGrid& rim = result->rim_;
  rim.n_rows = n_rows;
  rim.n_cols = n_cols;
  rim.rim = margin + 1;
  const auto n_rim = static_cast<std::uint64_t>(rim.n_posts());
  auto quarters = ScratchMap::in_memory(n_pages * kPagePosts * sizeof(std::uint16_t), true);
  auto floats = ScratchMap::in_memory(n_pages * kPagePosts * sizeof(float), false);
  auto rim_map = ScratchMap::in_memory(n_rim * (sizeof(float) + sizeof(PostOrigin)), false);
  auto blocks = ScratchMap::in_memory(PostBlocks::n_bytes(n_rows, n_cols), false);
  for (auto* map : {&quarters, &floats, &rim_map, &blocks}) {
    if (!*map) return tl::unexpected(map->error());
  }
  result->quarters_map_ = std::move(*quarters);
  result->floats_map_ = std::move(*floats);
  result->rim_map_ = std::move(*rim_map);
  result->block_map_ = std::move(*blocks);
  result->quarters_ = static_cast<std::uint16_t*>(result->quarters_map_.data());
  result->floats_ = static_cast<float*>(result->floats_map_.data());
  rim.heights_m = static_cast<float*>(result->rim_map_.data());
  rim.origins = reinterpret_cast<PostOrigin*>(rim.heights_m + n_rim);
  result->kinds_.assign(n_pages, kNone);
  result->known_.resize(n_pages);
  return result;
}

std::pair<std::int64_t, std::int64_t> PackedPosts::rows_of(std::int64_t i) const {
  const std::int64_t begin = std::max(i * kSide, margin_);
  return {begin, std::max(begin, std::min((i + 1) * kSide, n_rows_ - margin_))};
}

void PackedPosts::take(std::int64_t i, const float* first, std::int64_t stride) {
  const auto [row_begin, row_end] = rows_of(i);
  const std::int64_t west = margin_, east = n_cols_ - margin_;
  const auto at = [&, begin = row_begin](std::int64_t r, std::int64_t c) {
    return first + (r - begin) * stride + (c - west);
  };
  for (std::int64_t j = west / kSide; j * kSide < east; ++j) {
    const std::int64_t begin = std::max(west, j * kSide), end = std::min(east, (j + 1) * kSide);
    const auto number = static_cast<std::size_t>(i * n_page_cols() + j);
    // Elsewhere first: where this cannot be no memory is touched.
    thread_local std::array<std::uint16_t, kPagePosts> quarters{};
    bool is_packed = true;
    Range range;
    for (std::int64_t r = row_begin; r < row_end && is_packed; ++r) {
      is_packed = pack(at(r, begin), end - begin, quarters.data() + index(r, begin), range);
    }
    kinds_[number] = is_packed ? kQuarters : kFloats;
    if (is_packed) std::copy(quarters.begin(), quarters.end(), quarters_ + number * kPagePosts);
    if (const std::int64_t n = (end - begin) * (row_end - row_begin); is_packed && n == kSide * kSide) {
      known_[number] = {height_of(range.low), height_of(range.high), static_cast<std::uint32_t>(n),
                        1 << static_cast<int>(PostOrigin::kSource)};
    }
    for (std::int64_t r = row_begin; r < row_end && !is_packed; ++r) {
      std::copy_n(at(r, begin), end - begin, floats_ + number * kPagePosts + index(r, begin));
    }
  }
  const auto add_to_rim = [&](std::int64_t r, std::int64_t begin, std::int64_t end) {
    const std::int64_t to = rim_.index(r, begin);
    std::copy_n(at(r, begin), end - begin, rim_.heights_m + to);
    std::fill_n(rim_.origins + to, end - begin, PostOrigin::kSource);
  };
  for (std::int64_t r = row_begin; r < row_end; ++r) {
    if (r == margin_ || r == n_rows_ - margin_ - 1) {
      add_to_rim(r, west, east);
    } else {
      add_to_rim(r, west, west + 1);
      add_to_rim(r, east - 1, east);
    }
  }
}

void PackedPosts::attach(HeightField& field, int threads, CancelFlag cancel) {
  field.pages = this;
  const std::span memory(static_cast<std::byte*>(block_map_.data()), PostBlocks::n_bytes(n_rows_, n_cols_));
  blocks_ = PostBlocks::on_demand(field, memory, threads, cancel, known_);
  if (!is_set(cancel)) field.blocks = &blocks_;
}

bool PackedPosts::read(std::int64_t i, std::int64_t j, PostPage& page) const {
  const std::int64_t row_end = std::min((i + 1) * kSide, n_rows_), col = j * kSide;
  const std::int64_t col_end = std::min(col + kSide, n_cols_);
  for (std::int64_t r = i * kSide; r < row_end; ++r) {
    copy_part(r, col, col_end, page.heights_m + index(r, col), page.origins + index(r, col));
  }
  return true;
}

float PackedPosts::height_m(std::int64_t r, std::int64_t c) const {
  if (is_margin(r, c)) return rim_.heights_m[rim_.index(r, c)];
  const std::size_t number = page_of(r, c), at = number * kPagePosts + index(r, c);
  return kinds_[number] == kQuarters ? height_of(quarters_[at]) : floats_[at];
}

PostOrigin PackedPosts::origin(std::int64_t r, std::int64_t c) const {
  return is_margin(r, c) ? rim_.origins[rim_.index(r, c)] : PostOrigin::kSource;
}

void PackedPosts::copy_part(std::int64_t r, std::int64_t begin, std::int64_t end, float* heights_m,
                            PostOrigin* origins) const {
  const auto copy_margin = [&](std::int64_t from, std::int64_t to) {
    if (from >= to) return;
    std::copy_n(rim_.heights_m + rim_.index(r, from), to - from, heights_m + (from - begin));
    if (origins != nullptr) {
      std::copy_n(rim_.origins + rim_.index(r, from), to - from, origins + (from - begin));
    }
  };
  const std::int64_t west = margin_, east = n_cols_ - margin_;
  if (r < margin_ || r >= n_rows_ - margin_) return copy_margin(begin, end);
  copy_margin(begin, std::min(end, west));
  copy_margin(std::max(begin, east), end);
  const std::int64_t first = std::max(begin, west), last = std::min(end, east);
  if (first >= last) return;
  const std::size_t number = page_of(r, first), at = number * kPagePosts + index(r, first);
  if (kinds_[number] == kQuarters) {
    unpack(quarters_ + at, static_cast<std::size_t>(last - first), heights_m + (first - begin));
  } else {
    std::copy_n(floats_ + at, last - first, heights_m + (first - begin));
  }
  if (origins != nullptr) std::fill_n(origins + (first - begin), last - first, PostOrigin::kSource);
}

void PackedPosts::copy(std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols, float* heights_m,
                       PostOrigin* origins) const {
  const std::int64_t col_end = col + n_cols;
  // Page by page, whose rows lie together.
  for (std::int64_t begin = col, end = 0; begin < col_end; begin = end) {
    end = std::min(col_end, (begin / kSide + 1) * kSide);
    for (std::int64_t r = row; r < row + n_rows; ++r) {
      const std::int64_t to = (r - row) * n_cols + begin - col;
      copy_part(r, begin, end, heights_m + to, origins != nullptr ? origins + to : nullptr);
    }
  }
}

}  // namespace tind
