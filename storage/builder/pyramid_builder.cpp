// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/pyramid_builder.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "core/border_line.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/duration.hpp"
#include "storage/builder/earlier_tiles.hpp"
#include "storage/builder/level_counter.hpp"
#include "storage/builder/level_times.hpp"
#include "storage/builder/ordered_pipeline.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/pyramid_patcher.hpp"
#include "storage/builder/shard.hpp"
#include "storage/builder/tile_digest.hpp"
#include "storage/builder/tile_maker.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/piece_blob.hpp"
#include "storage/readers/resident_maps.hpp"
#include "storage/zstd_codec.hpp"

namespace tind {
namespace {

// The interior vertices of a stored body, decoded by whoever needs them first.
class ParentBody {
 public:
  explicit ParentBody(Bytes value) : value_(std::move(value)) {}
  const Result<std::vector<LocalVertex>>& interior() const {
    std::call_once(once_, [this] {
      interior_ = decode_interior(value_);
      value_ = {};
    });
    return interior_;
  }

 private:
  mutable Bytes value_;
  mutable std::once_flag once_;
  mutable Result<std::vector<LocalVertex>> interior_;
};
using ParentPointer = std::shared_ptr<const ParentBody>;

// Changed descendants of a tile beyond which its mesh is not told by few posts.
constexpr std::size_t kMostChanged = 256;

class PyramidBuilder {
 public:
  PyramidBuilder(const PyramidInput& input, const TilePlan& plan, const RefinementSpec& spec, const PostDigests& posts,
                 TileStoreWriter& writer, Progress& progress)
      : input_(input),
        field_(input.field),
        table_(input.table),
        writer_(writer),
        progress_(progress),
        plan_(plan),
        spec_(spec),
        shard_(plan_, input.shard_index, input.shard_count),
        borders_(field_.lattice),
        maker_(input, plan, spec, posts, borders_),
        times_(table_.bottom_level() + 1) {
    outcome_.shard_cut_level = shard_.cut_level();
    if (input.earlier) earlier_.emplace(input.earlier->snapshot, posts, table_.bottom_level());
  }

  Result<PyramidOutcome> run() {
    for (int level = 0; level <= table_.bottom_level(); ++level) {
      const auto start = std::chrono::steady_clock::now();
      LevelBreakdown parts;
      if (auto done = refine_lines(level); !done) return tl::unexpected(done.error());
      auto info = build_level(level, start, parts);
      if (!info) return tl::unexpected(info.error());
      parts.seconds = seconds_since(start);
      times_.finish_level(parts.seconds);
      note_errors(*info, progress_);
      outcome_.levels.push_back(std::move(*info));
      outcome_.breakdown.push_back(parts);
    }
    outcome_.content_hash = writer_.content_hash();
    return std::move(outcome_);
  }

 private:
  bool cancelled() const { return input_.cancel && input_.cancel->load(std::memory_order_relaxed); }

  static Error interrupted() { return {ErrorKind::kInterrupted, "interrupted"}; }

  // The stored body of a tile of the level above. Copied, because the writer's views do not outlive the next append;
  // neighbours in the list have the same parent, which is copied and decoded once. One thread.
  ParentPointer parent_body(const TileKey& parent) {
    if (!last_parent_ || last_parent_key_ != parent) {
      const auto value = writer_.find({PieceKind::kBody, parent.level, parent.x, parent.y});
      last_parent_ = std::make_shared<const ParentBody>(value ? Bytes(value->begin(), value->end()) : Bytes());
      last_parent_key_ = parent;
    }
    return last_parent_;
  }

