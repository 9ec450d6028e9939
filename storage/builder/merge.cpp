// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/merge.hpp"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <optional>
#include <utility>

#include "storage/builder/earlier_pyramid.hpp"
#include "storage/level_tally.hpp"
#include "storage/builder/output_file.hpp"
#include "storage/builder/unfinished_output.hpp"
#include "storage/piece_blob.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

constexpr std::size_t kNamedConflicts = 5;

// One of the pyramids to be joined, and its next piece.
struct Input {
  std::string path;
  EarlierPyramid pyramid;
  TileStore::Cursor cursor;
  std::optional<TileStore::Piece> next;

  Result<void> advance() {
    auto piece = cursor.next();
    if (!piece) return fail(piece.error().kind, path + ": " + piece.error().message);
    next = *piece;
    return {};
  }
};

// All that shards of one build have in common.
nlohmann::json common_part(const Manifest& manifest) {
  nlohmann::json j = nlohmann::json::parse(encode_manifest(manifest));
  j.erase("shard");
  j.erase("content_hash");
  for (nlohmann::json& level : j["levels"]) {
    nlohmann::json kept;
    for (const char* name : {"level", "tolerance_m", "spacing_m", "height_step_m"}) kept[name] = level[name];
    level = std::move(kept);
  }
  return j;
}

std::string name_of(const PieceKey& key) {
  constexpr const char* kNames[] = {"corner", "edge h", "edge v", "body", "inputs"};
  return fmt::format("{} {}/{}/{}", kNames[static_cast<std::size_t>(key.kind)], key.level, key.i, key.j);
}

class Merger {
 public:
  Merger(const MergeOptions& options, Progress& progress) : options_(options), progress_(progress) {}

  Result<MergeReport> run() {
    const auto start = std::chrono::steady_clock::now();
    if (auto checked = check_output(options_.output, options_.force); !checked) return tl::unexpected(checked.error());
    if (auto opened = open_inputs(); !opened) return tl::unexpected(opened.error());
    if (auto checked = check_shards(); !checked) return tl::unexpected(checked.error());
    // An interrupted merge of the same shards goes on by itself.
    auto unfinished = UnfinishedOutput::open(options_.output, !options_.force, options_.force);
    if (!unfinished) return tl::unexpected(unfinished.error());
    nlohmann::json job = {{"merge", nlohmann::json::array()}};
    for (const Input& input : inputs_) job["merge"].push_back(input.pyramid.manifest.content_hash);
    if (auto checked = unfinished->check_job(job); !checked) return tl::unexpected(checked.error());
    // Shards of an older builder make the bytes that one build of its would have made.
    auto writer =
        TileStoreWriter::go_on(unfinished->path(), ContentHash::kind_of(inputs_.front().pyramid.manifest.content_hash));
    if (!writer) return tl::unexpected(writer.error());

    MergeReport report;
    Manifest& m = report.manifest;
    m = inputs_.front().pyramid.manifest;
    m.shard_index = 0;
    m.shard_count = 1;
    m.shard_cut_level = 0;
    if (auto joined = join(*writer, m); !joined) return tl::unexpected(joined.error());
    m.content_hash = writer->content_hash();
    const std::string text = encode_manifest(m);
    if (auto done = writer->finish(pack_value(Bytes(text.begin(), text.end()))); !done) {
      return tl::unexpected(done.error());
    }
    std::error_code code;
    report.file_bytes = std::filesystem::file_size(unfinished->path(), code);
    if (auto placed = unfinished->put_in_place(); !placed) return tl::unexpected(placed.error());
    report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
    progress_.update(1, "done");
    return report;
  }

 private:
  Result<void> open_inputs() {
    for (const std::string& path : options_.inputs) {
      auto pyramid = EarlierPyramid::open(path);
      if (!pyramid) return tl::unexpected(pyramid.error());
      TileStore::Cursor cursor(pyramid->snapshot);
      inputs_.push_back({path, std::move(*pyramid), std::move(cursor), std::nullopt});
    }
    std::stable_sort(inputs_.begin(), inputs_.end(), [](const Input& a, const Input& b) {
      return a.pyramid.manifest.shard_index < b.pyramid.manifest.shard_index;
    });
    return {};
  }

