// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <thread>

#include "core/result.hpp"

namespace tind {

/// Lines for a file or pipe, written by a thread of its own: write() never waits for the disk or for whoever reads the
/// pipe. What does not fit into the queue, and what the disk refuses, is dropped and counted. Thread safe.
class LineSink {
 public:
  static constexpr std::size_t kQueueBytes = std::size_t{4} << 20;

  /// Appends to the file, made when absent; "-" is standard output. kIo when it cannot be opened.
  static Result<std::unique_ptr<LineSink>> open(const std::string& path);
  /// Writes to `fd`, which stays the caller's. `queue_bytes`: what may wait.
  explicit LineSink(int fd, std::size_t queue_bytes = kQueueBytes);
  /// Writes what waits, for at most a second.
  ~LineSink();
  LineSink(const LineSink&) = delete;
  LineSink& operator=(const LineSink&) = delete;

  /// Queues a line; the newline is added.
  void write(std::string_view line);
  /// Opens the file again by its name, after somebody has moved it away. Done by the sink's thread.
  void reopen();
  std::uint64_t n_dropped() const { return n_dropped_.load(std::memory_order_relaxed); }

 private:
  void run();
  void open_again();
  std::size_t write_out(std::string_view text);
  bool wait_writable();

  std::string path_;  // empty: a descriptor of the caller's
  int fd_;
  const std::size_t queue_bytes_;
  std::atomic<std::uint64_t> n_dropped_ = 0;
  std::atomic<bool> stopping_ = false;
  std::mutex mutex_;
  std::condition_variable something_;
  std::string queue_;
  bool reopen_ = false;
  std::thread thread_;
};

enum class LogLevel { kDebug, kInfo, kWarning, kError };
enum class LogFormat { kText, kJson };

/// The words of the settings `log_level` and `log_format`, which are checked there.
LogLevel log_level_of(std::string_view word);
LogFormat log_format_of(std::string_view word);

/// A line of the error log: "TIME LEVEL message" or a JSON object with time, level and message.
std::string format_log_line(LogLevel level, LogFormat format, std::string_view message);

/// `text` as a JSON string with its quotes. Bytes that are no UTF-8 become U+FFFD.
std::string json_string(std::string_view text);
/// "2026-11-22T08:40:22.123Z": now.
std::string utc_time();

/// The daemon's error log, on standard error. Before start_log() and after stop_log() lines are written at once. All
/// thread safe but start and stop, which belong to main.
void start_log(LogLevel level, LogFormat format);
void stop_log();
void set_log_level(LogLevel level);
void log_line(LogLevel level, std::string_view message);
inline void log_debug(std::string_view message) { log_line(LogLevel::kDebug, message); }
inline void log_info(std::string_view message) { log_line(LogLevel::kInfo, message); }
inline void log_warning(std::string_view message) { log_line(LogLevel::kWarning, message); }
inline void log_error(std::string_view message) { log_line(LogLevel::kError, message); }
/// Lines of the error log that were dropped since start_log().
std::uint64_t n_log_lines_dropped();

}  // namespace tind
