// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/catalog.hpp"

#include <algorithm>
#include <functional>
#include <unordered_map>
#include <utility>

#include "server/log.hpp"

namespace tind {
namespace {

// A file modified so recently may still be written to.
constexpr std::int64_t kYoung_ns = 500'000'000;
constexpr int kMaxBases = 8;  // one behind another

std::int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch())
      .count();
}

}  // namespace

Result<std::unique_ptr<Catalog>> Catalog::open(const Settings& settings) {
  std::unique_ptr<Catalog> catalog(new Catalog);
  catalog->specs_ = settings.datasets;
  catalog->limit_->max_open = settings.max_open_datasets;
  auto cesium = find_cesium(settings.cesium);
  if (!cesium) return tl::unexpected(cesium.error());
  catalog->cesium_root_ = std::move(*cesium);
  const CatalogChange change = catalog->look(true, true);
  if (!change.failed.empty()) return fail(ErrorKind::kInvalidInput, change.failed.front().message);
  return catalog;
}

CatalogChange Catalog::refresh(bool at_once) { return look(at_once, false); }

CatalogChange Catalog::refresh(std::vector<DatasetSpec> specs) {
  specs_ = std::move(specs);
  return look(true, false);
}

// False: wait for the next look.
bool Catalog::settles(const DatasetSource& source, bool at_once, CatalogChange& change) {
  const bool young = now_ns() - source.stamp.modified_ns < kYoung_ns;
  const auto seen = seen_once_.find(source.path);
  const bool same = seen != seen_once_.end() && seen->second == source.stamp;
  if (at_once || !young || same) {
    if (seen != seen_once_.end()) seen_once_.erase(seen);
    return true;
  }
  seen_once_[source.path] = source.stamp;
  change.unsettled = true;
  return false;
}

// Takes away bases that are not there, that lead back, or that are too many; each is told of.
void Catalog::check_bases(std::vector<DatasetSource>& sources, std::vector<ScanProblem>& problems) {
  std::unordered_map<std::string, DatasetSource*> by_name;
  for (DatasetSource& source : sources) by_name[source.name] = &source;
  std::set<std::string> in_a_ring;
  for (const DatasetSource& source : sources) {
    int n_bases = 0;
    const DatasetSource* at = &source;
    while (!at->base.empty() && n_bases <= kMaxBases && by_name.contains(at->base)) {
      at = by_name[at->base];
      ++n_bases;
    }
    if (n_bases > kMaxBases) in_a_ring.insert(source.name);
  }
  for (DatasetSource& source : sources) {
    if (source.base.empty()) continue;
    if (!by_name.contains(source.base)) {
      problems.push_back({source.name, "dataset " + source.name + ": there is no dataset '" + source.base +
                                           "' for its base; it is served alone"});
    } else if (in_a_ring.contains(source.name)) {
      problems.push_back({source.name, "dataset " + source.name + ": its bases lead back to itself, or are more than " +
                                           std::to_string(kMaxBases) + "; it is served alone"});
    } else {
      continue;
    }
    source.base.clear();
  }
}

