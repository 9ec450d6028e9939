// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/served_dataset.hpp"

#include <utility>

#include "server/layer_json.hpp"
#include "server/log.hpp"

namespace tind {
namespace {

constexpr const char* kJson = "application/json";

}  // namespace

Document make_document(std::string text, const char* content_type) {
  std::string hash = fingerprint({text});
  return {std::move(text), content_type, std::move(hash)};
}

const ServedDataset& ServedDataset::owner_of(const TileKey& key) const {
  const ServedDataset* owner = this;
  while (owner->base && !has_tile(owner->own_tiles, key)) owner = owner->base.get();
  return *owner;
}

std::shared_ptr<const ServedDataset> serve_dataset(std::shared_ptr<const Dataset> dataset,
                                                   std::shared_ptr<const ServedDataset> base,
                                                   const DatasetSource& source) {
  ServedDataset served;
  const Manifest& manifest = dataset->manifest;
  LayerOptions layer{dataset->name, dataset->version, rows_of(manifest), ""};
  if (base) {
    const TileRows behind = base->base ? base->all_tiles : rows_of(base->dataset->manifest);
    layer.tiles = own_rows(manifest, behind);
    if (source.base_mode == BaseMode::kParentUrl) {
      layer.parent = base->dataset->name;
    } else {
      served.own_tiles = layer.tiles;
      served.all_tiles = layer.tiles = join_rows(served.own_tiles, behind);
      layer.version = fingerprint({dataset->version, base->version});
      served.base = base;
    }
    if (manifest.heights != base->dataset->manifest.heights) {
      log_warning(dataset->name + ": its heights are " + manifest.heights + ", those of its base " +
                  base->dataset->name + " are " + base->dataset->manifest.heights);
    }
  }
  served.version = layer.version;
  served.meta = make_document(dataset->manifest_json, kJson);
  served.layer = make_document(make_layer_json(manifest, layer), kJson);
  served.dataset = std::move(dataset);
  return std::make_shared<const ServedDataset>(std::move(served));
}

DatasetSummary summarize(const Dataset& dataset) {
  const Manifest& m = dataset.manifest;
  return {m.bounds_deg, m.bottom_level, m.levels.empty() ? 0.0 : m.levels.back().tolerance_m, dataset.version};
}

DatasetSlot::DatasetSlot(DatasetSource source, std::shared_ptr<DatasetSlot> base, std::shared_ptr<const Dataset> opened,
                         std::shared_ptr<OpenLimit> limit)
    : source_(std::move(source)), base_(std::move(base)), limit_(std::move(limit)), opened_(std::move(opened)) {
  if (!opened_) return;
  summary_ = summarize(*opened_);
  is_looked_at_ = true;
  ++limit_->n_open;
}

DatasetSlot::~DatasetSlot() {
  if (opened_) --limit_->n_open;
}

Result<std::shared_ptr<const ServedDataset>> DatasetSlot::open() {
  const std::lock_guard lock(mutex_);
  if (served_) return served_;
  if (error_) return tl::unexpected(*error_);
  std::shared_ptr<const ServedDataset> base;
  if (base_) {
    auto opened = base_->open();
    // The base may be mended while this dataset stays: not remembered.
    if (!opened) return tl::unexpected(opened.error());
    base = std::move(*opened);
  }
  if (!opened_) {
    const TreeExtent looked_at = is_looked_at_ ? TreeExtent::kLastPath : TreeExtent::kWhole;
    auto dataset = open_dataset(source_.path, source_.name, looked_at);
    if (!dataset) {
      error_ = dataset.error();
      log_error(error_->message);
      return tl::unexpected(*error_);
    }
    is_looked_at_ = true;
    opened_ = std::make_shared<const Dataset>(std::move(*dataset));
    summary_ = summarize(*opened_);
    if (++limit_->n_open > limit_->max_open && limit_->on_excess) limit_->on_excess();
  }
  served_ = serve_dataset(opened_, std::move(base), source_);
  return served_;
}

bool DatasetSlot::awaits_look() {
  if (!limit_->on_wanted) return false;
  if (base_ && base_->awaits_look()) return true;
  {
    const std::lock_guard lock(mutex_);
    if (is_looked_at_ || error_) return false;
  }
  is_wanted_ = true;
  limit_->on_wanted();
  return true;
}

std::shared_ptr<const ServedDataset> DatasetSlot::if_open() const {
  const std::lock_guard lock(mutex_);
  return served_;
}

void DatasetSlot::close() {
  const std::lock_guard lock(mutex_);
  if (opened_) --limit_->n_open;
  opened_.reset();
  served_.reset();
}

Result<void> DatasetSlot::read_summary() {
  const std::lock_guard lock(mutex_);
  if (error_) return tl::unexpected(*error_);
  if (summary_) return {};
  const auto dataset = open_dataset(source_.path, source_.name, TreeExtent::kLastPath);
  if (dataset) {
    summary_ = summarize(*dataset);
    return {};
  }
  error_ = dataset.error();
  return tl::unexpected(*error_);
}

bool DatasetSlot::look_at_pages() {
  {
    const std::lock_guard lock(mutex_);
    if (is_looked_at_ || error_) return false;
  }
  const auto dataset = open_dataset(source_.path, source_.name);
  const std::lock_guard lock(mutex_);
  if (is_looked_at_ || error_) return true;  // somebody opened it meanwhile
  if (dataset) {
    is_looked_at_ = true;
  } else {
    error_ = dataset.error();
    log_error(error_->message);
  }
  return true;
}

std::optional<DatasetSummary> DatasetSlot::summary() const {
  const std::lock_guard lock(mutex_);
  return summary_;
}

std::optional<Error> DatasetSlot::error() const {
  const std::lock_guard lock(mutex_);
  return error_;
}

}  // namespace tind
