// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace tind::test {

/// What a program left behind.
struct Finished {
  int status = -1;  ///< Exit status; 128 + signal when it was killed.
  std::string out, err;
};

/// Runs one of our programs (by name, from the build directory) to its end. `prepare` runs in the child before it
/// starts, for limits.
Finished run_program(
    const std::string& name, const std::vector<std::string>& arguments, const std::function<void()>& prepare = [] {});

/// A `tind` that serves on a free port of 127.0.0.1 until this object goes.
class Daemon {
 public:
  explicit Daemon(const std::vector<std::string>& tind_files);
  Daemon(const Daemon&) = delete;
  Daemon& operator=(const Daemon&) = delete;
  ~Daemon();
  /// "http://127.0.0.1:PORT"; empty when it did not start.
  const std::string& url() const { return url_; }
  /// SIGTERM, then its exit status.
  int stop();

 private:
  pid_t pid_ = -1;
  int out_ = -1;
  std::string url_;
};

/// A folder that goes with this object.
class ScratchFolder {
 public:
  ScratchFolder();
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;
  std::string file(const std::string& name) const { return (path_ / name).string(); }
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

std::string read_file(const std::string& path);
void write_file(const std::string& path, const std::string& text);
/// Number of lines that are not empty.
std::size_t count_lines(const std::string& text);

}  // namespace tind::test
