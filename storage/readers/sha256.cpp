// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/sha256.hpp"

#include <array>
#include <new>

#include <openssl/evp.h>

namespace tind {

void Sha256::Free::operator()(evp_md_ctx_st* context) const { EVP_MD_CTX_free(context); }

Sha256::Sha256() : context_(EVP_MD_CTX_new()) {
  // Both fail only without memory: the digest itself is always built in.
  if (!context_ || EVP_DigestInit_ex(context_.get(), EVP_sha256(), nullptr) != 1) throw std::bad_alloc();
}

void Sha256::update(const void* data, std::size_t n_bytes) { EVP_DigestUpdate(context_.get(), data, n_bytes); }

std::string Sha256::finish_hex() {
  std::array<unsigned char, EVP_MAX_MD_SIZE> digest;
  unsigned int n_bytes = 0;
  EVP_DigestFinal_ex(context_.get(), digest.data(), &n_bytes);
  static constexpr char kHex[] = "0123456789abcdef";
  std::string hex;
  for (unsigned int i = 0; i < n_bytes; ++i) {
    hex += kHex[digest[i] >> 4];
    hex += kHex[digest[i] & 15];
  }
  return hex;
}

}  // namespace tind
