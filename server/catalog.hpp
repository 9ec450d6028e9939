// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "config/settings.hpp"
#include "server/file_scan.hpp"
#include "server/site.hpp"

namespace tind {

/// What one look at the files changed.
struct CatalogChange {
  std::vector<std::string> added, replaced, removed;  ///< Names of datasets.
  std::vector<ScanProblem> failed;                    ///< What is not served for it, or served as before.
  std::size_t n_unchanged = 0;
  bool unsettled = false;  ///< Some file is just being written or moved: look again soon.

  bool changed() const { return !added.empty() || !replaced.empty() || !removed.empty(); }
};

/// Keeps a SiteHolder's site true to files and folders. A file that is new or was replaced is opened and checked beside
/// the old one, then swapped in; one that cannot be opened is told of once, and the old one stays. One thread at a
/// time.
class Catalog {
 public:
  /// Looks at the files for the first time. Files given by name are opened, those in folders when they are asked for.
  /// Fails with the first problem of a file given by name or of a base, and as find_cesium().
  static Result<std::unique_ptr<Catalog>> open(const Settings& settings);

  SiteHolder& holder() { return *holder_; }
  const std::vector<DatasetSpec>& specs() const { return specs_; }
  const std::shared_ptr<OpenLimit>& limit() const { return limit_; }

  /// Looks again, and swaps the site when something changed. `at_once`: also what seems to be just being written
  /// counts, and what failed before is tried again.
  CatalogChange refresh(bool at_once);
  /// The same with other files and folders.
  CatalogChange refresh(std::vector<DatasetSpec> specs);

  /// Reads one file that nobody asked for yet, so that lists can say more about it and a broken one is told of; after
  /// all those looks at the pages of one. False: there is none left.
  bool read_ahead();
  /// Looks at the pages of the files that somebody waits for (OpenLimit::on_wanted), and tells those who wait.
  void look_at_wanted();
  /// Closes those of the open files that were not asked for longest, until no more than the limit are open.
  void close_excess();

 private:
  using Slots = std::map<std::string, std::shared_ptr<DatasetSlot>>;
  Catalog() = default;

  CatalogChange look(bool at_once, bool first);
  bool settles(const DatasetSource& source, bool at_once, CatalogChange& change);
  void check_bases(std::vector<DatasetSource>& sources, std::vector<ScanProblem>& problems);
  void tell_once(const std::vector<ScanProblem>& problems);
  void publish();

  std::vector<DatasetSpec> specs_;
  std::string cesium_root_;
  std::shared_ptr<OpenLimit> limit_ = std::make_shared<OpenLimit>();
  Slots slots_;
  std::map<std::string, FileStamp> seen_once_;  ///< Young files: taken when they look the same next time.
  std::map<std::string, FileStamp> refused_;    ///< By path: told of, not tried again until it changes.
  std::set<std::string> missing_once_;          ///< Names whose file was gone at the last look.
  std::set<std::string> told_;                  ///< Messages of problems that are still there.
  bool read_ahead_done_ = false;
  bool lists_stale_ = false;  ///< Something was read ahead that the lists do not say yet.
  std::unique_ptr<SiteHolder> holder_;
};

}  // namespace tind
