// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/doctor.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <optional>
#include <thread>
#include <utility>
#include <vector>

#include "storage/content_hash.hpp"
#include "storage/doctor/manifest_checks.hpp"
#include "storage/store_pages.hpp"
#include "storage/doctor/tile_checks.hpp"
#include "storage/doctor/value_check.hpp"
#include "storage/inputs_blob.hpp"
#include "storage/level_tally.hpp"
#include "storage/piece_blob.hpp"

namespace tind {
namespace {

constexpr std::size_t kTilesAtOnce = 512;
// Shares of the work, as far as progress is concerned: the first two looks at the file are short.
constexpr double kPagesShare = 0.02, kPiecesShare = 0.08;

// Of a key that may be anybody's.
std::string where_of(ByteView key) {
  if (key.empty()) return "file";
  if (is_manifest_key(key)) return "manifest";
  if (const auto piece = parse_piece_key(key)) return name_of(*piece);
  std::string text = "key ";
  for (const std::uint8_t byte : key) text += fmt::format("{:02x}", byte);
  return text;
}

class Doctor {
 public:
  Doctor(std::string path, const CheckOptions& options) : path_(std::move(path)), options_(options) {}

  Result<CheckReport> run() {
    const auto start = std::chrono::steady_clock::now();
    auto pages = StorePages::open(path_);
    if (!pages) {
      if (pages.error().kind != ErrorKind::kCorrupt) return tl::unexpected(pages.error());
      fault("file", pages.error().message);
    } else {
      report_.file_bytes = pages->file_bytes();
      if (auto done = look_into(*pages); !done) return tl::unexpected(done.error());
    }
    report_.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    return std::move(report_);
  }

 private:
  void fault(std::string where, std::string what) {
    ++report_.n_faults;
    if (report_.faults.size() < options_.most_faults) report_.faults.push_back({std::move(where), std::move(what)});
  }
  void add(Faults faults) {
    for (Fault& f : faults) fault(std::move(f.where), std::move(f.what));
  }
  void progress(double share) const {
    if (options_.progress) options_.progress(std::min(share, 1.0));
  }

  Result<void> look_into(const StorePages& pages) {
    if (!walk_pages(pages)) return {};
    progress(kPagesShare);
    read_pieces(pages);
    // The pages are sound, so LMDB can be let loose on them.
    const auto store = TileStore::open(path_);
    if (!store) {
      fault("file", store.error().message);
      return {};
    }
    if (auto done = check_tiles(*store); !done) return done;
    compare_counts();
    return {};
  }

  // The structure of the file; its tiles and its manifest. False: what is there cannot be looked at further.
  bool walk_pages(const StorePages& pages) {
    ByteView manifest_value;
    bool has_manifest = false;
    StoredTiles tiles(kMaxLevel + 1);
    pages.walk(
        [&](ByteView key, ByteView value) {
          if (is_manifest_key(key)) {
            manifest_value = value;
            has_manifest = true;
          } else if (const auto piece = parse_piece_key(key); piece && piece->kind == PieceKind::kBody) {
            tiles.add({piece->level, piece->i, piece->j});
          }
        },
        [&](ByteView key, const std::string& what) { fault(where_of(key), "damaged pages: " + what); });
    if (report_.n_faults > 0) return false;
    if (!has_manifest) {
      fault("manifest", "missing: the file is not a finished pyramid");
      return false;
    }
    const auto json = unpack_strictly(manifest_value);
    auto manifest = json ? decode_manifest(*json) : tl::unexpected(json.error());
    if (!manifest) {
      const std::string prefix = "manifest: ", &text = manifest.error().message;
      fault("manifest", text.starts_with(prefix) ? text.substr(prefix.size()) : text);
      return false;
    }
    manifest_ = std::move(*manifest);
    tiles_.emplace(std::move(tiles));
    add(check_manifest(manifest_, *json));
    for (const LevelInfo& level : manifest_.levels) {
      tallies_.emplace_back(uncounted(level), manifest_.lattice.ellipsoid.semi_major_m);
      report_.n_tiles += tiles_->n_tiles(static_cast<std::size_t>(level.level));
    }
    is_counted_.assign(tallies_.size(), true);
    report_.n_levels = static_cast<int>(tallies_.size());
    return true;
  }

  // Every record but the bodies, which are decoded with their tiles; and the content hash.
  void read_pieces(const StorePages& pages) {
    ContentHash hash(ContentHash::kind_of(manifest_.content_hash));
    std::uint64_t n_bytes = 0;
    pages.walk(
        [&](ByteView key, ByteView value) {
          n_bytes += key.size() + value.size();
          progress(kPagesShare + kPiecesShare * static_cast<double>(n_bytes) / static_cast<double>(report_.file_bytes));
          if (is_manifest_key(key)) return;
          const auto piece = parse_piece_key(key);
          if (!piece) {
            if (!is_unknown_kind(key)) fault(where_of(key), "a key that is no piece's");
            return;
          }
          ++report_.n_pieces;
          if (piece->kind != PieceKind::kInputs) {
            hash.add(key, value);
          } else {
            has_inputs_ = true;
          }
          check_piece(*piece, value);
        },
        [&](ByteView key, const std::string& what) { fault(where_of(key), what); });
    report_.content_hash = hash.hex();
    if (report_.content_hash != manifest_.content_hash) {
      fault("manifest", fmt::format("content_hash: {}, the pieces make {}: at least one is not what was built",
                                    manifest_.content_hash, report_.content_hash));
    }
  }

