// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/post_pages.hpp"

#include <algorithm>

namespace tind {

bool PostPages::is_known_source(std::int64_t, std::int64_t, std::int64_t, std::int64_t) const { return false; }

void PostPages::copy(std::int64_t row, std::int64_t col, std::int64_t n_rows, std::int64_t n_cols, float* heights_m,
                     PostOrigin* origins) const {
  for (std::int64_t r0 = row; r0 < row + n_rows;) {
    const std::int64_t r1 = std::min(row + n_rows, (r0 / kSide + 1) * kSide);
    for (std::int64_t c0 = col; c0 < col + n_cols;) {
      const std::int64_t c1 = std::min(col + n_cols, (c0 / kSide + 1) * kSide);
      const PostPage& from = of_post(r0, c0);
      for (std::int64_t r = r0; r < r1; ++r) {
        const std::int64_t to = (r - row) * n_cols + c0 - col;
        std::copy_n(from.heights_m + index(r, c0), c1 - c0, heights_m + to);
        if (origins != nullptr) std::copy_n(from.origins + index(r, c0), c1 - c0, origins + to);
      }
      c0 = c1;
    }
    r0 = r1;
  }
}

}  // namespace tind
