// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/output_file.hpp"

#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

namespace tind {

TemporaryFile::~TemporaryFile() {
  if (!path_.empty()) ::unlink(path_.c_str());
}

Result<void> TemporaryFile::rename_to(const std::string& target) {
  if (std::rename(path_.c_str(), target.c_str()) != 0) {
    return fail(ErrorKind::kIo, target + ": cannot be put in place: " + std::strerror(errno));
  }
  path_.clear();
  return {};
}

Result<void> check_output(const std::string& output_name, bool force) {
  namespace fs = std::filesystem;
  std::error_code code;
  const fs::path output(output_name);
  if (output_name.empty()) return fail(ErrorKind::kInvalidInput, "no output named: give -o NAME.tind");
  const fs::path folder = output.has_parent_path() ? output.parent_path() : fs::path(".");
  if (!fs::is_directory(folder, code)) {
    return fail(ErrorKind::kInvalidInput, folder.string() + ": no such folder; make it first");
  }
  if (::access(folder.c_str(), W_OK | X_OK) != 0) {
    return fail(ErrorKind::kIo, output_name + ": its folder cannot be written: " + std::strerror(errno));
  }
  if (fs::is_directory(output, code)) {
    return fail(ErrorKind::kInvalidInput,
                output_name + ": is a folder; name a file, for example " + (output / "terrain.tind").string());
  }
  if (!force && fs::exists(output, code)) {
    return fail(ErrorKind::kInvalidInput, output_name + ": exists; give --force to replace it");
  }
  return {};
}

}  // namespace tind