  Result<void> refine_lines(int level) {
    std::vector<RootEdge> roots = plan_.root_edges(level, field_.lattice);
    if (level > shard_.cut_level()) {
      // Such a line runs inside a tile of the cut level: it is seen by that tile's shard alone.
      std::erase_if(roots, [this](const RootEdge& root) { return !shard_.has(parent_of(field_.lattice, root)); });
    }
    // All bodies of the level above are read here, and nothing is appended that would give their pages back.
    const ByteView stored = writer_.map();
    const ResidentMap resident(const_cast<std::uint8_t*>(stored.data()), stored.size());
    struct In {
      RootEdge root;
      ParentPointer parent;
    };
    const auto prepare = [&](std::size_t i) {
      return In{roots[i], level > 0 ? parent_body(parent_of(field_.lattice, roots[i])) : nullptr};
    };
    using Line = Result<std::vector<LineVertex>>;
    const auto work = [&](In&& in) -> Line {
      if (!in.parent) return maker_.refine(in.root, {});
      const auto& interior = in.parent->interior();
      if (!interior) return tl::unexpected(interior.error());
      return maker_.refine(in.root, *interior);
    };
    std::optional<Error> error;
    const auto consume = [&](std::size_t i, Line&& line) {
      if (!line) {
        error = line.error();
        return false;
      }
      if (const auto lost = posts_are_read(field_); !lost) {
        error = lost.error();
        return false;
      }
      borders_.add(roots[i], std::move(*line));
      return !cancelled();
    };
    if (!run_ordered<In, Line>(roots.size(), input_.threads, prepare, work, consume)) {
      return tl::unexpected(error.value_or(interrupted()));
    }
    return {};
  }

  // Appends a piece, and notes whether the earlier pyramid has it otherwise.
  Result<void> append(const PieceKey& key, ByteView value) {
    if (input_.earlier && key.kind != PieceKind::kInputs && !input_.earlier->has(key, value)) {
      outcome_.changed.push_back(key);
    }
    return writer_.append(key, value);
  }

  // Corner and edge values, made where they are written: they are slices of the lines.
  Result<void> append_border_piece(const PieceKey& key, LevelCounter& counter) {
    const TileMaker::BorderPiece piece = maker_.make_border_piece(key);
    counter.add_border_piece(key, piece.figures, piece.value.size());
    return append(key, piece.value);
  }

  Result<void> append_tile(const TileKey& key, const MadeTile& tile, LevelCounter& counter) {
    counter.add_tile(key, tile.figures, tile.value.size());
    if (auto done = append({PieceKind::kBody, key.level, key.x, key.y}, tile.value); !done) return done;
    return append({PieceKind::kInputs, key.level, key.x, key.y}, tile.inputs);
  }

  // What the interrupted run stored of a tile, copied; else what the earlier pyramid has. One thread.
  struct Known {
    Bytes body, inputs;  // of the interrupted run
    std::optional<StoredTile> earlier;
  };
  Known known_of(const TileKey& key) const {
    const PieceKey body_key{PieceKind::kBody, key.level, key.x, key.y};
    const PieceKey inputs_key{PieceKind::kInputs, key.level, key.x, key.y};
    Known known;
    const auto inputs = writer_.find_earlier(inputs_key);
    const auto body = inputs ? writer_.find_earlier(body_key) : std::nullopt;
    if (body) {
      known.body.assign(body->begin(), body->end());
      known.inputs.assign(inputs->begin(), inputs->end());
    } else if (earlier_) {
      known.earlier = earlier_->find(key);
      if (known.earlier && maker_.n_cell_levels(key.level) > 0) {
        known.earlier->changed = earlier_->changed_below(key, kMostChanged).value_or(std::vector<TileKey>());
      }
    }
    return known;
  }

