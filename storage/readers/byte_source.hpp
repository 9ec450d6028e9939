// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "core/result.hpp"

namespace tind {

/// Random access to the bytes of a file (or of a test's memory). One thread at a time.
class ByteSource {
 public:
  virtual ~ByteSource() = default;
  virtual std::uint64_t size() const = 0;
  /// Fills all of `to` from `offset` on; false when the source ends before that or cannot be read.
  virtual bool read(std::uint64_t offset, std::span<std::uint8_t> to) = 0;
};

/// A file by any name that GDAL opens (/vsizip/... too). kInvalidInput: no such file, a folder, empty, or not readable.
Result<std::unique_ptr<ByteSource>> open_bytes(const std::string& path);

/// SHA-256 of all bytes, lower-case hex. kIo: a read failed.
Result<std::string> sha256_of(ByteSource& bytes, const std::string& path);

}  // namespace tind
