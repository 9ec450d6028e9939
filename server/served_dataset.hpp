// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "server/dataset.hpp"
#include "server/file_scan.hpp"
#include "server/tile_rows.hpp"

namespace tind {

/// A text made once, and served until it is made again.
struct Document {
  std::string text;
  const char* content_type = "";
  std::string etag_base;  ///< Hash of the text.
};
Document make_document(std::string text, const char* content_type);

/// An open dataset with the texts about it, and the dataset behind it. Never changes.
struct ServedDataset {
  std::shared_ptr<const Dataset> dataset;
  std::shared_ptr<const ServedDataset> base;  ///< Asked for tiles that are not in own_tiles; nullptr: there is none.
  TileRows own_tiles;                         ///< With a base only: what the dataset answers for itself.
  TileRows all_tiles;                         ///< With a base only: what it or a base answers for.
  std::string version;                        ///< Of all files that answers can come from; 16 hex digits.
  Document meta, layer;

  /// The dataset that answers for a tile: this one, or a base.
  const ServedDataset& owner_of(const TileKey& key) const;
};

/// Puts a dataset and its base, which may be nullptr, together.
std::shared_ptr<const ServedDataset> serve_dataset(std::shared_ptr<const Dataset> dataset,
                                                   std::shared_ptr<const ServedDataset> base,
                                                   const DatasetSource& source);

/// What lists say of a dataset without opening its file again.
struct DatasetSummary {
  std::array<double, 4> bounds_deg{};
  int bottom_level = 0;
  double tolerance_m = 0;
  std::string version;
};
DatasetSummary summarize(const Dataset& dataset);

/// How many files are open, and whom to tell when it is too many or one is wanted. Shared by the slots of all sites.
/// The functions are thread safe and do not wait.
struct OpenLimit {
  int max_open = 0;
  std::function<void()> on_excess;
  std::function<void()> on_wanted;  ///< Has somebody look at the pages of slots that are wanted. None: who asks, looks.
  std::atomic<int> n_open = 0;
};

/// One name of a site: a file that is open, or will be when somebody asks. Thread safe.
class DatasetSlot {
 public:
  /// `opened`: the file, when it was opened before; else nullptr.
  DatasetSlot(DatasetSource source, std::shared_ptr<DatasetSlot> base, std::shared_ptr<const Dataset> opened,
              std::shared_ptr<OpenLimit> limit);
  ~DatasetSlot();
  DatasetSlot(const DatasetSlot&) = delete;
  DatasetSlot& operator=(const DatasetSlot&) = delete;

  const DatasetSource& source() const { return source_; }
  const std::shared_ptr<DatasetSlot>& base() const { return base_; }

  /// Opens the file and its base, unless they are open: takes a millisecond or so, and some 0.1 ms a megabyte when the
  /// file was not looked at before. A file that failed is not tried again: when it changes, it gets another slot.
  Result<std::shared_ptr<const ServedDataset>> open();
  /// True: open() would take long, because nobody looked at the file's pages yet or at its base's, and now somebody
  /// was told to. False: open() is quick, or there is nobody.
  bool awaits_look();
  /// Whether it was, since this was asked last.
  bool take_wanted() { return is_wanted_.exchange(false); }
  /// nullptr while it is closed.
  std::shared_ptr<const ServedDataset> if_open() const;
  /// Forgets the open file; those who hold it keep it.
  void close();
  /// Reads what lists say, without leaving the file open.
  Result<void> read_summary();
  /// Looks at all of the tree's pages without holding others up; once. A file with damaged ones has failed. False:
  /// there was nothing to do.
  bool look_at_pages();
  /// nullopt: the file was not read yet, or failed.
  std::optional<DatasetSummary> summary() const;
  bool has_failed() const { return error().has_value(); }
  /// Why the file could not be opened; nullopt: it could, or was not tried.
  std::optional<Error> error() const;

  /// Counts requests that named the dataset; what was counted stays when a name gets another slot (`take_counts`).
  void count_requests(std::uint64_t n) { n_requests_->fetch_add(n, std::memory_order_relaxed); }
  std::uint64_t n_requests() const { return n_requests_->load(std::memory_order_relaxed); }
  /// Goes on counting where `before`, whose name this slot has now, is. Before anybody counts.
  void take_counts(const DatasetSlot& before) { n_requests_ = before.n_requests_; }

  /// Notes that somebody asked, at a coarse time in seconds: the slot used last is closed last.
  void touch(std::int64_t now_s) {
    if (last_used_s_.load(std::memory_order_relaxed) != now_s) last_used_s_.store(now_s, std::memory_order_relaxed);
  }
  std::int64_t last_used_s() const { return last_used_s_.load(std::memory_order_relaxed); }

 private:
  const DatasetSource source_;
  const std::shared_ptr<DatasetSlot> base_;
  const std::shared_ptr<OpenLimit> limit_;
  std::atomic<std::int64_t> last_used_s_ = 0;
  std::shared_ptr<std::atomic<std::uint64_t>> n_requests_ = std::make_shared<std::atomic<std::uint64_t>>(0);
  mutable std::mutex mutex_;  // taken before the base's, never after
  std::shared_ptr<const Dataset> opened_;
  std::shared_ptr<const ServedDataset> served_;
  std::optional<DatasetSummary> summary_;
  bool is_looked_at_ = false;  // its pages, and they are sound
  std::atomic<bool> is_wanted_ = false;
  std::optional<Error> error_;
};

}  // namespace tind
