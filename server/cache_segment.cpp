// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/cache_segment.hpp"

#include <sys/mman.h>

#include <algorithm>
#include <cassert>
#include <new>

namespace tind {
namespace {

constexpr std::size_t kLineBytes = 64;

std::size_t round_up(std::size_t n, std::size_t step) { return (n + step - 1) / step * step; }

}  // namespace

std::size_t CacheBlock::bytes_for(const AnswerParts& parts) {
  const std::size_t n_fields = parts.content_fields.size() + parts.validator_fields.size();
  return round_up(sizeof(CacheBlock) + n_fields + parts.body.size(), kLineBytes);
}

std::size_t CacheBlock::n_bytes() const { return round_up(sizeof(CacheBlock) + n_fields + n_body, kLineBytes); }

CacheBlock& CacheBlock::make(void* memory, const CacheKey& key, const AnswerParts& parts, CacheSegment* segment) {
  const std::size_t etag_at = parts.validator_fields.find(parts.etag);
  assert(etag_at != parts.validator_fields.npos);
  const auto n_content = static_cast<std::uint32_t>(parts.content_fields.size());
  auto* const block =
      new (memory) CacheBlock{.key = key,
                              .n_content = n_content,
                              .n_fields = n_content + static_cast<std::uint32_t>(parts.validator_fields.size()),
                              .etag_at = n_content + static_cast<std::uint32_t>(etag_at),
                              .n_etag = static_cast<std::uint32_t>(parts.etag.size()),
                              .coding = parts.coding,
                              .used = false,
                              .segment = segment,
                              .n_body = parts.body.size()};
  char* to = reinterpret_cast<char*>(block + 1);
  to = std::copy(parts.content_fields.begin(), parts.content_fields.end(), to);
  to = std::copy(parts.validator_fields.begin(), parts.validator_fields.end(), to);
  std::copy(parts.body.begin(), parts.body.end(), to);
  return *block;
}

AnswerParts CacheBlock::parts() const {
  return {{text(), n_content},
          {text() + n_content, n_fields - n_content},
          {text() + etag_at, n_etag},
          coding,
          {reinterpret_cast<const std::uint8_t*>(text()) + n_fields, n_body}};
}

std::shared_ptr<CacheSegment> CacheSegment::make(std::size_t n_bytes) {
  // Huge pages lie at multiples of their size: so much more is mapped that there is one, and the rest given back.
  const std::size_t slack = n_bytes >= kHugePageBytes ? kHugePageBytes - kPageBytes : 0;
  void* const mapped = ::mmap(nullptr, n_bytes + slack, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (mapped == MAP_FAILED) return nullptr;
  auto* begin = static_cast<std::uint8_t*>(mapped);
  if (slack > 0) {
    const auto address = reinterpret_cast<std::uintptr_t>(begin);
    const std::size_t before = round_up(address, kHugePageBytes) - address;
    if (before > 0) ::munmap(begin, before);
    if (before < slack) ::munmap(begin + before + n_bytes, slack - before);
    begin += before;
    ::madvise(begin, n_bytes, MADV_HUGEPAGE);  // where the system has none, small pages do
  }
  return std::make_shared<CacheSegment>(begin, n_bytes);
}

CacheSegment::~CacheSegment() { ::munmap(begin_, n_bytes_); }

CacheBlock& CacheSegment::add(const CacheKey& key, const AnswerParts& parts) {
  CacheBlock& block = CacheBlock::make(begin_ + n_filled_, key, parts, this);
  n_filled_ += block.n_bytes();
  return block;
}

}  // namespace tind
