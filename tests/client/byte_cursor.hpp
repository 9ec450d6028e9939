// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <string>
#include <tl/expected.hpp>
#include <type_traits>
#include <utility>
#include <vector>

namespace tind::client {

using Blob = std::vector<std::uint8_t>;
using BlobView = std::span<const std::uint8_t>;

/// A value, or one line that says why there is none.
template <class T>
using Outcome = tl::expected<T, std::string>;

inline tl::unexpected<std::string> refuse(std::string why) { return tl::unexpected<std::string>(std::move(why)); }

/// Walks over little-endian bytes. The first read past the end, or of a malformed number, sets bad() for good; from
/// then on every read gives 0. Never reads outside the bytes, which it does not own.
class ByteCursor {
 public:
  explicit ByteCursor(BlobView bytes) : bytes_(bytes) {}

  template <class T>
  T take() {
    static_assert(std::is_arithmetic_v<T>);
    T value{};
    if (const std::uint8_t* from = advance(sizeof(T))) std::memcpy(&value, from, sizeof(T));
    return value;
  }
  /// Unsigned LEB128 of at most 64 bits.
  std::uint64_t take_unsigned() {
    std::uint64_t value = 0;
    for (unsigned shift = 0;; shift += 7) {
      const std::uint8_t* byte = advance(1);
      if (byte == nullptr) return 0;
      const std::uint64_t seven = *byte & 0x7fu;
      if (shift > 63 || (shift == 63 && seven > 1)) {
        bad_ = true;
        return 0;
      }
      value |= seven << shift;
      if (*byte < 0x80) return value;
    }
  }
  /// Zig-zagged LEB128.
  std::int64_t take_signed() {
    const std::uint64_t v = take_unsigned();
    return (v & 1) != 0 ? static_cast<std::int64_t>(~(v >> 1)) : static_cast<std::int64_t>(v >> 1);
  }
  BlobView take_bytes(std::size_t n) {
    const std::uint8_t* from = advance(n);
    return from == nullptr ? BlobView{} : BlobView(from, n);
  }
  /// Announces that `n` things of at least `bytes_each` follow: bad() when the rest cannot hold them.
  bool expect(std::uint64_t n, std::uint64_t bytes_each) {
    if (bad_ || n > left() / bytes_each) bad_ = true;
    return !bad_;
  }

  bool bad() const { return bad_; }
  std::size_t left() const { return bytes_.size() - at_; }
  std::size_t at() const { return at_; }

 private:
  const std::uint8_t* advance(std::size_t n) {
    if (bad_ || left() < n) {
      bad_ = true;
      return nullptr;
    }
    const std::uint8_t* from = bytes_.data() + at_;
    at_ += n;
    return from;
  }

  BlobView bytes_;
  std::size_t at_ = 0;
  bool bad_ = false;
};

}  // namespace tind::client
