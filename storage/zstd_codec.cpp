// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/zstd_codec.hpp"

#include <zstd.h>

#include <algorithm>
#include <memory>
#include <new>

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
// No frame is shorter: magic, descriptor, content size, header of a block, one byte.
constexpr std::size_t kLeastFrameBytes = 10;
constexpr std::size_t kMostBlockBytes = std::size_t{128} << 10;

// One frame. The level or the like is set in `context` already, and nothing is begun there.
Bytes compress(ZSTD_CCtx* context, ByteView bytes, std::span<const std::size_t> section_ends) {
  // The window never needs to exceed the content; the cap matters for large records only.
  if (bytes.size() > (std::size_t{1} << kMaxWindowLog)) {
    ZSTD_CCtx_setParameter(context, ZSTD_c_windowLog, kMaxWindowLog);
  }
  ZSTD_CCtx_setPledgedSrcSize(context, bytes.size());
  // Kept from record to record: most of a bound is not needed in the end. A flushed block may need a header more.
  thread_local Bytes frame;
  const std::size_t bound = ZSTD_compressBound(bytes.size()) + 16 * section_ends.size();
  if (frame.size() < bound) frame.resize(bound);
  ZSTD_outBuffer out{frame.data(), frame.size(), 0};
  ZSTD_inBuffer in{bytes.data(), 0, 0};
  for (std::size_t k = 0; k <= section_ends.size(); ++k) {
    const bool is_last = k == section_ends.size();
    in.size = is_last ? bytes.size() : section_ends[k];
    std::size_t left = 0;
    do {
      left = ZSTD_compressStream2(context, &out, &in, is_last ? ZSTD_e_end : ZSTD_e_flush);
      if (ZSTD_isError(left)) throw std::bad_alloc();  // with room and valid parameters zstd lacks nothing but memory
    } while (left > 0);
  }
  return {frame.begin(), frame.begin() + static_cast<std::ptrdiff_t>(out.pos)};
}

}  // namespace

bool is_zstd_frame(ByteView bytes) {
  return bytes.size() >= 4 && bytes[0] == 0x28 && bytes[1] == 0xb5 && bytes[2] == 0x2f && bytes[3] == 0xfd;
}

Bytes zstd_compress(ByteView bytes, int level) {
  ZSTD_CCtx* context = compression_context();
  ZSTD_CCtx_reset(context, ZSTD_reset_session_and_parameters);
  ZSTD_CCtx_setParameter(context, ZSTD_c_compressionLevel, level);
  return compress(context, bytes, {});
}

Bytes pack_value(Bytes record, std::span<const std::size_t> section_ends) {
  if (record.size() <= kLeastFrameBytes) return record;
  ZSTD_CCtx* context = compression_context();
  ZSTD_CCtx_reset(context, ZSTD_reset_session_and_parameters);
  // docs/decisions/0012-compression.md
  ZSTD_CCtx_setParameter(context, ZSTD_c_strategy, ZSTD_dfast);
  ZSTD_CCtx_setParameter(context, ZSTD_c_minMatch, 5);
  ZSTD_CCtx_setParameter(context, ZSTD_c_hashLog, 17);
  ZSTD_CCtx_setParameter(context, ZSTD_c_chainLog, 17);
  Bytes frame = compress(context, record, section_ends);
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
  ZSTD_inBuffer in{value.data(), 0, 0};
  Bytes bytes;
  ZSTD_outBuffer out{nullptr, 0, 0};
  // zstd unpacks as many blocks as it is given, so it gets what it asks for: the rest of one block.
  std::size_t wish = kLeastFrameBytes;
  while (true) {
    in.size = std::min(value.size(), in.pos + wish);
    bytes.resize(std::min<std::size_t>(*size, out.pos + kMostBlockBytes));
    out.dst = bytes.data();
    out.size = bytes.size();
    const std::size_t in_before = in.pos, out_before = out.pos;
    wish = ZSTD_decompressStream(context, &out, &in);
    if (ZSTD_isError(wish)) return fail(ErrorKind::kCorrupt, "broken zstd frame");
    if (out.pos > out_before && enough(ByteView(bytes).first(out.pos), *size)) break;
    if (wish == 0) {
      if (out.pos != *size) return fail(ErrorKind::kCorrupt, "broken zstd frame");
      break;
    }
    if (in.pos == in_before && out.pos == out_before) return fail(ErrorKind::kCorrupt, "broken zstd frame");
  }
  bytes.resize(out.pos);
  return bytes;
}

}  // namespace tind
