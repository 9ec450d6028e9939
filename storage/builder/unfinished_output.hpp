// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

#include "core/result.hpp"

namespace tind {

/// An output while it is made: NAME.partial beside it, and NAME.partial.json, which tells what it is made of. Both stay
/// behind when the work stops half-way, so that the same command can go on. One process at a time, by a lock on
/// NAME.partial that the operating system gives up when the process ends, however it ends. One thread.
class UnfinishedOutput {
 public:
  /// Takes the name. With `resume` what is there is kept to go on with, else it is refused unless `force`, which drops
  /// it. kInvalidInput: an interrupted build is there, or another process is at work on it; kIo: the folder cannot be
  /// written.
  static Result<UnfinishedOutput> open(const std::string& output, bool resume, bool force);
  UnfinishedOutput(UnfinishedOutput&& other) noexcept;
  UnfinishedOutput& operator=(UnfinishedOutput&&) = delete;
  /// Removes both files unless they were kept or put in place.
  ~UnfinishedOutput();

  /// Whether an interrupted build of `output` is there.
  static bool exists_for(const std::string& output);

  const std::string& path() const { return path_; }
  /// Compares with what the interrupted build was made of, or writes it down where there was none. kInvalidInput names
  /// what changed.
  Result<void> check_job(const nlohmann::json& job);
  /// Leaves both files for a later run.
  void keep() { keep_ = true; }
  /// Renames onto the output; atomic. kIo.
  Result<void> put_in_place();

 private:
  UnfinishedOutput(std::string output, int fd, bool goes_on);
  Result<void> write_job(const std::string& text) const;

  std::string output_, path_, job_path_;
  int fd_ = -1;
  bool goes_on_ = false, keep_ = false, placed_ = false;
};

/// Members that differ, as "NAME was X, is Y" lines; nested members by their path. Empty: equal.
std::string describe_changes(const nlohmann::json& before, const nlohmann::json& now);

}  // namespace tind
