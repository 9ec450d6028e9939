// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/post_arrays.hpp"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <utility>

#include "core/drainage/flow_run.hpp"
#include "storage/readers/scratch_file.hpp"
#include "storage/readers/void_fill.hpp"

namespace tind {
namespace {

// Pages in a file, row by row.
template <class Base, class Page>
class FilePages final : public Base {
 public:
  template <class... Args>
  explicit FilePages(ScratchFile file, Args... args) : Base(args...), file_(std::move(file)) {}

  // Writes pages (i, j), (i, j + 1), ...
  bool write(std::int64_t i, std::int64_t j, std::span<const Page> pages) {
    return file_.write(offset(i, j), pages.data(), pages.size_bytes());
  }

 private:
  std::uint64_t offset(std::int64_t i, std::int64_t j) const {
    return static_cast<std::uint64_t>(i * this->n_page_cols() + j) * sizeof(Page);
  }
  bool read(std::int64_t i, std::int64_t j, Page& page) const override {
    return file_.read(offset(i, j), &page, sizeof page);
  }

  ScratchFile file_;
};
using FilePostPages = FilePages<PostPages, PostPage>;
using FileBlockPages = FilePages<PostBlockPages, PostBlockPage>;

// Reads arrays row by row and writes them as pages, on any thread.
class PageMover {
 public:
  static constexpr std::int64_t kChunkPages = 16;

  PageMover(const HeightField& field, const ScratchFile& arrays, const void* block_memory,
            const ScratchFile& block_arrays)
      : field_(field), arrays_(arrays), block_memory_(block_memory), block_arrays_(block_arrays) {}

  // Pages (i, j), (i, j + 1), ... of posts, `n` <= kChunkPages of them.
  bool move_posts(std::int64_t i, std::int64_t j, std::int64_t n, FilePostPages& to) const {
    constexpr std::int64_t kSide = PostPage::kSide;
    const std::int64_t col = j * kSide, n_cols = std::min(n * kSide, field_.n_cols - col);
    const std::int64_t n_rows = std::min(kSide, field_.n_rows - i * kSide);
    const auto n_posts = static_cast<std::uint64_t>(field_.n_rows) * static_cast<std::uint64_t>(field_.n_cols);
    std::vector<PostPage> pages(static_cast<std::size_t>(n));
    std::vector<float> heights(static_cast<std::size_t>(n_cols));
    std::vector<PostOrigin> origins(static_cast<std::size_t>(n_cols));
    for (std::int64_t r = 0; r < n_rows; ++r) {
      const auto at = static_cast<std::uint64_t>((i * kSide + r) * field_.n_cols + col);
      if (!arrays_.read(at * sizeof(float), heights.data(), heights.size() * sizeof(float)) ||
          !arrays_.read(n_posts * sizeof(float) + at, origins.data(), origins.size())) {
        return false;
      }
      for (std::int64_t c = 0; c < n_cols; c += kSide) {
        PostPage& page = pages[static_cast<std::size_t>(c / kSide)];
        const std::int64_t n_of_page = std::min(kSide, n_cols - c);
        std::copy_n(heights.begin() + c, n_of_page, page.heights_m + r * kSide);
        std::copy_n(origins.begin() + c, n_of_page, page.origins + r * kSide);
      }
    }
    return to.write(i, j, pages);
  }

