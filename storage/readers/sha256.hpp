// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <memory>
#include <string>

struct evp_md_ctx_st;  // OpenSSL's EVP_MD_CTX

namespace tind {

/// SHA-256 (FIPS 180-4) of a stream of bytes. The one door to OpenSSL. One thread at a time.
class Sha256 {
 public:
  Sha256();
  void update(const void* data, std::size_t n_bytes);
  /// Lower-case hex of all bytes so far; the object is used up afterwards.
  std::string finish_hex();

 private:
  struct Free {
    void operator()(evp_md_ctx_st* context) const;
  };
  std::unique_ptr<evp_md_ctx_st, Free> context_;
};

}  // namespace tind
