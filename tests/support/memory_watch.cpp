// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/support/memory_watch.hpp"

#include <atomic>
#include <cstdlib>
#include <new>
#include <utility>

#include <malloc.h>

namespace {

// Threads may ask, too; what is measured meanwhile means nothing.
std::atomic<std::size_t> g_largest_request = 0, g_held_bytes = 0, g_most_held_bytes = 0;

void raise_to(std::atomic<std::size_t>& most, std::size_t value) noexcept {
  if (value > most.load(std::memory_order_relaxed)) most.store(value, std::memory_order_relaxed);
}

void* take(std::size_t n) noexcept {
  raise_to(g_largest_request, n);
  void* const p = std::malloc(n);
  if (p != nullptr) g_held_bytes.fetch_add(::malloc_usable_size(p), std::memory_order_relaxed);
  raise_to(g_most_held_bytes, g_held_bytes.load(std::memory_order_relaxed));
  return p;
}

void give_back(void* p) noexcept {
  if (p != nullptr) g_held_bytes.fetch_sub(::malloc_usable_size(p), std::memory_order_relaxed);
  std::free(p);
}

}  // namespace

void* operator new(std::size_t n) {
  if (void* p = take(n)) return p;
  throw std::bad_alloc();
}
// std::stable_sort asks this way; its memory must go the way of ours under AddressSanitizer.
void* operator new(std::size_t n, const std::nothrow_t&) noexcept { return take(n); }
void operator delete(void* p) noexcept { give_back(p); }
void operator delete(void* p, std::size_t) noexcept { give_back(p); }

namespace tind::test {

std::size_t largest_request() { return g_largest_request; }
void reset_largest_request() { g_largest_request = 0; }

std::size_t held_bytes() { return g_held_bytes; }
std::size_t most_held_bytes() { return g_most_held_bytes; }
void reset_most_held_bytes() { g_most_held_bytes = g_held_bytes.load(); }

UncountedMemory::~UncountedMemory() {
  while (first_ != nullptr) std::free(std::exchange(first_, first_->next));
}

void* UncountedMemory::take(std::size_t n_bytes) {
  constexpr std::size_t kHead = 16;  // keeps what follows aligned
  auto* const block = static_cast<Block*>(std::malloc(kHead + n_bytes));
  if (block == nullptr) return nullptr;
  block->next = std::exchange(first_, block);
  n_bytes_ += n_bytes;
  return reinterpret_cast<char*>(block) + kHead;
}

}  // namespace tind::test
