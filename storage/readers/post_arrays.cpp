// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/post_arrays.hpp"

#include <cerrno>
#include <cstring>
#include <utility>

namespace tind {

Result<PostArrays> PostArrays::create(const std::string& folder, std::int64_t n_rows, std::int64_t n_cols) {
  const auto n_posts = static_cast<std::uint64_t>(n_rows) * static_cast<std::uint64_t>(n_cols);
  const std::uint64_t n_block_bytes = PostBlocks::n_bytes(n_rows, n_cols);
  // Blocks begin where they may lie: at a multiple of 8.
  const std::uint64_t n_post_bytes = (n_posts * (sizeof(float) + sizeof(PostOrigin)) + 7) / 8 * 8;
  auto map = ScratchMap::create(folder, n_post_bytes + n_block_bytes);
  if (!map) return tl::unexpected(map.error());
  PostArrays result;
  result.map_ = std::move(*map);
  result.n_rows_ = n_rows;
  result.n_cols_ = n_cols;
  auto* const bytes = static_cast<std::byte*>(result.map_.data());
  result.heights_m_ = reinterpret_cast<float*>(bytes);
  result.origins_ = reinterpret_cast<PostOrigin*>(bytes + n_posts * sizeof(float));
  result.block_memory_ = {bytes + n_post_bytes, static_cast<std::size_t>(n_block_bytes)};
  return result;
}

PostGrid PostArrays::grid() const { return {n_rows_, n_cols_, false, heights_m_, origins_}; }

void PostArrays::attach(HeightField& field) const {
  field.heights_m = heights_m_;
  field.origins = origins_;
}

Result<void> PostArrays::take_source(std::int64_t at, const float* heights_m, std::int64_t n) {
  const auto first = static_cast<std::uint64_t>(at), count = static_cast<std::uint64_t>(n);
  if (source_row_.size() < count) source_row_.assign(static_cast<std::size_t>(count), PostOrigin::kSource);
  const auto n_posts = static_cast<std::uint64_t>(n_rows_) * static_cast<std::uint64_t>(n_cols_);
  if (map_.write(first * sizeof(float), heights_m, count * sizeof(float)) &&
      map_.write(n_posts * sizeof(float) + first, source_row_.data(), count)) {
    return {};
  }
  return fail(ErrorKind::kIo, std::string("the scratch file of the posts cannot be written: ") + std::strerror(errno));
}

void PostArrays::build_blocks(HeightField& field, int threads, CancelFlag cancel) {
  blocks_ = PostBlocks::build(field, block_memory_, threads, cancel);
  if (!is_set(cancel)) field.blocks = &blocks_;
}

}  // namespace tind
