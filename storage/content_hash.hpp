// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

#include "core/format/bytes.hpp"
#include "core/format/fnv1a.hpp"
#include "storage/digest.hpp"

namespace tind {

/// The manifest's content_hash (docs/format.md 9): of the keys and values of all pieces but kInputs, in the file's
/// order. One thread.
class ContentHash {
 public:
  enum class Kind {
    kXxh3,   ///< 128-bit XXH3: 32 hexadecimal digits.
    kFnv1a,  ///< 64-bit FNV-1a: 16 hexadecimal digits; of files from before 0.6.0.
  };
  /// The kind that makes texts such as this one; kXxh3 where none does.
  static Kind kind_of(std::string_view text);

  explicit ContentHash(Kind kind) : kind_(kind) {}
  /// What kXxh3 takes for a value. Pure, thread safe.
  using ValueDigest = std::array<std::uint8_t, 16>;
  static ValueDigest digest_of(ByteView value);

  /// The next piece. kXxh3 is the hash of keys and values' digests, kFnv1a of keys and values.
  void add(ByteView key, ByteView value);
  /// The same by the value's digest. Precondition: kXxh3.
  void add(ByteView key, const ValueDigest& value);
  /// Of all that was added, as lower-case hexadecimal digits.
  std::string hex() const;

 private:
  Kind kind_;
  Fnv1a old_;
  Digest digest_;
};

}  // namespace tind
