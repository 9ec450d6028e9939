// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/zstd_codec.hpp"

#include <zstd.h>

#include <algorithm>
#include <cassert>
#include <memory>

namespace tind {
namespace {

// A context is 100 KB and more: one a thread, reused.
ZSTD_CCtx* compression_context() {
  thread_local const std::unique_ptr<ZSTD_CCtx, decltype(&ZSTD_freeCCtx)> context(ZSTD_createCCtx(), &ZSTD_freeCCtx);
  return context.get();
}
ZSTD_DCtx* decompression_context() {
  thread_local const std::unique_ptr<ZSTD_DCtx, decltype(&ZSTD_freeDCtx)> context(ZSTD_createDCtx(), &ZSTD_freeDCtx);
  return context.get();
}

constexpr int kMaxWindowLog = 23;  // browsers refuse more
constexpr int kStoredLevel = 15;
constexpr std::size_t kStartChunkBytes = std::size_t{16} << 10;

}  // namespace

bool is_zstd_frame(ByteView bytes) {
  return bytes.size() >= 4 && bytes[0] == 0x28 && bytes[1] == 0xb5 && bytes[2] == 0x2f && bytes[3] == 0xfd;
}

Bytes zstd_compress(ByteView bytes, int level) {
  ZSTD_CCtx* context = compression_context();
  ZSTD_CCtx_reset(context, ZSTD_reset_session_and_parameters);
  ZSTD_CCtx_setParameter(context, ZSTD_c_compressionLevel, level);
  // The window never needs to exceed the content; the cap matters for large records only.
  if (bytes.size() > (std::size_t{1} << kMaxWindowLog)) {
    ZSTD_CCtx_setParameter(context, ZSTD_c_windowLog, kMaxWindowLog);
  }
  Bytes out(ZSTD_compressBound(bytes.size()));
  const std::size_t n = ZSTD_compress2(context, out.data(), out.size(), bytes.data(), bytes.size());
  assert(!ZSTD_isError(n));
  out.resize(n);
  return out;
}

Bytes pack_value(Bytes record) {
  Bytes frame = zstd_compress(record, kStoredLevel);
  return frame.size() < record.size() ? frame : record;
}

namespace {

Result<std::uint64_t> announced_bytes(ByteView frame) {
  const auto size = ZSTD_getFrameContentSize(frame.data(), frame.size());
  if (size == ZSTD_CONTENTSIZE_UNKNOWN || size == ZSTD_CONTENTSIZE_ERROR) {
    return fail(ErrorKind::kCorrupt, "zstd frame without a content size");
  }
  if (size > kMaxRecordBytes) return fail(ErrorKind::kCorrupt, "zstd frame announces more than 256 MiB");
  return size;
}

}  // namespace

Result<Bytes> unpack_value(ByteView value) {
  if (!is_zstd_frame(value)) return Bytes(value.begin(), value.end());
  const auto size = announced_bytes(value);
  if (!size) return tl::unexpected(size.error());
  Bytes out(*size);
  const std::size_t n =
      ZSTD_decompressDCtx(decompression_context(), out.data(), out.size(), value.data(), value.size());
  if (ZSTD_isError(n) || n != *size) return fail(ErrorKind::kCorrupt, "broken zstd frame");
  return out;
}

Result<Bytes> unpack_start(ByteView value, const EnoughBytes& enough) {
  if (!is_zstd_frame(value)) return Bytes(value.begin(), value.end());
  const auto size = announced_bytes(value);
  if (!size) return tl::unexpected(size.error());
  ZSTD_DCtx* context = decompression_context();
  ZSTD_DCtx_reset(context, ZSTD_reset_session_only);
  ZSTD_inBuffer in{value.data(), value.size(), 0};
  Bytes bytes;
  while (bytes.size() < *size) {
    const std::size_t had = bytes.size();
    bytes.resize(std::min<std::size_t>(*size, had + kStartChunkBytes));
    ZSTD_outBuffer out{bytes.data(), bytes.size(), had};
    while (out.pos < out.size) {
      const std::size_t in_before = in.pos, out_before = out.pos;
      const std::size_t n = ZSTD_decompressStream(context, &out, &in);
      if (ZSTD_isError(n) || (in.pos == in_before && out.pos == out_before)) {
        return fail(ErrorKind::kCorrupt, "broken zstd frame");
      }
    }
    if (enough(bytes, *size)) break;
  }
  return bytes;
}

}  // namespace tind
