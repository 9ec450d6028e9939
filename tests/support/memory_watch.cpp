// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/support/memory_watch.hpp"

#include <algorithm>
#include <cstdlib>
#include <new>

namespace {

std::size_t g_largest_request = 0;

}  // namespace

void* operator new(std::size_t n) {
  g_largest_request = std::max(g_largest_request, n);
  if (void* p = std::malloc(n)) return p;
  throw std::bad_alloc();
}
// std::stable_sort asks this way; its memory must go the way of ours under AddressSanitizer.
void* operator new(std::size_t n, const std::nothrow_t&) noexcept {
  g_largest_request = std::max(g_largest_request, n);
  return std::malloc(n);
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }

namespace tind::test {

std::size_t largest_request() { return g_largest_request; }
void reset_largest_request() { g_largest_request = 0; }

}  // namespace tind::test
