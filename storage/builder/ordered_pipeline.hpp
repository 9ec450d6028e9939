// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

namespace tind {

/// Runs `n` independent jobs on `n_threads` workers and hands their results over in order, so that what is written does not
/// depend on the number of threads. At most a few jobs a thread are in flight: memory is bounded by them.
/// `prepare(i) -> In` and `consume(i, Out&&) -> bool` run on the calling thread, `work(In&&) -> Out` on any. consume returns
/// false to stop early. Returns false iff stopped.
template <class In, class Out>
bool run_ordered(std::size_t n, int n_threads, const std::function<In(std::size_t)>& prepare,
                 const std::function<Out(In&&)>& work, const std::function<bool(std::size_t, Out&&)>& consume) {
  constexpr std::size_t kJobsPerThread = 8;
  struct Job {
    In in;
    std::optional<Out> out;
  };
  std::mutex mutex;
  std::condition_variable has_work, has_result;
  std::deque<Job*> waiting;
  std::deque<Job> flight;  // in order of i; references stay valid at both ends
  bool stop = false;

  std::vector<std::jthread> workers;
  for (int t = 0; t < n_threads; ++t) {
    workers.emplace_back([&] {
      std::unique_lock lock(mutex);
      for (;;) {
        has_work.wait(lock, [&] { return stop || !waiting.empty(); });
        if (stop) return;
        Job* job = waiting.front();
        waiting.pop_front();
        lock.unlock();
        Out out = work(std::move(job->in));
        lock.lock();
        job->out = std::move(out);
        has_result.notify_one();
      }
    });
  }
  const std::size_t most_in_flight = kJobsPerThread * static_cast<std::size_t>(n_threads);
  bool go_on = true;
  std::size_t next = 0;
  for (std::size_t i = 0; i < n && go_on; ++i) {
    for (; next < n && next < i + most_in_flight; ++next) {
      In in = prepare(next);
      const std::lock_guard lock(mutex);
      flight.push_back({std::move(in), std::nullopt});
      waiting.push_back(&flight.back());
      has_work.notify_one();
    }
    std::unique_lock lock(mutex);
    has_result.wait(lock, [&] { return flight.front().out.has_value(); });
    Out out = std::move(*flight.front().out);
    flight.pop_front();
    lock.unlock();
    go_on = consume(i, std::move(out));
  }
  {
    const std::lock_guard lock(mutex);
    stop = true;
  }
  has_work.notify_all();
  return go_on;
}

}  // namespace tind