  // The same for their blocks.
  bool move_blocks(std::int64_t i, std::int64_t j, std::int64_t n, FileBlockPages& to) const {
    const PostBlocks& blocks = *field_.blocks;
    std::vector<PostBlockPage> pages(static_cast<std::size_t>(n));
    for (int level = 0; level < std::min(PostBlockPage::kLevels, blocks.n_levels()); ++level) {
      const std::int64_t side = std::int64_t{1} << (PostBlockPage::kLevels - 1 - level), first = j * side;
      const std::int64_t row_end = std::min((i + 1) * side, blocks.n_block_rows(level));
      const std::int64_t col_end = std::min((j + n) * side, blocks.n_block_cols(level));
      std::vector<PostBlock> planes(static_cast<std::size_t>(col_end - first));
      std::vector<PostBlockSums> sums(planes.size());
      for (std::int64_t r = i * side; r < row_end; ++r) {
        if (!read_row(&blocks.block(level, r, first), planes) || !read_row(&blocks.sums(level, r, first), sums)) {
          return false;
        }
        for (std::int64_t c = first; c < col_end; ++c) {
          PostBlockPage& page = pages[static_cast<std::size_t>(c / side - j)];
          const std::size_t at = PostBlockPage::index(level, r, c);
          page.blocks[at] = planes[static_cast<std::size_t>(c - first)];
          page.sums[at] = sums[static_cast<std::size_t>(c - first)];
        }
      }
    }
    return to.write(i, j, pages);
  }

 private:
  // What lies at an address of the map, from its file.
  template <class T>
  bool read_row(const T* at, std::vector<T>& to) const {
    const auto offset = reinterpret_cast<const char*>(at) - static_cast<const char*>(block_memory_);
    return block_arrays_.read(static_cast<std::uint64_t>(offset), to.data(), to.size() * sizeof(T));
  }

