// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <exception>
#include <functional>
#include <mutex>
#include <optional>
#include <thread>
#include <vector>

namespace tind {

/// Runs `n` independent jobs on `n_threads` workers and hands their results over in order, so that what is written does
/// not depend on the number of threads. At most a few jobs a thread are in flight: memory is bounded by them.
/// `prepare(i) -> In` and `consume(i, Out&&) -> bool` run on the calling thread, `work(In&&) -> Out` on any. consume
/// returns false to stop early. Returns false iff stopped. An exception of any of the three ends the run and reaches
/// the caller.
template <class In, class Out>
bool run_ordered(std::size_t n, int n_threads, const std::function<In(std::size_t)>& prepare,
                 const std::function<Out(In&&)>& work, const std::function<bool(std::size_t, Out&&)>& consume) {
  constexpr std::size_t kJobsPerThread = 8;
  struct Job {
    In in;
    std::optional<Out> out;
    std::exception_ptr failure;
    bool done = false;
  };
  std::mutex mutex;
  std::condition_variable has_work, has_result;
  std::deque<Job*> waiting;
  std::deque<Job> flight;  // in order of i; references stay valid at both ends
  bool stop = false;

  std::vector<std::jthread> workers;
  // However this function is left, the workers are told before they are joined.
  struct Stopper {
    std::mutex& mutex;
    std::condition_variable& has_work;
    bool& stop;
    ~Stopper() {
      {
        const std::lock_guard lock(mutex);
        stop = true;
      }
      has_work.notify_all();
    }
  } const stopper{mutex, has_work, stop};
  for (int t = 0; t < n_threads; ++t) {
    workers.emplace_back([&] {
      std::unique_lock lock(mutex);
      for (;;) {
        has_work.wait(lock, [&] { return stop || !waiting.empty(); });
        if (stop) return;
        Job* job = waiting.front();
        waiting.pop_front();
        lock.unlock();
        std::optional<Out> out;
        std::exception_ptr failure;
        try {
          out = work(std::move(job->in));
        } catch (...) {
          failure = std::current_exception();
        }
        lock.lock();
        job->out = std::move(out);
        job->failure = failure;
        job->done = true;
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
      flight.push_back({std::move(in), std::nullopt, nullptr, false});
      waiting.push_back(&flight.back());
      has_work.notify_one();
    }
    std::unique_lock lock(mutex);
    has_result.wait(lock, [&] { return flight.front().done; });
    if (flight.front().failure) std::rethrow_exception(flight.front().failure);
    Out out = std::move(*flight.front().out);
    flight.pop_front();
    lock.unlock();
    go_on = consume(i, std::move(out));
  }
  return go_on;
}

}  // namespace tind
