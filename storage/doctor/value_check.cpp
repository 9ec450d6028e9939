// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/value_check.hpp"

#include <fmt/format.h>
#include <zstd.h>

#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr std::uint64_t kMostWindowBytes = std::uint64_t{1} << 23;

// What RFC 8878, 3.1.1.1 has in the two bytes behind the magic number.
Result<void> check_header(ByteView frame) {
  if (frame.size() < 6) return fail(ErrorKind::kCorrupt, "a zstd frame without a header");
  const std::uint8_t descriptor = frame[4];
  if ((descriptor & 0x03) != 0) return fail(ErrorKind::kCorrupt, "a zstd frame that needs a dictionary");
  const bool is_single_segment = (descriptor & 0x20) != 0;
  std::uint64_t window_bytes = 0;
  if (is_single_segment) {
    window_bytes = ZSTD_getFrameContentSize(frame.data(), frame.size());
  } else {
    const std::uint64_t base = std::uint64_t{1} << (10 + (frame[5] >> 3));
    window_bytes = base + base / 8 * (frame[5] & 7);
  }
  if (window_bytes > kMostWindowBytes) {
    return fail(ErrorKind::kCorrupt,
                fmt::format("a zstd frame with a window of {} bytes, more than browsers take", window_bytes));
  }
  return {};
}

}  // namespace

Result<Bytes> unpack_strictly(ByteView value) {
  if (value.empty()) return fail(ErrorKind::kCorrupt, "an empty value");
  if (is_zstd_frame(value)) {
    const std::size_t n_bytes = ZSTD_findFrameCompressedSize(value.data(), value.size());
    if (ZSTD_isError(n_bytes)) return fail(ErrorKind::kCorrupt, "broken zstd frame");
    if (n_bytes != value.size()) {
      return fail(ErrorKind::kCorrupt, fmt::format("{} bytes behind the zstd frame", value.size() - n_bytes));
    }
    if (auto checked = check_header(value); !checked) return tl::unexpected(checked.error());
  }
  return unpack_value(value);
}

}  // namespace tind
