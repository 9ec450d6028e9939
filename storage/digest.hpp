// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>

struct XXH3_state_s;

namespace tind {

/// 128-bit XXH3: tells inputs apart at the speed of memory; no defence against forgery. One thread.
class Digest {
 public:
  Digest();
  void add(const void* data, std::size_t n_bytes);
  /// A number, by its bytes.
  template <class T>
  void add_value(T value) {
    add(&value, sizeof value);
  }
  /// Of all that was added, in canonical (big-endian) order.
  std::array<std::uint8_t, 16> finish() const;

 private:
  struct Free {
    void operator()(XXH3_state_s* state) const;
  };
  std::unique_ptr<XXH3_state_s, Free> state_;
};

/// Digest of one stretch of bytes. Pure, thread safe.
std::array<std::uint8_t, 16> digest_of_bytes(const void* data, std::size_t n_bytes);

}  // namespace tind
