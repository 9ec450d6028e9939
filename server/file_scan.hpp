// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "config/settings.hpp"

namespace tind {

/// Tells one version of a file from another, without reading it. Symbolic links are followed, so a link that is swapped
/// is another file.
struct FileStamp {
  std::uint64_t device = 0, inode = 0, size_bytes = 0;
  std::int64_t modified_ns = 0;  ///< Since 1970.
  friend bool operator==(const FileStamp&, const FileStamp&) = default;
};
/// nullopt: no such regular file.
std::optional<FileStamp> stamp_of(const std::string& path);

/// A dataset to be served, as the settings and the folders say.
struct DatasetSource {
  std::string name;
  std::string path;
  FileStamp stamp;
  std::string base;  ///< Name of the base dataset; empty: none.
  BaseMode base_mode = BaseMode::kMerge;
  bool from_folder = false;
  friend bool operator==(const DatasetSource&, const DatasetSource&) = default;
};

/// Something that keeps a file, or what it is about, from being served.
struct ScanProblem {
  std::string subject;  ///< A path, or a dataset's name.
  std::string message;  ///< Names the subject, one line.
  friend bool operator==(const ScanProblem&, const ScanProblem&) = default;
};

struct FileScan {
  std::vector<DatasetSource> sources;  ///< Sorted by name, each name once.
  std::vector<ScanProblem> problems;
};

/// Looks at the files and folders of the settings: names and stamps only, no file is opened. In a folder *.tind counts,
/// hidden files do not. Of two files of one name the first given wins, the other is a problem; so is a file that is
/// given and not there, and a name that routes need.
FileScan scan_files(const std::vector<DatasetSpec>& specs);

/// The directories in which a change can change what scan_files() finds: of the files, of symbolic links on the way to
/// them, and the folders. Sorted, each once.
std::vector<std::string> watched_directories(const std::vector<DatasetSpec>& specs);

}  // namespace tind
