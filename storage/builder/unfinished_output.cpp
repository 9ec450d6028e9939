// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/unfinished_output.hpp"

#include <fcntl.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>
#include <utility>

#include "storage/store_patch.hpp"

namespace tind {
namespace {

constexpr mode_t kFileMode = 0644;

std::string partial_path(const std::string& output) { return output + ".partial"; }
std::string job_path(const std::string& output) { return output + ".partial.json"; }

// A rename is on disk only when its folder is.
void sync_folder_of(const std::string& path) {
  const auto folder = std::filesystem::path(path).parent_path();
  const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

}  // namespace

UnfinishedOutput::UnfinishedOutput(std::string output, int fd, bool goes_on)
    : output_(std::move(output)),
      path_(partial_path(output_)),
      job_path_(job_path(output_)),
      fd_(fd),
      goes_on_(goes_on) {}

UnfinishedOutput::UnfinishedOutput(UnfinishedOutput&& other) noexcept
    : output_(std::move(other.output_)),
      path_(std::move(other.path_)),
      job_path_(std::move(other.job_path_)),
      fd_(std::exchange(other.fd_, -1)),
      goes_on_(other.goes_on_),
      keep_(other.keep_),
      placed_(other.placed_) {}

UnfinishedOutput::~UnfinishedOutput() {
  if (fd_ < 0) return;
  if (!keep_ && !placed_) {
    ::unlink(job_path_.c_str());
    ::unlink(path_.c_str());
  }
  ::close(fd_);
}

bool UnfinishedOutput::exists_for(const std::string& output) {
  std::error_code code;
  return std::filesystem::file_size(partial_path(output), code) > 0 && !code;
}

Result<UnfinishedOutput> UnfinishedOutput::open(const std::string& output, bool resume, bool force) {
  const std::string path = partial_path(output);
  for (;;) {
    const int fd = ::open(path.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, kFileMode);
    if (fd < 0) return fail(ErrorKind::kIo, path + ": cannot be created: " + std::strerror(errno));
    if (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
      ::close(fd);
      return fail(ErrorKind::kInvalidInput,
                  output + ": another tind-build is at work on it; wait for it, or name another output");
    }
    // The process that held the lock before may have renamed or removed the file meanwhile.
    struct stat by_fd {
    }, by_path{};
    const bool same = ::fstat(fd, &by_fd) == 0 && ::stat(path.c_str(), &by_path) == 0 &&
                      by_fd.st_ino == by_path.st_ino && by_fd.st_dev == by_path.st_dev;
    if (!same) {
      ::close(fd);
      continue;
    }
    ::unlink(StorePatch::copy_path(path).c_str());  // of an update that was killed
    const bool is_there = by_fd.st_size > 0;
    if (is_there && !resume && !force) {
      ::close(fd);
      return fail(ErrorKind::kInvalidInput,
                  output + ": an interrupted build of it is here (" + path +
                      "): give --resume to go on with it, or --force to drop it and start anew");
    }
    if (is_there && !resume) {
      ::unlink(job_path(output).c_str());
      if (::ftruncate(fd, 0) != 0) {
        const int error = errno;
        ::close(fd);
        return fail(ErrorKind::kIo, path + ": cannot be written: " + std::strerror(error));
      }
    }
    return UnfinishedOutput(output, fd, is_there && resume);
  }
}

Result<void> UnfinishedOutput::write_job(const std::string& text) const {
  const std::string temporary = job_path_ + ".tmp";
  std::FILE* file = std::fopen(temporary.c_str(), "wbe");
  bool written = file && std::fwrite(text.data(), 1, text.size(), file) == text.size();
  written = written && std::fflush(file) == 0 && ::fsync(::fileno(file)) == 0;
  if (file) written = std::fclose(file) == 0 && written;
  if (!written) {
    ::unlink(temporary.c_str());
    return fail(ErrorKind::kIo, job_path_ + ": cannot be written; is the disk full?");
  }
  if (std::rename(temporary.c_str(), job_path_.c_str()) != 0) {
    return fail(ErrorKind::kIo, job_path_ + ": cannot be put in place: " + std::strerror(errno));
  }
  return {};
}

Result<void> UnfinishedOutput::check_job(const nlohmann::json& job) {
  if (!goes_on_) return write_job(job.dump(2) + "\n");
  keep_ = true;  // whatever is wrong now, what is there is worth keeping
  std::ifstream file(job_path_);
  const std::string text{std::istreambuf_iterator<char>(file), {}};
  const nlohmann::json before = nlohmann::json::parse(text, nullptr, false);
  if (before.is_discarded()) {
    return fail(ErrorKind::kInvalidInput, job_path_ + ": missing or broken, so nobody knows what " + path_ +
                                              " was made of; start anew with --force and without --resume");
  }
  const std::string changes = describe_changes(before, job);
  if (changes.empty()) return {};
  return fail(ErrorKind::kInvalidInput, output_ + ": cannot go on with the interrupted build: " + changes +
                                            "; start anew with --force and without --resume, or undo the change");
}

Result<void> UnfinishedOutput::put_in_place() {
  if (std::rename(path_.c_str(), output_.c_str()) != 0) {
    return fail(ErrorKind::kIo, output_ + ": cannot be put in place: " + std::strerror(errno));
  }
  placed_ = true;
  ::unlink(job_path_.c_str());
  sync_folder_of(output_);
  return {};
}

std::string describe_changes(const nlohmann::json& before, const nlohmann::json& now) {
  const nlohmann::json a = before.flatten(), b = now.flatten();
  std::set<std::string> names;
  for (const auto& [name, value] : a.items()) names.insert(name);
  for (const auto& [name, value] : b.items()) names.insert(name);
  std::string text;
  for (const std::string& name : names) {
    const auto was = a.find(name), is = b.find(name);
    if (was != a.end() && is != b.end() && *was == *is) continue;
    text += fmt::format("{}{} was {}, is {}", text.empty() ? "" : "; ", name.substr(1),
                        was == a.end() ? "absent" : was->dump(), is == b.end() ? "absent" : is->dump());
  }
  return text;
}

}  // namespace tind
