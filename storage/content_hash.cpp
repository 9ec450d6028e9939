// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/content_hash.hpp"

namespace tind {
namespace {

constexpr std::size_t kFnv1aDigits = 16;

}  // namespace

ContentHash::Kind ContentHash::kind_of(std::string_view text) {
  return text.size() == kFnv1aDigits ? Kind::kFnv1a : Kind::kXxh3;
}

ContentHash::ValueDigest ContentHash::digest_of(ByteView value) { return digest_of_bytes(value.data(), value.size()); }

void ContentHash::add(ByteView key, ByteView value) {
  if (kind_ != Kind::kFnv1a) return add(key, digest_of(value));
  old_.add(key);
  old_.add(value);
}

void ContentHash::add(ByteView key, const ValueDigest& value) {
  digest_.add(key.data(), key.size());
  digest_.add(value.data(), value.size());
}

std::string ContentHash::hex() const {
  if (kind_ == Kind::kFnv1a) return old_.hex();
  std::string digits;
  for (const std::uint8_t byte : digest_.finish()) {
    digits += "0123456789abcdef"[byte >> 4];
    digits += "0123456789abcdef"[byte & 15];
  }
  return digits;
}

}  // namespace tind
