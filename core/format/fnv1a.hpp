// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <string>

#include "core/format/bytes.hpp"

namespace tind {

/// 64-bit FNV-1a (draft-eastlake-fnv): tells versions of data apart; no defence against forgery.
class Fnv1a {
 public:
  void add(ByteView bytes) {
    for (const std::uint8_t byte : bytes) hash_ = (hash_ ^ byte) * 0x100000001b3ull;
  }
  /// 16 lower-case hexadecimal digits.
  std::string hex() const {
    std::string digits(16, '0');
    for (std::size_t k = 0; k < digits.size(); ++k) digits[k] = "0123456789abcdef"[(hash_ >> (60 - 4 * k)) & 15];
    return digits;
  }

 private:
  std::uint64_t hash_ = 0xcbf29ce484222325ull;
};

}  // namespace tind
