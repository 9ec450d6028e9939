// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <array>
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/connection_table.hpp"
#include "server/response.hpp"
#include "server/response_cache.hpp"
#include "server/site.hpp"

namespace tind {

class Keeper;

/// Counts up; written by one thread without a locked instruction, read by any.
class Counter {
 public:
  void add(std::uint64_t n) { value_.store(value() + n, std::memory_order_relaxed); }
  std::uint64_t value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<std::uint64_t> value_ = 0;
};

/// What one event loop counts. Written by its thread, read by any: no two threads write to one cache line.
struct alignas(64) WorkerCounters {
  /// Upper bounds of the histogram of durations, in seconds; one more bucket is above.
  static constexpr std::array<double, 14> kBounds_s = {25e-6, 50e-6, 1e-4,   2.5e-4, 5e-4, 1e-3, 2.5e-3,
                                                       5e-3,  1e-2,  2.5e-2, 5e-2,   0.1,  0.5,  1.0};
  static constexpr std::array<int, 19> kStatuses = {200, 204, 206, 304, 308, 400, 404, 405, 408, 412,
                                                    413, 414, 416, 431, 500, 501, 503, 505, 0};  // 0: any other
  static constexpr std::size_t kCodings = 3;

  std::array<std::array<std::array<Counter, kCodings>, kStatuses.size()>, kRouteKinds> requests;
  std::array<Counter, kRouteKinds> bytes;  ///< Heads and bodies, as made.
  std::array<Counter, kBounds_s.size() + 1> durations;
  Counter duration_ns;  ///< Sum over the answers.
  std::atomic<std::uint64_t> n_open_transactions = 0;
  std::atomic<std::uint64_t> n_turns = 0;  ///< Of the event loop's coarse clock: it stands still when the loop does.

  /// Counts an answer of so many bytes.
  void count(const Response& response, std::size_t n_bytes);
  /// Counts how long `n` answers took from the socket to the socket.
  void observe(std::chrono::nanoseconds duration, std::uint64_t n);
};

/// "terrain" for RouteKind::kTerrain.
std::string_view route_name(RouteKind kind);

/// Where the figures of /metrics come from. The pointers are not owned.
struct MetricsSources {
  std::vector<const WorkerCounters*> workers;
  const ConnectionTable* connections = nullptr;
  const ResponseCache* cache = nullptr;
  const SiteHolder* site = nullptr;
  const Keeper* keeper = nullptr;
  std::function<std::uint64_t()> access_lines_dropped;
  std::int64_t started_s = 0;  ///< Since 1970.
};

/// All figures in Prometheus' text format 0.0.4. Thread safe.
std::string format_metrics(const MetricsSources& sources);

}  // namespace tind
