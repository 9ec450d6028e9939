// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "storage/builder/progress.hpp"
#include "storage/manifest.hpp"

namespace tind {

struct MergeOptions {
  std::vector<std::string> inputs;  ///< All shards of one build, in any order; one may be named twice.
  std::string output;
  bool force = false;  ///< Replace an output that exists, drop an interrupted merge.
  const std::atomic<bool>* cancel = nullptr;
};

struct MergeReport {
  Manifest manifest;
  std::uint64_t file_bytes = 0;
  double seconds = 0;
};

/// Joins shards (BuildOptions::shard) into the pyramid that one build would have made, byte for byte. Pieces that
/// several inputs have must be equal. Memory does not grow with the inputs. kInvalidInput: inputs that are no shards of
/// one build, missing shards, pieces that do not match (the message names some); kCorrupt, kIo, kInterrupted. An
/// earlier output is left untouched on failure.
Result<MergeReport> merge_pyramids(const MergeOptions& options, Progress& progress);

}  // namespace tind
