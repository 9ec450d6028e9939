// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/file_scan.hpp"

#include <sys/stat.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <map>
#include <set>

#include "server/route.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;

constexpr const char* kExtension = ".tind";
constexpr int kMaxLinks = 40;  // as many as Linux follows

class Scanner {
 public:
  void add(const DatasetSpec& spec) {
    std::error_code error;
    if (fs::is_directory(spec.path, error)) return add_folder(spec);
    const auto stamp = stamp_of(spec.path);
    if (!stamp) {
      problem(spec.path, spec.path + ": " + (fs::exists(spec.path, error) ? "not a file" : "no such file"));
      return;
    }
    add_file(spec, spec.path, *stamp, spec.name.empty() ? fs::path(spec.path).stem().string() : spec.name, false);
  }

  FileScan take() {
    for (auto& [name, source] : by_name_) scan_.sources.push_back(std::move(source));
    return std::move(scan_);
  }

 private:
  void add_folder(const DatasetSpec& spec) {
    if (!spec.name.empty())
      return problem(spec.path, spec.path + ": a folder cannot have a name; its files have theirs");
    std::error_code error;
    std::vector<std::string> paths;
    for (fs::directory_iterator it(spec.path, error), end; !error && it != end; it.increment(error)) {
      const fs::path& path = it->path();
      if (path.extension() == kExtension && path.filename().string().front() != '.') paths.push_back(path.string());
    }
    if (error) problem(spec.path, spec.path + ": cannot be read: " + error.message());
    std::sort(paths.begin(), paths.end());
    for (const std::string& path : paths) {
      // Gone since, a dangling link or a directory: not a dataset, and nobody asked for it.
      if (const auto stamp = stamp_of(path)) add_file(spec, path, *stamp, fs::path(path).stem().string(), true);
    }
  }

  void add_file(const DatasetSpec& spec, const std::string& path, const FileStamp& stamp, const std::string& name,
                bool from_folder) {
    if (name.empty() || is_reserved_name(name)) {
      return problem(path, path + ": '" + name + "' is a name the daemon needs itself; rename the file");
    }
    const auto [found, is_new] =
        by_name_.try_emplace(name, DatasetSource{name, path, stamp, spec.base, spec.base_mode, from_folder});
    if (is_new) return;
    problem(path, path + ": a dataset named '" + name + "' is given twice; " + found->second.path + " has it");
  }

  void problem(const std::string& subject, const std::string& message) { scan_.problems.push_back({subject, message}); }

  FileScan scan_;
  std::map<std::string, DatasetSource> by_name_;
};

}  // namespace

std::optional<FileStamp> stamp_of(const std::string& path) {
  struct stat info {};
  if (::stat(path.c_str(), &info) != 0 || !S_ISREG(info.st_mode)) return std::nullopt;
  return FileStamp{info.st_dev, info.st_ino, static_cast<std::uint64_t>(info.st_size),
                   std::int64_t{info.st_mtim.tv_sec} * 1'000'000'000 + info.st_mtim.tv_nsec};
}

FileScan scan_files(const std::vector<DatasetSpec>& specs) {
  Scanner scanner;
  for (const DatasetSpec& spec : specs) scanner.add(spec);
  return scanner.take();
}

std::vector<std::string> watched_directories(const std::vector<DatasetSpec>& specs) {
  std::set<std::string> directories;
  for (const DatasetSpec& spec : specs) {
    std::error_code error;
    fs::path path = fs::absolute(spec.path, error).lexically_normal();
    if (fs::is_directory(path, error)) {
      directories.insert(path.string());
    } else {
      directories.insert(path.parent_path().string());
    }
    // A link anywhere on the way can be swapped: its directory tells.
    for (int links = 0; links < kMaxLinks; ++links) {
      fs::path prefix;
      bool followed = false;
      for (auto part = path.begin(); part != path.end(); ++part) {
        prefix /= *part;
        if (!fs::is_symlink(prefix, error)) continue;
        directories.insert(prefix.parent_path().string());
        fs::path target = fs::read_symlink(prefix, error);
        if (target.is_relative()) target = prefix.parent_path() / target;
        for (++part; part != path.end(); ++part) target /= *part;
        path = target.lexically_normal();
        followed = true;
        break;
      }
      if (!followed) break;
    }
    directories.insert(fs::is_directory(path, error) ? path.string() : path.parent_path().string());
  }
  return {directories.begin(), directories.end()};
}

}  // namespace tind
