// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string_view>

#include "server/content_coding.hpp"

namespace tind {

/// What a finished answer is of.
struct CacheKey {
  std::uint64_t source = 0;          ///< The dataset's id, or a hash that stands for a document or file.
  std::uint64_t tile = 0;            ///< Level, x and y in one number; 0 for documents.
  std::uint32_t representation = 0;  ///< Format and coding.
  friend bool operator==(const CacheKey&, const CacheKey&) = default;
};

/// What of a finished answer does not depend on who asks, before it is in one piece. Views.
struct AnswerParts {
  std::string_view content_fields;    ///< Header lines of a 200 only.
  std::string_view validator_fields;  ///< Those that a 304 has, too, with `etag` in them.
  std::string_view etag;
  Coding coding = Coding::kIdentity;
  ByteView body;
};

class CacheSegment;

/// A finished answer in one piece of memory: this, and behind it content fields, validator fields and body. Nothing but
/// `used` changes.
struct CacheBlock {
  CacheKey key;
  std::uint32_t n_content, n_fields, etag_at, n_etag;
  Coding coding;
  mutable std::atomic<bool> used;  ///< Asked for since it came to its place.
  CacheSegment* segment;           ///< nullptr: in memory of its own.
  std::size_t n_body;

  /// The memory that make() wants: whole lines of the processor's cache.
  static std::size_t bytes_for(const AnswerParts& parts);
  static CacheBlock& make(void* memory, const CacheKey& key, const AnswerParts& parts, CacheSegment* segment);
  std::size_t n_bytes() const;
  const char* text() const { return reinterpret_cast<const char*>(this + 1); }
  AnswerParts parts() const;
};

/// Blocks one behind the other in a stretch of memory that may be huge pages. Filled by one thread at a time; held by
/// whoever reads a block of it.
class CacheSegment : public std::enable_shared_from_this<CacheSegment> {
 public:
  static constexpr std::size_t kPageBytes = 4096, kHugePageBytes = std::size_t{2} << 20;

  /// `n_bytes`: whole pages. nullptr when the system gives no memory.
  static std::shared_ptr<CacheSegment> make(std::size_t n_bytes);
  CacheSegment(std::uint8_t* mapped, std::size_t n_bytes) : begin_(mapped), n_bytes_(n_bytes) {}
  ~CacheSegment();
  CacheSegment(const CacheSegment&) = delete;
  CacheSegment& operator=(const CacheSegment&) = delete;

  std::size_t n_bytes() const { return n_bytes_; }
  std::size_t n_free() const { return n_bytes_ - n_filled_; }
  /// Precondition: n_free() >= CacheBlock::bytes_for(parts).
  CacheBlock& add(const CacheKey& key, const AnswerParts& parts);
  template <class Use>
  void for_each_block(Use&& use) const {
    for (std::size_t at = 0; at < n_filled_;) {
      const auto& block = *reinterpret_cast<const CacheBlock*>(begin_ + at);
      at += block.n_bytes();
      use(block);
    }
  }

 private:
  std::uint8_t* begin_;
  std::size_t n_bytes_, n_filled_ = 0;
};

}  // namespace tind
