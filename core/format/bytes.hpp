// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <span>
#include <type_traits>
#include <vector>

namespace tind {

using Bytes = std::vector<std::uint8_t>;
using ByteView = std::span<const std::uint8_t>;

static_assert(std::endian::native == std::endian::little, "tind writes little-endian by copying");

/// Appends little-endian values and LEB128 varints to a byte vector.
class ByteWriter {
 public:
  template <class T>
  requires std::is_arithmetic_v<T>
  void fixed(T value) {
    const auto at = bytes_.size();
    bytes_.resize(at + sizeof(T));
    std::memcpy(bytes_.data() + at, &value, sizeof(T));
  }
  /// Unsigned LEB128: 7 bits a byte, low bits first, at most 10 bytes.
  void uvarint(std::uint64_t value) {
    while (value >= 0x80) {
      bytes_.push_back(static_cast<std::uint8_t>(value | 0x80));
      value >>= 7;
    }
    bytes_.push_back(static_cast<std::uint8_t>(value));
  }
  /// Zig-zag, then LEB128: 0, -1, 1, -2 become 0, 1, 2, 3.
  void svarint(std::int64_t value) {
    uvarint((static_cast<std::uint64_t>(value) << 1) ^ static_cast<std::uint64_t>(value >> 63));
  }
  void raw(ByteView bytes) { bytes_.insert(bytes_.end(), bytes.begin(), bytes.end()); }

  std::size_t size() const { return bytes_.size(); }
  const Bytes& bytes() const { return bytes_; }
  Bytes take() { return std::move(bytes_); }

 private:
  Bytes bytes_;
};

/// Reads what ByteWriter wrote. Every read is bounds-checked; the first failure sticks (ok() turns false) and all later
/// reads give 0. Safe for untrusted input. Does not own the bytes.
class ByteReader {
 public:
  explicit ByteReader(ByteView bytes) : begin_(bytes.data()), at_(bytes.data()), end_(bytes.data() + bytes.size()) {}

  template <class T>
  requires std::is_arithmetic_v<T> T fixed() {
    T value{};
    if (remaining() < sizeof(T)) {
      set_failed();
      return value;
    }
    std::memcpy(&value, at_, sizeof(T));
    at_ += sizeof(T);
    return value;
  }
  std::uint64_t uvarint() {
    // Nearly all varints of a tile have one or two bytes.
    if (remaining() >= 2) [[likely]] {
      const std::uint64_t first = at_[0], second = at_[1];
      if (first < 0x80) {
        at_ += 1;
        return first;
      }
      if (second < 0x80) {
        at_ += 2;
        return (first & 0x7f) | second << 7;
      }
    }
    return long_uvarint();
  }
  std::int64_t svarint() {
    const std::uint64_t v = uvarint();
    return static_cast<std::int64_t>(v >> 1) ^ -static_cast<std::int64_t>(v & 1);
  }
  /// A count of items that take at least `min_bytes_each` more bytes: fails, instead of asking for memory, when the
  /// bytes that are left cannot hold them.
  std::uint64_t count(std::uint64_t min_bytes_each) {
    const std::uint64_t n = uvarint();
    if (min_bytes_each != 0 && n > remaining() / min_bytes_each) set_failed();
    return ok_ ? n : 0;
  }
  ByteView raw(std::size_t n) {
    if (!ok_ || remaining() < n) {
      set_failed();
      return {};
    }
    const ByteView view(at_, n);
    at_ += n;
    return view;
  }

  bool ok() const { return ok_; }
  /// Nothing is left to read from a reader that failed, so reads need not ask for more than their bounds.
  void set_failed() {
    ok_ = false;
    at_ = end_;
  }
  std::size_t remaining() const { return static_cast<std::size_t>(end_ - at_); }
  /// Bytes read so far; after a failure, all of them.
  std::size_t position() const { return static_cast<std::size_t>(at_ - begin_); }
  /// True iff nothing failed and every byte was read.
  bool finished() const { return ok_ && at_ == end_; }

 private:
  std::uint64_t long_uvarint() {
    std::uint64_t value = 0;
    for (int shift = 0; shift < 64; shift += 7) {
      if (at_ == end_) break;
      const std::uint8_t byte = *at_++;
      if (shift == 63 && byte > 1) break;  // more than 64 bits
      value |= static_cast<std::uint64_t>(byte & 0x7f) << shift;
      if ((byte & 0x80) == 0) return value;
    }
    set_failed();
    return 0;
  }

  const std::uint8_t* begin_;
  const std::uint8_t* at_;
  const std::uint8_t* end_;
  bool ok_ = true;
};

}  // namespace tind
