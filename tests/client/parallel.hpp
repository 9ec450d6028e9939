// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <thread>
#include <vector>

namespace tind::client {

/// Calls work(k) for k in [0, n) from `n_threads` threads, small k first; returns when all are done. work must not
/// throw.
template <class Work>
void for_each_parallel(std::size_t n, unsigned n_threads, const Work& work) {
  std::atomic<std::size_t> next{0};
  const auto run = [&] {
    for (std::size_t k = next++; k < n; k = next++) work(k);
  };
  std::vector<std::jthread> others;
  for (unsigned t = 1; t < std::min<std::size_t>(n_threads, n); ++t) others.emplace_back(run);
  run();
}

}  // namespace tind::client