  Result<LevelInfo> build_level(int level, std::chrono::steady_clock::time_point start, LevelBreakdown& parts) {
    const std::vector<TileKey> tiles = shard_.filter(plan_.tiles(level));
    const std::vector<PieceKey> pieces = border_pieces_of(tiles);
    LevelCounter counter(input_, spec_, level);
    std::optional<Error> error;
    const auto failed = [&error](Result<void>&& done) {
      if (!done) error = done.error();
      return !done;
    };
    std::size_t next_piece = 0;
    struct In {
      TileKey key;
      ParentPointer parent;
      Known known;
    };
    const auto prepare = [&](std::size_t i) {
      In in{tiles[i], nullptr, known_of(tiles[i])};
      if (in.known.body.empty() && level > 0) in.parent = parent_body(tiles[i].parent());
      return in;
    };
    const auto work = [&](In&& in) -> Result<MadeTile> {
      if (!in.known.body.empty()) {
        // An earlier pyramid is checked as a whole; of an interrupted run there is no hash yet.
        const auto record = unpack_value(in.known.body);
        if (!record) return tl::unexpected(record.error());
        if (const auto body = decode_body(*record); !body) return tl::unexpected(body.error());
        return TileMaker::take_over({in.known.body, in.known.inputs, {}});
      }
      if (!in.parent) return maker_.make(in.key, {}, in.known.earlier);
      const auto& interior = in.parent->interior();
      if (!interior) return tl::unexpected(interior.error());
      return maker_.make(in.key, *interior, in.known.earlier);
    };
    const auto consume = [&](std::size_t i, Result<MadeTile>&& tile) {
      if (!tile) {
        error = tile.error();
        return false;
      }
      if (failed(posts_are_read(field_))) return false;
      const PieceKey body{PieceKind::kBody, tiles[i].level, tiles[i].x, tiles[i].y};
      for (; next_piece < pieces.size() && pieces[next_piece] < body; ++next_piece) {
        if (failed(append_border_piece(pieces[next_piece], counter))) return false;
      }
      if (failed(append_tile(tiles[i], *tile, counter))) return false;
      const double done = static_cast<double>(i + 1) / static_cast<double>(tiles.size());
      progress_.update_left(fmt::format("level {} of {}", level, table_.bottom_level()),
                            times_.left(done, seconds_since(start)));
      return !cancelled();
    };
    if (!run_ordered<In, Result<MadeTile>>(tiles.size(), input_.threads, prepare, work, consume)) {
      return tl::unexpected(error.value_or(interrupted()));
    }
    for (; next_piece < pieces.size(); ++next_piece) {
      if (failed(append_border_piece(pieces[next_piece], counter))) return tl::unexpected(*error);
    }
    parts = counter.parts();
    return counter.finish();
  }

  // Corners and edges of tiles of one level in storage order, each once.
  static std::vector<PieceKey> border_pieces_of(const std::vector<TileKey>& tiles) {
    std::vector<PieceKey> keys;
    for (const TileKey& tile : tiles) {
      for (const PieceKey& key : pieces_of(tile)) {
        if (key.kind != PieceKind::kBody) keys.push_back(key);
      }
    }
    std::sort(keys.begin(), keys.end());
    keys.erase(std::unique(keys.begin(), keys.end()), keys.end());
    return keys;
  }

  const PyramidInput& input_;
  const HeightField& field_;
  const LevelTable& table_;
  TileStoreWriter& writer_;
  Progress& progress_;
  const TilePlan& plan_;
  const RefinementSpec& spec_;
  const ShardTiles shard_;
  BorderLines borders_;
  const TileMaker maker_;
  std::optional<EarlierTiles> earlier_;
  TileKey last_parent_key_;
  ParentPointer last_parent_;
  LevelTimes times_;
  PyramidOutcome outcome_;
};

}  // namespace

Result<PyramidOutcome> build_levels(const PyramidInput& input, TileStoreWriter& writer, Progress& progress) {
  const TilePlan plan(input.field, input.table.bottom_level());
  const PostDigests posts(input.field, input.table.bottom_level(), input.threads, input.cancel);
  const RefinementSpec spec = refinement_spec(input, plan);
  if (input.earlier) {
    auto patched = patch_levels(input, plan, spec, posts, writer.path(), progress);
    if (!patched) return tl::unexpected(patched.error());
    if (*patched) return std::move(**patched);
  }
  return PyramidBuilder(input, plan, spec, posts, writer, progress).run();
}

}  // namespace tind
