// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/digest.hpp"

#include <xxhash.h>

#include <algorithm>
#include <new>

namespace tind {
namespace {

std::array<std::uint8_t, 16> canonical_of(XXH128_hash_t hash) {
  XXH128_canonical_t canonical;
  XXH128_canonicalFromHash(&canonical, hash);
  std::array<std::uint8_t, 16> bytes{};
  std::copy(std::begin(canonical.digest), std::end(canonical.digest), bytes.begin());
  return bytes;
}

}  // namespace

void Digest::Free::operator()(XXH3_state_s* state) const { XXH3_freeState(state); }

Digest::Digest() : state_(XXH3_createState()) {
  if (!state_) throw std::bad_alloc();
  XXH3_128bits_reset(state_.get());
}

void Digest::add(const void* data, std::size_t n_bytes) { XXH3_128bits_update(state_.get(), data, n_bytes); }

std::array<std::uint8_t, 16> Digest::finish() const { return canonical_of(XXH3_128bits_digest(state_.get())); }

std::array<std::uint8_t, 16> digest_of_bytes(const void* data, std::size_t n_bytes) {
  return canonical_of(XXH3_128bits(data, n_bytes));
}

}  // namespace tind
