// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/resident_maps.hpp"

#include <cstdint>
#include <map>
#include <mutex>

#include <sys/mman.h>
#include <unistd.h>

namespace tind {
namespace {

struct Registry {
  std::mutex mutex;
  std::map<void*, std::size_t> n_bytes;  // by address
};

Registry& registry() {
  static Registry the_registry;
  return the_registry;
}

}  // namespace

void release_map(void* address, std::size_t n_bytes) {
  // A failure leaves the pages where they are: nothing is lost.
  if (address != nullptr) ::madvise(address, n_bytes, MADV_DONTNEED);
}

void release_pages_around(const void* address, std::size_t n_bytes) {
  const auto page = static_cast<std::uintptr_t>(::sysconf(_SC_PAGESIZE));
  const auto at = reinterpret_cast<std::uintptr_t>(address), begin = at / page * page;
  release_map(reinterpret_cast<void*>(begin), at + n_bytes - begin);
}

ResidentMap::ResidentMap(void* address, std::size_t n_bytes) : address_(address) {
  if (address == nullptr) return;
  Registry& all = registry();
  const std::scoped_lock lock(all.mutex);
  all.n_bytes.emplace(address, n_bytes);
}

ResidentMap::~ResidentMap() {
  if (address_ == nullptr) return;
  Registry& all = registry();
  const std::scoped_lock lock(all.mutex);
  all.n_bytes.erase(address_);
}

void release_resident_maps() {
  Registry& all = registry();
  const std::scoped_lock lock(all.mutex);
  for (const auto& [address, n_bytes] : all.n_bytes) release_map(address, n_bytes);
}

}  // namespace tind