  const HeightField& field_;
  const ScratchFile& arrays_;
  const void* block_memory_;
  const ScratchFile& block_arrays_;
};

tl::unexpected<Error> cannot_write(int error) {
  return fail(ErrorKind::kIo, std::string("the scratch file of the posts cannot be written: ") + std::strerror(error));
}

}  // namespace

Result<PostArrays> PostArrays::create(const std::string& folder, std::int64_t n_rows, std::int64_t n_cols,
                                      std::uint64_t in_memory_bytes) {
  const auto n_posts = static_cast<std::uint64_t>(n_rows) * static_cast<std::uint64_t>(n_cols);
  const std::uint64_t n_bytes = n_post_bytes(n_rows, n_cols), n_block_bytes = PostBlocks::n_bytes(n_rows, n_cols);
  const bool in_memory = n_bytes + n_block_bytes <= in_memory_bytes;
  auto map = in_memory ? ScratchMap::in_memory(n_bytes, true) : ScratchMap::create(folder, n_bytes);
  if (!map) return tl::unexpected(map.error());
  auto block_map = in_memory ? ScratchMap::in_memory(n_block_bytes, false) : ScratchMap::create(folder, n_block_bytes);
  if (!block_map) return tl::unexpected(block_map.error());
  PostArrays result;
  result.map_ = std::move(*map);
  result.block_map_ = std::move(*block_map);
  result.n_rows_ = n_rows;
  result.n_cols_ = n_cols;
  auto* const bytes = static_cast<std::byte*>(result.map_.data());
  result.heights_m_ = reinterpret_cast<float*>(bytes);
  result.origins_ = reinterpret_cast<PostOrigin*>(bytes + n_posts * sizeof(float));
  result.block_memory_ = {static_cast<std::byte*>(result.block_map_.data()), static_cast<std::size_t>(n_block_bytes)};
  return result;
}

PostGrid PostArrays::grid() const { return {n_rows_, n_cols_, false, heights_m_, origins_}; }

void PostArrays::attach(HeightField& field) const {
  field.heights_m = heights_m_;
  field.origins = origins_;
}

Result<void> PostArrays::take(std::int64_t at, std::span<const float> heights_m, std::span<const PostOrigin> origins) {
  // So many voids take as long to write as one more write does.
  constexpr std::int64_t kMostVoids = 4096;
  const auto n_posts = static_cast<std::uint64_t>(n_rows_) * static_cast<std::uint64_t>(n_cols_);
  const auto n = static_cast<std::int64_t>(origins.size());
  for (std::int64_t begin = next_post(origins.data(), 0, n); begin < n;) {
    std::int64_t end = begin, next = begin;
    while (next < n && next - end <= kMostVoids) {
      end = next_void(origins.data(), next, n);
      next = next_post(origins.data(), end, n);
    }
    const auto first = static_cast<std::uint64_t>(at + begin), count = static_cast<std::uint64_t>(end - begin);
    if (!map_.is_file()) {
      std::copy_n(heights_m.data() + begin, count, heights_m_ + first);
      std::copy_n(origins.data() + begin, count, origins_ + first);
    } else if (!map_.file().write(first * sizeof(float), heights_m.data() + begin, count * sizeof(float)) ||
               !map_.file().write(n_posts * sizeof(float) + first, origins.data() + begin, count)) {
      return cannot_write(errno);
    }
    begin = next;
  }
  return {};
}

void PostArrays::build_blocks(HeightField& field, int threads, CancelFlag cancel) {
  // Whoever reads arrays so small may keep them, and dropping pages to fault them in again takes time.
  constexpr std::uint64_t kMostKept = std::uint64_t{160} << 20;
  const auto release = n_bytes(field) > kMostKept ? release_pages_around : nullptr;
  blocks_ = !map_.is_file() ? PostBlocks::on_demand(field, block_memory_, threads, cancel)
                            : PostBlocks::build(field, block_memory_, threads, cancel, release);
  if (!is_set(cancel)) field.blocks = &blocks_;
}

Result<void> PostArrays::turn_into_pages(HeightField& field, const std::string& folder, std::size_t held_bytes,
                                         int threads, CancelFlag cancel) {
  static_assert(PostPage::kSide == PostBlocks::kSide << (PostBlockPage::kLevels - 1), "pages of one grid");
  auto file = ScratchFile::create(folder), block_file = ScratchFile::create(folder);
  if (!file || !block_file) return tl::unexpected(!file ? file.error() : block_file.error());
  // A page of blocks is smaller than one of posts.
  const auto post_bytes = static_cast<std::size_t>(0.7 * static_cast<double>(held_bytes));
  auto pages = std::make_unique<FilePostPages>(std::move(*file), n_rows_, n_cols_, post_bytes / sizeof(PostPage));
  auto block_pages =
      std::make_unique<FileBlockPages>(std::move(*block_file), PostBlocks::n_pages(n_rows_),
                                       PostBlocks::n_pages(n_cols_), (held_bytes - post_bytes) / sizeof(PostBlockPage));
  const PageMover mover(field, map_.file(), block_map_.data(), block_map_.file());
  const auto n_posts = static_cast<std::uint64_t>(n_rows_) * static_cast<std::uint64_t>(n_cols_);
  std::atomic<int> failure{0};  // errno
  for_each_job({threads, cancel, {}}, pages->n_page_rows(), [&](int, std::int64_t i) {
    for (std::int64_t j = 0; j < pages->n_page_cols() && failure == 0; j += PageMover::kChunkPages) {
      const std::int64_t n = std::min(PageMover::kChunkPages, pages->n_page_cols() - j);
      if (!mover.move_posts(i, j, n, *pages) || !mover.move_blocks(i, j, n, *block_pages)) failure = errno;
    }
    const auto first = static_cast<std::uint64_t>(i * PostPage::kSide * n_cols_);
    const auto n = static_cast<std::uint64_t>(std::min(PostPage::kSide, n_rows_ - i * PostPage::kSide) * n_cols_);
    map_.file().free_space(first * sizeof(float), n * sizeof(float));
    map_.file().free_space(n_posts * sizeof(float) + first, n);
  });
  field.heights_m = heights_m_ = nullptr;
  field.origins = origins_ = nullptr;
  map_ = ScratchMap();
  if (is_set(cancel)) return interrupted();
  if (failure != 0) return cannot_write(failure);
  auto coarse = ScratchMap::create(folder, std::max<std::uint64_t>(blocks_.n_coarse_bytes(), 1));
  if (!coarse) return tl::unexpected(coarse.error());
  blocks_ = blocks_.in_pages(*block_pages, {static_cast<std::byte*>(coarse->data()), blocks_.n_coarse_bytes()});
  block_map_ = std::move(*coarse);
  block_memory_ = {};
  pages_ = std::move(pages);
  block_pages_ = std::move(block_pages);
  field.pages = pages_.get();
  return {};
}

}  // namespace tind
