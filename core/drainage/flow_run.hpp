// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace tind {

/// Gives memory (not owned by the taker, alive until the call it is given to returns, contents arbitrary, aligned for
/// doubles), or null when there is none. A mapped scratch file keeps rasters larger than memory possible.
using ScratchAllocator = std::function<void*(std::size_t n_bytes)>;

/// How the steps of the analysis are carried out. Changes no result, except that a step leaves its output unfinished
/// once `cancel` is set: whoever sets it looks no further.
struct FlowRun {
  int threads = 1;                            ///< At least 1.
  const std::atomic<bool>* cancel = nullptr;  ///< Looked at many times a second; may be null.
  /// Called on the calling thread with the share of the step that is done, in [0, 1]; may be empty.
  std::function<void(double)> progress;
  /// Called on every thread before each of its jobs, and in long loops of one thread: a moment to give memory back. May
  /// be empty; thread safe.
  std::function<void()> before_job{};

  /// The same without progress.
  FlowRun quiet() const {
    FlowRun run = *this;
    run.progress = nullptr;
    return run;
  }
  void pause() const {
    if (before_job) before_job();
  }
  bool stopped() const { return cancel != nullptr && cancel->load(std::memory_order_relaxed); }
  void report(std::int64_t done, std::int64_t of) const {
    if (progress) progress(static_cast<double>(done) / static_cast<double>(std::max<std::int64_t>(of, 1)));
  }
};

/// Calls f(worker, job) for the jobs 0..n-1, each once, on up to `run.threads` threads of which the calling one is
/// worker 0. No job is begun once the run is stopped. The first exception of a job reaches the caller when all threads
/// are done.
template <class F>
void for_each_job(const FlowRun& run, std::int64_t n, F&& f) {
  std::atomic<std::int64_t> next{0};
  std::mutex mutex;
  std::exception_ptr failure;
  const auto work = [&](int worker) {
    try {
      for (std::int64_t job = next++; job < n && !run.stopped(); job = next++) {
        run.pause();
        f(worker, job);
      }
    } catch (...) {
      next = n;
      const std::lock_guard lock(mutex);
      if (!failure) failure = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> others;
    for (int worker = 1; worker < run.threads && worker < n; ++worker) others.emplace_back(work, worker);
    work(0);
  }
  if (failure) std::rethrow_exception(failure);
}

/// Rows that one job of for_row_bands has.
inline constexpr std::int64_t kBandRows = 32;

/// Calls f(row_begin, row_end) for bands of rows, on any thread: first for every other band, then for those between, so
/// that a band may read the rows beside it while it writes its own.
template <class F>
void for_row_bands(const FlowRun& run, std::int64_t n_rows, F&& f) {
  const std::int64_t n_bands = (n_rows + kBandRows - 1) / kBandRows;
  for (const std::int64_t parity : {0, 1}) {
    const std::int64_t n = (n_bands + 1 - parity) / 2;
    for_each_job(run, n, [&](int worker, std::int64_t job) {
      const std::int64_t begin = (2 * job + parity) * kBandRows;
      f(begin, std::min(n_rows, begin + kBandRows));
      if (worker == 0 && job % 8 == 0) run.report(parity * n + job, 2 * n);
    });
  }
}

}  // namespace tind
