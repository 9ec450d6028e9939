// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <functional>
#include <string>

#include "core/result.hpp"
#include "storage/doctor/fault.hpp"

namespace tind {

struct CheckOptions {
  int threads = 0;                       ///< 0: one per core.
  std::size_t most_faults = 1000;        ///< Only so many are kept; all are counted.
  std::function<void(double)> progress;  ///< Gets the share that is done, 0..1; may be empty. Called by one thread.
};

/// What was found in a file, and how much of it was read.
struct CheckReport {
  Faults faults;
  std::uint64_t n_faults = 0;
  std::uint64_t file_bytes = 0;
  std::uint64_t n_tiles = 0, n_pieces = 0, n_triangles = 0;
  int n_levels = 0;
  std::string content_hash;  ///< As computed; empty: the file was not read so far.
  double seconds = 0;

  bool is_sound() const { return n_faults == 0; }
};

/// Reads a whole `.tind` file and holds it against docs/format.md: pages, keys, values, records, shared edges, tiles,
/// the manifest's counts, and the content hash, which tells of changes that leave everything else consistent. A damaged
/// file is a report with faults; an Error only says that the file cannot be read (kNotFound, kIo, kInvalidInput). Needs
/// memory for 100 bytes a tile and the pieces of one tile a thread. Nobody may write the file meanwhile.
Result<CheckReport> check_file(const std::string& path, const CheckOptions& options);

}  // namespace tind
