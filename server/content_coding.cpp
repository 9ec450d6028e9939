// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/content_coding.hpp"

#include <zlib.h>

#include <limits>

#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// Answers are packed while the client waits: levels where time still buys size.
constexpr int kZstdLevel = 5;
constexpr int kGzipLevel = 5;
constexpr int kGzipWindowBits = 15 + 16;  // zlib's way to say: with a gzip header
constexpr int kMemoryLevel = 8;

// Empty on failure.
Bytes gzip(const Bytes& bytes) {
  z_stream stream{};
  if (bytes.size() > std::numeric_limits<uInt>::max() / 2) return {};
  if (deflateInit2(&stream, kGzipLevel, Z_DEFLATED, kGzipWindowBits, kMemoryLevel, Z_DEFAULT_STRATEGY) != Z_OK)
    return {};
  Bytes out(deflateBound(&stream, static_cast<uLong>(bytes.size())));
  stream.next_in = const_cast<Bytef*>(bytes.data());
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = out.data();
  stream.avail_out = static_cast<uInt>(out.size());
  const int status = deflate(&stream, Z_FINISH);
  out.resize(status == Z_STREAM_END ? out.size() - stream.avail_out : 0);
  deflateEnd(&stream);
  return out;
}

}  // namespace

Coded apply_coding(Bytes bytes, Coding wanted) {
  if (wanted != Coding::kIdentity) {
    Bytes packed = wanted == Coding::kZstd ? zstd_compress(bytes, kZstdLevel) : gzip(bytes);
    if (!packed.empty() && packed.size() < bytes.size()) return {std::move(packed), wanted};
  }
  return {std::move(bytes), Coding::kIdentity};
}

const char* coding_name(Coding coding) {
  return coding == Coding::kZstd ? "zstd" : coding == Coding::kGzip ? "gzip" : "";
}

}  // namespace tind
