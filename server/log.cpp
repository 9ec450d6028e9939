// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/log.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <ctime>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

constexpr mode_t kFileMode = 0640;
constexpr int kPollMs = 100;
constexpr auto kLastChance = std::chrono::seconds(1);
// A pipe that is writable takes so many bytes without waiting (POSIX: PIPE_BUF).
constexpr std::size_t kChunkBytes = 4096;

constexpr std::array<std::string_view, 4> kLevelWords = {"debug", "info", "warning", "error"};

int open_file(const std::string& path) {
  return ::open(path.c_str(), O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC | O_NOCTTY, kFileMode);
}

}  // namespace

Result<std::unique_ptr<LineSink>> LineSink::open(const std::string& path) {
  if (path == "-") return std::make_unique<LineSink>(STDOUT_FILENO);
  const int fd = open_file(path);
  if (fd < 0) return fail(ErrorKind::kIo, path + ": cannot be opened for the log: " + std::strerror(errno));
  auto sink = std::make_unique<LineSink>(fd);
  sink->path_ = path;
  return sink;
}

LineSink::LineSink(int fd, std::size_t queue_bytes) : fd_(fd), queue_bytes_(queue_bytes) {
  thread_ = std::thread([this] { run(); });
}

LineSink::~LineSink() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
  }
  something_.notify_one();
  thread_.join();
  if (!path_.empty()) ::close(fd_);
}

void LineSink::write(std::string_view line) {
  bool was_empty = false;
  {
    const std::lock_guard lock(mutex_);
    if (queue_.size() + line.size() + 1 > queue_bytes_) {
      n_dropped_.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    was_empty = queue_.empty();
    queue_.append(line) += '\n';
  }
  if (was_empty) something_.notify_one();
}

void LineSink::reopen() {
  {
    const std::lock_guard lock(mutex_);
    reopen_ = true;
  }
  something_.notify_one();
}

void LineSink::run() {
  std::string text;
  for (bool last = false; !last;) {
    {
      std::unique_lock lock(mutex_);
      something_.wait(lock, [this] { return !queue_.empty() || reopen_ || stopping_; });
      last = stopping_;
      if (reopen_) open_again();
      reopen_ = false;
      text.swap(queue_);  // both keep their memory for the next lines
    }
    const std::size_t n_written = write_out(text);
    const auto n_lost = std::count(text.begin() + static_cast<std::ptrdiff_t>(n_written), text.end(), '\n');
    n_dropped_.fetch_add(static_cast<std::uint64_t>(n_lost), std::memory_order_relaxed);
    text.clear();
  }
}

void LineSink::open_again() {
  if (path_.empty()) return;
  const int fd = open_file(path_);
  if (fd < 0) return;  // better the old file than none
  ::close(fd_);
  fd_ = fd;
}

// False: stopping, and the reader of the pipe does not read.
bool LineSink::wait_writable() {
  const auto begin = std::chrono::steady_clock::now();
  pollfd waiting{fd_, POLLOUT, 0};
  for (;;) {
    if (::poll(&waiting, 1, kPollMs) > 0) return true;
    if (stopping_ && std::chrono::steady_clock::now() - begin > kLastChance) return false;
  }
}

// The number of bytes that were written before the descriptor refused more.
std::size_t LineSink::write_out(std::string_view text) {
  std::size_t at = 0;
  while (at < text.size()) {
    if (!wait_writable()) break;
    const ssize_t n = ::write(fd_, text.data() + at, std::min(kChunkBytes, text.size() - at));
    if (n < 0 && errno != EINTR && errno != EAGAIN) break;
    at += static_cast<std::size_t>(std::max<ssize_t>(n, 0));
  }
  return at;
}

LogLevel log_level_of(std::string_view word) {
  const auto found = std::find(kLevelWords.begin(), kLevelWords.end(), word);
  return found == kLevelWords.end() ? LogLevel::kInfo : static_cast<LogLevel>(found - kLevelWords.begin());
}

LogFormat log_format_of(std::string_view word) { return word == "json" ? LogFormat::kJson : LogFormat::kText; }

std::string json_string(std::string_view text) {
  return nlohmann::json(std::string(text)).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string utc_time() {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  std::tm parts{};
  gmtime_r(&now.tv_sec, &parts);
  std::array<char, 32> text{};
  const std::size_t n = std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%S", &parts);
  return fmt::format("{}.{:03}Z", std::string_view(text.data(), n), now.tv_nsec / 1'000'000);
}

std::string format_log_line(LogLevel level, LogFormat format, std::string_view message) {
  const std::string_view word = kLevelWords[static_cast<std::size_t>(level)];
  if (format == LogFormat::kJson) {
    return fmt::format(R"({{"time":"{}","level":"{}","message":{}}})", utc_time(), word, json_string(message));
  }
  std::string line = fmt::format("{} {} {}", utc_time(), word, message);
  // One line is one message, whatever a file's name is made of.
  std::replace_if(
      line.begin(), line.end(), [](char c) { return static_cast<unsigned char>(c) < ' ' || c == 0x7f; }, '?');
  return line;
}

namespace {

std::unique_ptr<LineSink> error_sink;
std::atomic<LogLevel> least_level = LogLevel::kInfo;
LogFormat error_format = LogFormat::kText;

}  // namespace

void start_log(LogLevel level, LogFormat format) {
  least_level = level;
  error_format = format;
  error_sink = std::make_unique<LineSink>(STDERR_FILENO);
}

void stop_log() { error_sink.reset(); }

void set_log_level(LogLevel level) { least_level = level; }

void log_line(LogLevel level, std::string_view message) {
  if (level < least_level.load(std::memory_order_relaxed)) return;
  const std::string line = format_log_line(level, error_format, message);
  if (error_sink) {
    error_sink->write(line);
  } else {
    std::fprintf(stderr, "%s\n", line.c_str());
  }
}

std::uint64_t n_log_lines_dropped() { return error_sink ? error_sink->n_dropped() : 0; }

}  // namespace tind