  Result<void> check_shards() const {
    if (inputs_.empty()) return fail(ErrorKind::kInvalidInput, "nothing to merge: name all shards of a build");
    const Input& first = inputs_.front();
    const int count = first.pyramid.manifest.shard_count;
    const nlohmann::json common = common_part(first.pyramid.manifest);
    std::vector<bool> there(static_cast<std::size_t>(count), false);
    for (const Input& input : inputs_) {
      const Manifest& m = input.pyramid.manifest;
      if (m.shard_count == 1) {
        return fail(ErrorKind::kInvalidInput,
                    input.path + ": a whole pyramid, no shard; merge joins what --shard I/N of one build made");
      }
      if (m.shard_count != count) {
        return fail(ErrorKind::kInvalidInput,
                    fmt::format("{} is one of {} shards, {} one of {}", first.path, count, input.path, m.shard_count));
      }
      const std::string changes = describe_changes(common, common_part(m));
      if (!changes.empty()) {
        return fail(ErrorKind::kInvalidInput,
                    fmt::format("{} and {} are not shards of one build: {}", first.path, input.path, changes));
      }
      there[static_cast<std::size_t>(m.shard_index)] = true;
    }
    std::string missing;
    for (std::size_t k = 0; k < there.size(); ++k) {
      if (!there[k]) missing += fmt::format("{}{}/{}", missing.empty() ? "" : ", ", k, count);
    }
    if (!missing.empty()) return fail(ErrorKind::kInvalidInput, "shards are missing: " + missing);
    return {};
  }

  Result<void> join(TileStoreWriter& writer, Manifest& m) {
    std::vector<LevelTally> tallies;
    std::uint64_t n_tiles = 0, n_done = 0;
    for (const LevelInfo& level : m.levels) {
      tallies.emplace_back(uncounted(level), m.lattice.ellipsoid.semi_major_m);
    }
    for (const Input& input : inputs_) {
      for (const LevelInfo& level : input.pyramid.manifest.levels) n_tiles += level.n_tiles;
    }
    for (Input& input : inputs_) {
      if (auto done = input.advance(); !done) return done;
    }
    for (;;) {
      if (options_.cancel && options_.cancel->load(std::memory_order_relaxed)) {
        return fail(ErrorKind::kInterrupted, "interrupted; nothing was written");
      }
      const Input* lowest = nullptr;
      for (const Input& input : inputs_) {
        if (input.next && (!lowest || input.next->key < lowest->next->key)) lowest = &input;
      }
      if (!lowest) break;
      const TileStore::Piece piece = *lowest->next;
      const std::string& from = lowest->path;
      for (Input& input : inputs_) {
        if (!input.next || input.next->key != piece.key) continue;
        if (piece.key.kind == PieceKind::kBody) ++n_done;
        if (!std::equal(input.next->value.begin(), input.next->value.end(), piece.value.begin(), piece.value.end())) {
          note_conflict(piece.key, from, input.path);
        }
        if (auto done = input.advance(); !done) return done;
      }
      if (n_conflicts_ > 0) continue;  // only count them
      if (auto counted = count(piece, tallies); !counted) {
        return fail(counted.error().kind, fmt::format("{}: {}: {}", from, name_of(piece.key), counted.error().message));
      }
      if (auto done = writer.append(piece.key, piece.value); !done) return done;
      if (piece.key.kind == PieceKind::kBody) {
        progress_.update(static_cast<double>(n_done) / static_cast<double>(std::max<std::uint64_t>(n_tiles, 1)),
                         "merging");
      }
    }
    if (n_conflicts_ > 0) {
      return fail(
          ErrorKind::kInvalidInput,
          fmt::format("the shards do not match in {} pieces: {}{}; build them anew with one version and one set "
                      "of inputs",
                      n_conflicts_, conflicts_, n_conflicts_ > kNamedConflicts ? ", ..." : ""));
    }
    m.levels.clear();
    for (LevelTally& tally : tallies) m.levels.push_back(tally.finish());
    return {};
  }

  void note_conflict(const PieceKey& key, const std::string& a, const std::string& b) {
    if (n_conflicts_++ < kNamedConflicts) {
      conflicts_ += fmt::format("{}{} ({}, {})", conflicts_.empty() ? "" : ", ", name_of(key), a, b);
    }
  }

  static Result<void> count(const TileStore::Piece& piece, std::vector<LevelTally>& tallies) {
    if (piece.key.level >= tallies.size()) return fail(ErrorKind::kCorrupt, "below the bottom level");
    LevelTally& tally = tallies[piece.key.level];
    if (piece.key.kind == PieceKind::kInputs) return {};
    if (piece.key.kind == PieceKind::kCorner) {
      tally.add_corner(piece.value.size());
      return {};
    }
    const auto record = unpack_value(piece.value);
    if (!record) return tl::unexpected(record.error());
    if (piece.key.kind == PieceKind::kBody) {
      const auto body = decode_body(*record);
      if (!body) return tl::unexpected(body.error());
      const TileKey tile{piece.key.level, piece.key.i, piece.key.j};
      tally.add_body(tile, body->stats, body->interior.size(), body->triangles.size(), piece.value.size());
      return {};
    }
    const auto edge = decode_edge(*record);
    if (!edge) return tl::unexpected(edge.error());
    tally.add_edge(edge->inner.size(), piece.value.size());
    return {};
  }

  const MergeOptions& options_;
  Progress& progress_;
  std::vector<Input> inputs_;
  std::size_t n_conflicts_ = 0;
  std::string conflicts_;
};

}  // namespace

Result<MergeReport> merge_pyramids(const MergeOptions& options, Progress& progress) {
  return Merger(options, progress).run();
}

}  // namespace tind