  void check_piece(const PieceKey& key, ByteView value) {
    if (key.level > manifest_.bottom_level) {
      return fault(name_of(key), fmt::format("lies below the bottom level {}", manifest_.bottom_level));
    }
    if (!tiles_->has_any_of(key)) fault(name_of(key), "belongs to no stored tile");
    LevelTally& tally = tallies_[key.level];
    const auto broken = [&](const Error& error) {
      fault(name_of(key), error.message);
      is_counted_[key.level] = false;
    };
    if (key.kind == PieceKind::kBody) return;
    if (key.kind == PieceKind::kInputs) {
      if (const auto inputs = decode_inputs(value); !inputs) broken(inputs.error());
      return;
    }
    const auto record = unpack_strictly(value);
    if (!record) return broken(record.error());
    if (key.kind == PieceKind::kCorner) {
      const auto corner = decode_corner(*record);
      if (!corner) return broken(corner.error());
      tally.add_corner(value.size());
    } else {
      const auto edge = decode_edge(*record);
      if (!edge) return broken(edge.error());
      tally.add_edge(edge->inner.size(), value.size());
    }
  }

  // In storage order, so that sums and reports do not depend on the threads.
  Result<void> check_tiles(const TileStore& store) {
    std::uint64_t n_done = 0;
    for (std::size_t level = 0; level < tallies_.size(); ++level) {
      const std::size_t n = tiles_->n_tiles(level);
      for (std::size_t first = 0; first < n; first += kTilesAtOnce) {
        auto findings = check_stretch(store, level, first, std::min(n - first, kTilesAtOnce));
        if (!findings) return tl::unexpected(findings.error());
        for (std::size_t k = 0; k < findings->size(); ++k) {
          take(tiles_->tile(level, first + k), std::move((*findings)[k]));
        }
        n_done += findings->size();
        progress(kPagesShare + kPiecesShare +
                 (1 - kPagesShare - kPiecesShare) * static_cast<double>(n_done) / static_cast<double>(report_.n_tiles));
      }
    }
    return {};
  }

  Result<std::vector<TileFindings>> check_stretch(const TileStore& store, std::size_t level, std::size_t first,
                                                  std::size_t n) const {
    std::vector<TileFindings> findings(n);
    std::atomic<std::size_t> next{0};
    std::atomic<bool> has_failed{false};
    const auto work = [&] {
      const auto snapshot = store.snapshot();
      if (!snapshot) {
        has_failed = true;
        return;
      }
      const PieceSource pieces{*snapshot, *tiles_, manifest_, has_inputs_};
      for (std::size_t k = next++; k < n; k = next++) findings[k] = check_tile(pieces, tiles_->tile(level, first + k));
    };
    const unsigned wished = options_.threads > 0 ? static_cast<unsigned>(options_.threads)
                                                 : std::max(1u, std::thread::hardware_concurrency());
    std::vector<std::thread> threads;
    for (unsigned k = 1; k < wished && k < n; ++k) threads.emplace_back(work);
    work();
    for (std::thread& thread : threads) thread.join();
    if (has_failed) return fail(ErrorKind::kIo, path_ + ": LMDB begins no read transaction");
    return findings;
  }

  void take(const TileKey& tile, TileFindings found) {
    add(std::move(found.faults));
    if (!found.counts) {
      is_counted_[tile.level] = false;
      return;
    }
    const BodyCounts& c = *found.counts;
    report_.n_triangles += c.n_triangles;
    tallies_[tile.level].add_body(tile, c.stats, c.n_interior, c.n_triangles, c.n_bytes);
    if (tile.level != manifest_.bottom_level || c.stats.n_posts == 0) return;
    const double side = 180 / std::ldexp(1.0, tile.level);
    const double west = -180 + tile.x * side, south = -90 + tile.y * side;
    if (!post_box_) post_box_ = {west, south, west + side, south + side};
    auto& box = *post_box_;
    box = {std::min(box[0], west), std::min(box[1], south), std::max(box[2], west + side),
           std::max(box[3], south + side)};
  }

  // Sums over pieces that do not decode would only repeat what was said of those.
  void compare_counts() {
    for (std::size_t k = 0; k < tallies_.size(); ++k) {
      if (!is_counted_[k]) continue;
      const LevelInfo counted = tallies_[k].finish();
      add(compare_level(manifest_.levels[k], counted));
      // Each level covers all posts.
      if (k + 1 == tallies_.size()) add(check_posts(manifest_, counted.n_posts, post_box_));
    }
  }

  std::string path_;
  const CheckOptions& options_;
  CheckReport report_;
  Manifest manifest_;
  std::optional<StoredTiles> tiles_;
  std::vector<LevelTally> tallies_;  // by level
  std::vector<bool> is_counted_;     // by level: all pieces decode
  bool has_inputs_ = false;
  PostBox post_box_;
};

}  // namespace

Result<CheckReport> check_file(const std::string& path, const CheckOptions& options) {
  return Doctor(path, options).run();
}

}  // namespace tind
