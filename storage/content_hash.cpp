// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/content_hash.hpp"

namespace tind {
namespace {

constexpr std::size_t kFnv1aDigits = 16;

}  // namespace

ContentHash::Kind ContentHash::kind_of(std::string_view text) {
  return text.size() == kFnv1aDigits ? Kind::kFnv1a : Kind::kXxh3;
}

void ContentHash::add(ByteView bytes) {
  if (kind_ == Kind::kFnv1a) {
    old_.add(bytes);
  } else {
    digest_.add(bytes.data(), bytes.size());
  }
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
