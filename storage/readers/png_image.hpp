// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <span>

#include "core/format/bytes.hpp"
#include "core/result.hpp"

namespace tind {

/// A PNG file of one grey channel. `pixels`: n_rows x n_cols, row-major, top row first; 0 black, 255 white. kIo when
/// GDAL has no PNG driver or no memory.
Result<Bytes> encode_png(std::span<const std::uint8_t> pixels, int n_rows, int n_cols);

}  // namespace tind