CatalogChange Catalog::look(bool at_once, bool first) {
  CatalogChange change;
  FileScan scan = scan_files(specs_);
  std::vector<ScanProblem>& problems = scan.problems;
  if (first) {
    // In folders other files may have names that cannot be; what was given must be right.
    for (const ScanProblem& problem : problems) {
      const bool given = std::any_of(specs_.begin(), specs_.end(),
                                     [&](const DatasetSpec& spec) { return spec.path == problem.subject; });
      if (given) change.failed.push_back(problem);
    }
    if (!change.failed.empty()) return change;
  }

  // Which files to serve: those found, but the old ones where the new are broken or not finished.
  std::vector<DatasetSource> sources;
  std::map<std::string, std::shared_ptr<const Dataset>> opened;
  std::set<std::string> missing, fresh;
  for (DatasetSource& source : scan.sources) {
    const auto old = slots_.find(source.name);
    const DatasetSource* before = old == slots_.end() ? nullptr : &old->second->source();
    const bool same_file = before && before->path == source.path && before->stamp == source.stamp;
    const auto stay = [&] {
      if (!before) return;
      source.path = before->path;
      source.stamp = before->stamp;
      sources.push_back(source);
    };
    if (same_file && !(at_once && old->second->has_failed())) {
      sources.push_back(source);
      continue;
    }
    const auto refused = refused_.find(source.path);
    if (refused != refused_.end() && refused->second == source.stamp && !at_once) {
      stay();
      continue;
    }
    if (!settles(source, at_once, change)) {
      stay();
      continue;
    }
    // At the start thousands of files may lie in folders: they are opened when they are asked for.
    if (first && source.from_folder) {
      sources.push_back(source);
      continue;
    }
    auto dataset = open_dataset(source.path, source.name);
    if (!dataset) {
      refused_[source.path] = source.stamp;
      change.failed.push_back(
          {source.name, dataset.error().message + (before ? "; the old file stays in service" : "")});
      if (first) return change;
      log_error(change.failed.back().message);
      stay();
      continue;
    }
    refused_.erase(source.path);
    fresh.insert(source.name);
    if (limit_->n_open + static_cast<int>(opened.size()) < limit_->max_open) {
      opened[source.name] = std::make_shared<const Dataset>(std::move(*dataset));
    }
    sources.push_back(source);
  }
  std::set<std::string> found;
  for (const DatasetSource& source : scan.sources) found.insert(source.name);
  for (const auto& [name, slot] : slots_) {
    if (found.contains(name)) continue;
    // While a file is replaced by removing and moving it is away for a moment.
    if (at_once || missing_once_.contains(name)) continue;
    missing.insert(name);
    change.unsettled = true;
    sources.push_back(slot->source());
  }
  missing_once_ = std::move(missing);
  const std::size_t n_scan_problems = problems.size();
  check_bases(sources, problems);
  change.failed.insert(change.failed.end(), problems.begin(), problems.end());
  if (first && problems.size() > n_scan_problems) {
    change.failed.assign(problems.begin() + static_cast<std::ptrdiff_t>(n_scan_problems), problems.end());
    return change;
  }
  tell_once(problems);
  if (first) change.failed.clear();  // of files in folders: told of

  // Slots, each after its base. One that is as before is taken over with its open file.
  std::map<std::string, const DatasetSource*> by_name;
  for (const DatasetSource& source : sources) by_name[source.name] = &source;
  Slots slots;
  const std::function<std::shared_ptr<DatasetSlot>(const DatasetSource&)> slot_of = [&](const DatasetSource& source) {
    if (const auto made = slots.find(source.name); made != slots.end()) return made->second;
    const std::shared_ptr<DatasetSlot> base = source.base.empty() ? nullptr : slot_of(*by_name.at(source.base));
    const auto old = slots_.find(source.name);
    const bool is_old = old != slots_.end() && old->second->source() == source && old->second->base() == base &&
                        !fresh.contains(source.name);
    if (is_old) return slots.emplace(source.name, old->second).first->second;
    const auto open_file = opened.find(source.name);
    std::shared_ptr<const Dataset> dataset = open_file == opened.end() ? nullptr : open_file->second;
    if (!dataset && !fresh.contains(source.name) && old != slots_.end() && old->second->source().path == source.path &&
        old->second->source().stamp == source.stamp) {
      if (const auto served = old->second->if_open()) dataset = served->dataset;
    }
    const bool was_open = dataset != nullptr;
    auto slot = std::make_shared<DatasetSlot>(source, base, std::move(dataset), limit_);
    if (old != slots_.end()) slot->take_counts(*old->second);
    if (was_open) {
      // The texts about it are made here and not by the first who asks.
      if (const auto made = slot->open(); !made) change.failed.push_back({source.name, made.error().message});
    }
    (old == slots_.end() ? change.added : change.replaced).push_back(source.name);
    return slots.emplace(source.name, std::move(slot)).first->second;
  };
  for (const DatasetSource& source : sources) {
    const std::size_t n_before = change.added.size() + change.replaced.size();
    slot_of(source);
    if (change.added.size() + change.replaced.size() == n_before) ++change.n_unchanged;
  }
  for (auto* names : {&change.added, &change.replaced}) std::sort(names->begin(), names->end());
  for (const auto& [name, slot] : slots_) {
    if (!slots.contains(name)) change.removed.push_back(name);
  }
  slots_ = std::move(slots);
  if (first || change.changed()) {
    if (!first) {
      for (const std::string& name : change.added)
        log_info("dataset " + name + ": added, " + slots_[name]->source().path);
      for (const std::string& name : change.replaced) {
        log_info("dataset " + name + ": replaced, " + slots_[name]->source().path);
      }
      for (const std::string& name : change.removed) log_info("dataset " + name + ": removed; its file is gone");
    }
    publish();
    close_excess();
    read_ahead_done_ = false;
  }
  return change;
}

// Troubles that stay from look to look, until somebody mends them.
void Catalog::tell_once(const std::vector<ScanProblem>& problems) {
  std::set<std::string> told;
  for (const ScanProblem& problem : problems) {
    if (told.insert(problem.message).second && !told_.contains(problem.message)) log_error(problem.message);
  }
  told_ = std::move(told);
}

void Catalog::publish() {
  lists_stale_ = false;
  std::vector<std::shared_ptr<DatasetSlot>> slots;
  for (const auto& [name, slot] : slots_) slots.push_back(slot);
  auto site = make_site(std::move(slots), cesium_root_);
  if (holder_) {
    holder_->replace(std::move(site));
  } else {
    holder_ = std::make_unique<SiteHolder>(std::move(site));
  }
}

bool Catalog::read_ahead() {
  if (read_ahead_done_) return false;
  for (const auto& [name, slot] : slots_) {
    if (slot->summary() || slot->has_failed()) continue;
    if (const auto read = slot->read_summary(); !read) log_error(read.error().message);
    lists_stale_ = true;
    return true;
  }
  if (lists_stale_) publish();
  for (const auto& [name, slot] : slots_) {
    if (slot->look_at_pages()) return true;
  }
  read_ahead_done_ = true;
  return false;
}

void Catalog::look_at_wanted() {
  for (const auto& [name, slot] : slots_) {
    if (slot->take_wanted()) slot->look_at_pages();
  }
  holder_->touch();
}

void Catalog::close_excess() {
  if (limit_->n_open <= limit_->max_open) return;
  std::vector<DatasetSlot*> open;
  for (const auto& [name, slot] : slots_) {
    if (slot->if_open()) open.push_back(slot.get());
  }
  std::sort(open.begin(), open.end(),
            [](const DatasetSlot* a, const DatasetSlot* b) { return a->last_used_s() < b->last_used_s(); });
  for (DatasetSlot* slot : open) {
    if (limit_->n_open <= limit_->max_open) break;
    slot->close();
  }
  holder_->touch();
}

}  // namespace tind
