// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <array>
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
    std::array<std::uint8_t, kMaxVarintBytes> bytes;
    raw({bytes.data(), put_uvarint(bytes.data(), value)});
  }
  /// Zig-zag, then LEB128: 0, -1, 1, -2 become 0, 1, 2, 3.
  void svarint(std::int64_t value) { uvarint(zig_zag(value)); }
  /// svarints of many items: `put_item(item, put)` calls put(value) at most kMostEach times. A good deal faster than
  /// one by one.
  template <std::size_t kMostEach = 1, class Items, class PutItem>
  void svarints(const Items& items, PutItem put_item) {
    std::array<std::uint8_t, (256 + kMostEach) * kMaxVarintBytes> bytes;
    std::uint8_t* end = bytes.data();
    const std::uint8_t* const full = bytes.data() + bytes.size() - kMostEach * kMaxVarintBytes;
    const auto put = [&](std::int64_t value) { end = put_uvarint(end, zig_zag(value)); };
    for (const auto& item : items) {
      put_item(item, put);
      if (end <= full) continue;
      raw({bytes.data(), end});
      end = bytes.data();
    }
    raw({bytes.data(), end});
  }
  void raw(ByteView bytes) { bytes_.insert(bytes_.end(), bytes.begin(), bytes.end()); }

  void reserve(std::size_t n_bytes) { bytes_.reserve(n_bytes); }
  std::size_t size() const { return bytes_.size(); }
  const Bytes& bytes() const { return bytes_; }
  Bytes take() { return std::move(bytes_); }

 private:
  static constexpr std::size_t kMaxVarintBytes = 10;

  static std::uint64_t zig_zag(std::int64_t value) {
    return (static_cast<std::uint64_t>(value) << 1) ^ static_cast<std::uint64_t>(value >> 63);
  }
  // Writes at `to`, where there is room for kMaxVarintBytes, and returns the end.
  static std::uint8_t* put_uvarint(std::uint8_t* to, std::uint64_t value) {
    while (value >= 0x80) {
      *to++ = static_cast<std::uint8_t>(value | 0x80);
      value >>= 7;
    }
    *to++ = static_cast<std::uint8_t>(value);
    return to;
  }

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
    const Varint v = read_varint(at_, end_);
    if (!v.next) {
      set_failed();
      return 0;
    }
    at_ = v.next;
    return v.value;
  }
  std::int64_t svarint() { return un_zig_zag(uvarint()); }
  /// svarints for many items: `take_item(item, get)` calls get() for each of its numbers. A good deal faster than one
  /// by one; once a read has failed get() gives 0.
  template <class Items, class TakeItem>
  void svarints(Items& items, TakeItem take_item) {
    const std::uint8_t* at = at_;
    const std::uint8_t* const end = end_;
    bool ok = ok_;
    const auto get = [&] {
      const Varint v = read_varint(at, end);
      ok = ok && v.next;
      at = v.next ? v.next : end;
      return un_zig_zag(v.value);
    };
    for (auto& item : items) take_item(item, get);
    at_ = at;
    if (!ok) set_failed();
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
  // A number and where the next one starts; 0 and null when it is cut off or has more than 64 bits.
  struct Varint {
    std::uint64_t value;
    const std::uint8_t* next;
  };

  static Varint read_varint(const std::uint8_t* at, const std::uint8_t* end) {
    // Nearly all varints of a tile have one or two bytes.
    if (end - at >= 2) [[likely]] {
      const std::uint64_t first = at[0], second = at[1];
      if (first < 0x80) return {first, at + 1};
      if (second < 0x80) return {(first & 0x7f) | second << 7, at + 2};
    }
    return read_long_varint(at, end);
  }
  static Varint read_long_varint(const std::uint8_t* at, const std::uint8_t* end) {
    std::uint64_t value = 0;
    for (int shift = 0; shift < 64 && at != end; shift += 7) {
      const std::uint8_t byte = *at++;
      if (shift == 63 && byte > 1) break;
      value |= static_cast<std::uint64_t>(byte & 0x7f) << shift;
      if ((byte & 0x80) == 0) return {value, at};
    }
    return {0, nullptr};
  }
  static std::int64_t un_zig_zag(std::uint64_t v) {
    return static_cast<std::int64_t>(v >> 1) ^ -static_cast<std::int64_t>(v & 1);
  }

  const std::uint8_t* begin_;
  const std::uint8_t* at_;
  const std::uint8_t* end_;
  bool ok_ = true;
};

}  // namespace tind
