// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/builder/pyramid_patcher.hpp"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <iterator>
#include <map>
#include <memory>
#include <new>
#include <set>
#include <span>
#include <thread>
#include <tuple>
#include <utility>
#include <vector>

#include "core/drainage/flow_run.hpp"
#include "storage/builder/border_lines.hpp"
#include "storage/builder/duration.hpp"
#include "storage/builder/earlier_tiles.hpp"
#include "storage/builder/level_counter.hpp"
#include "storage/builder/patched_pieces.hpp"
#include "storage/builder/plan.hpp"
#include "storage/builder/tile_maker.hpp"
#include "storage/builder/tile_posts.hpp"
#include "storage/builder/update_reach.hpp"
#include "storage/builder/version.hpp"
#include "storage/content_hash.hpp"
#include "storage/inputs_blob.hpp"
#include "storage/piece_blob.hpp"
#include "storage/readers/resident_maps.hpp"

namespace tind {
namespace {

// Bottom tiles with changed posts, and tiles looked at, beyond which the whole way is as good: what is made of them is
// kept in memory until it is written.
constexpr std::size_t kMostChanged = 64;
constexpr std::size_t kMostTiles = 512;
// Pieces that are read and counted at a time.
constexpr std::size_t kPiecesAtOnce = 1024;
// Pieces that are read ahead of their counting, at most.
constexpr std::size_t kMostAhead = std::size_t{1} << 16;
// Bytes of pieces beyond which their pages are given back: they come in faster than a ResidentLimit looks.
constexpr std::size_t kMostBytesAtOnce = std::size_t{64} << 20;
// Share of the work that comes before it.
constexpr double kReadShare = 0.5;

struct RootOrder {
  static auto key(const RootEdge& r) { return std::tuple(r.level, r.vertical, r.at, r.start); }
  bool operator()(const RootEdge& a, const RootEdge& b) const { return key(a) < key(b); }
};
using Roots = std::set<RootEdge, RootOrder>;

using Tiles = std::set<TileKey, TileOrder>;

PieceKey body_of(const TileKey& tile) { return {PieceKind::kBody, tile.level, tile.x, tile.y}; }
PieceKey inputs_of(const TileKey& tile) { return {PieceKind::kInputs, tile.level, tile.x, tile.y}; }

bool is_below(TileKey tile, const TileKey& ancestor) {
  if (tile.level < ancestor.level) return false;
  const int n = tile.level - ancestor.level;
  return tile.x >> n == ancestor.x && tile.y >> n == ancestor.y;
}

// Of a tile's level, as the manifest's rows have them.
std::vector<std::pair<std::uint32_t, std::uint32_t>> rows_of(const std::vector<TileKey>& tiles) {
  std::vector<std::pair<std::uint32_t, std::uint32_t>> rows;
  for (const TileKey& tile : tiles) rows.emplace_back(tile.y, tile.x);
  std::sort(rows.begin(), rows.end());
  return rows;
}

bool has_tiles(const LevelInfo& level, const std::vector<TileKey>& tiles) {
  if (level.n_tiles != tiles.size()) return false;
  const auto rows = rows_of(tiles);
  std::size_t n = 0;
  for (const TileRun& run : level.rows) {
    for (std::uint32_t x = run.x_first; x <= run.x_last; ++x, ++n) {
      if (n >= rows.size() || rows[n] != std::pair(run.y, x)) return false;
    }
  }
  return n == rows.size();
}

class PyramidPatcher {
 public:
  PyramidPatcher(const PyramidInput& input, const TilePlan& plan, const RefinementSpec& spec, const PostDigests& posts,
                 const std::string& path, Progress& progress)
      : input_(input),
        field_(input.field),
        earlier_(*input.earlier),
        bottom_level_(input.table.bottom_level()),
        plan_(plan),
        spec_(spec),
        path_(path),
        progress_(progress),
        reach_(plan, input.field.lattice),
        borders_(field_.lattice),
        maker_(input, plan, spec, posts, borders_),
        earlier_tiles_(earlier_.snapshot, posts, bottom_level_),
        seconds_(static_cast<std::size_t>(bottom_level_) + 1, 0) {}

  // Makes the pieces that can have changed. False: the whole way is to be gone.
  Result<bool> find_pieces() {
    if (!is_comparable() || !has_sound_inputs() || !find_changed_posts()) return false;
    progress_.update(kReadShare, "changed tiles");
    pieces_ = std::make_shared<PatchedPieces>(earlier_, path_);
    Tiles tiles(plan_.tiles(0).begin(), plan_.tiles(0).end());
    for (const TileKey& bottom : changed_) {
      for (TileKey tile = bottom; tiles.insert(tile).second && tile.level > 0;) tile = tile.parent();
      for (const RootEdge& root : reach_.roots_at(bottom)) add_root(root, tiles);
    }
    // All at once, as if all meshes above stayed what they are, which is nearly always so. Those below a tile that is
    // built in any case wait for it.
    std::vector<Tiles> again(static_cast<std::size_t>(bottom_level_) + 1);
    for (const TileKey& bottom : changed_) {
      for (TileKey tile = bottom; tile.level > 0 && maker_.n_cell_levels(tile.level - 1) == 0; tile = tile.parent()) {
        tiles.erase(tile);
        again[tile.level].insert(tile);
      }
    }
    auto made = make(tiles);
    if (!made || !*made) return made;
    if (!is_same_world()) return false;
    // Then again what lies below a mesh that did not.
    if (input_.threads > 1) ahead_thread_ = std::jthread([this] { read_ahead(); });
    for (int level = 0; level < bottom_level_; ++level) {
      made = make(again[static_cast<std::size_t>(level)]);
      if (!made || !*made) return made;
      for (const TileKey& tile : moved(level)) {
        Tiles below;
        Roots inside;
        for (int c = 0; c < 4; ++c) below.insert(tile.child(c));
        for (const RootEdge& root : reach_.roots_inside(tile)) {
          add_root(root, below);
          inside.insert(root);
        }
        if (auto refined = refine(inside); !refined) return tl::unexpected(refined.error());
        for (const TileKey& t : below) again[t.level].insert(t);
      }
    }
    made = make(again.back());
    interiors_.clear();
    if (made && *made) collect();
    return made;
  }

  // Counts all pieces: those that were made, and the earlier ones.
  Result<PyramidOutcome> count() {
    if (ahead_thread_.joinable()) ahead_thread_.join();
    std::vector<Entry> entries;
    auto next = ahead_.begin();
    auto done = pieces_->for_all([&](const PieceKey& key, ByteView value) -> Result<void> {
      const bool is_ahead = next != ahead_.end() && next->key == key;
      const bool is_new = pieces_->find(key).has_value();
      entries.push_back(is_ahead && !is_new ? std::move(*next) : entry_of(key, value, is_new));
      if (is_ahead) ++next;
      return entries.size() < kPiecesAtOnce ? Result<void>() : count(entries);
    });
    if (done) done = count(entries);
    if (!done) return tl::unexpected(done.error());
    finish_level();
    outcome_.content_hash = hash_.hex();
    outcome_.patched = std::move(pieces_);
    return std::move(outcome_);
  }

 private:
  bool cancelled() const { return input_.cancel && input_.cancel->load(std::memory_order_relaxed); }
  FlowRun run() const { return {input_.threads, input_.cancel, {}}; }

  // Whether nothing differs but posts, as far as the manifest and today's levels tell. is_same_world() has the rest.
  bool is_comparable() const {
    const Manifest& m = earlier_.manifest;
    const Lattice &then = m.lattice, &now = field_.lattice;
    const LineCounts& lines = m.lines;
    if (m.generator != kGenerator || m.bottom_level != bottom_level_ || then.level != now.level ||
        then.height_exponent != now.height_exponent || then.ellipsoid.semi_major_m != now.ellipsoid.semi_major_m ||
        then.ellipsoid.inverse_flattening != now.ellipsoid.inverse_flattening || m.shard_count != 1 ||
        input_.shard_count != 1 || !input_.is_grid_as_it_was || !can_be_repeated(field_) || !field_.pinned.empty() ||
        !input_.lines.empty() || lines.streams + lines.shores + lines.given + lines.vertices != 0 ||
        m.levels.size() != static_cast<std::size_t>(bottom_level_) + 1) {
      return false;
    }
    for (std::size_t level = 0; level < m.levels.size(); ++level) {
      if (m.levels[level].tolerance_m != input_.table.levels[level].tolerance_m ||
          m.levels[level].height_step_m != spec_.height_step_m[level] ||
          !has_tiles(m.levels[level], plan_.tiles(static_cast<int>(level)))) {
        return false;
      }
    }
    return true;
  }

  // Whether all tiles have records that are what a builder wrote. Their hash is not the manifest's.
  bool has_sound_inputs() const {
    for (int level = 0; level <= bottom_level_; ++level) {
      for (const TileKey& tile : plan_.tiles(level)) {
        const auto stored = earlier_tiles_.find(tile);
        if (!stored || !decode_inputs_head(stored->inputs)) return false;
      }
    }
    return true;
  }

  bool find_changed_posts() {
    for (const TileKey& root : plan_.tiles(0)) {
      const auto below = earlier_tiles_.changed_below(root, kMostChanged);
      if (!below) return false;
      changed_.insert(changed_.end(), below->begin(), below->end());
    }
    // Where no bottom tile is stored there is nothing but the base, which does not change.
    return changed_.size() <= kMostChanged && std::all_of(changed_.begin(), changed_.end(), [&](const TileKey& tile) {
             return tile.level == bottom_level_ && reach_.is_stored(tile);
           });
  }

  // Whether what all frames have in common, as those of the roots tell, is what it was: the grid's spacing and poles,
  // the base height, margins of tolerances.
  bool is_same_world() const {
    return std::all_of(plan_.tiles(0).begin(), plan_.tiles(0).end(), [&](const TileKey& root) {
      const auto made = made_.find(root);
      if (made == made_.end()) return true;  // taken over
      const auto stored = earlier_tiles_.find(root);
      const auto inputs = stored ? decode_inputs_head(stored->inputs) : fail(ErrorKind::kNotFound, "");
      return inputs && inputs->frame == made->second.figures.made_of.frame;
    });
  }

  // Notes a stretch that may have changed, and adds the tiles beside it.
  void add_root(const RootEdge& root, Tiles& tiles) {
    roots_.insert(root);
    const std::vector<TileKey> along = reach_.tiles_along(root);
    tiles.insert(along.begin(), along.end());
  }

  // The body as far as it is known.
  ByteView body(const TileKey& tile) const {
    if (const auto made = made_.find(tile); made != made_.end()) return made->second.value;
    return earlier_.snapshot.find(body_of(tile)).value_or(ByteView());
  }

  // Decodes the interiors of tiles that are not decoded yet: several tiles and stretches need the same one.
  Result<void> decode_interiors(const Tiles& tiles) {
    struct Job {
      TileKey tile;
      Result<std::vector<LocalVertex>> interior;
    };
    std::vector<Job> jobs;
    for (const TileKey& tile : tiles) {
      if (!interiors_.contains(tile)) jobs.push_back({tile, {}});
    }
    const auto work = [this](const Job& job) { return body(job.tile).size(); };
    std::stable_sort(jobs.begin(), jobs.end(), [&](const Job& a, const Job& b) { return work(a) > work(b); });
    for_each_job(run(), static_cast<std::int64_t>(jobs.size()), [&](int, std::int64_t k) {
      Job& job = jobs[static_cast<std::size_t>(k)];
      job.interior = decode_interior(body(job.tile));
    });
    if (cancelled()) return fail(ErrorKind::kInterrupted, "interrupted");
    for (Job& job : jobs) {
      if (!job.interior) return tl::unexpected(job.interior.error());
      interiors_.emplace(job.tile, std::move(*job.interior));
    }
    return {};
  }

  // Refines stretches, and puts them in the place of what was.
  Result<void> refine(const Roots& roots) {
    Tiles parents;
    for (const RootEdge& root : roots) {
      if (root.level > 0) parents.insert(parent_of(field_.lattice, root));
    }
    if (auto decoded = decode_interiors(parents); !decoded) return decoded;
    const std::vector<RootEdge> jobs(roots.begin(), roots.end());
    std::vector<std::vector<LineVertex>> lines(jobs.size());
    for_each_job(run(), static_cast<std::int64_t>(jobs.size()), [&](int, std::int64_t job) {
      const auto k = static_cast<std::size_t>(job);
      const RootEdge& root = jobs[k];
      using Interior = std::span<const LocalVertex>;
      lines[k] = maker_.refine(root, root.level == 0 ? Interior() : interiors_.at(parent_of(field_.lattice, root)));
    });
    if (cancelled()) return fail(ErrorKind::kInterrupted, "interrupted");
    for (std::size_t k = 0; k < jobs.size(); ++k) borders_.add(jobs[k], std::move(lines[k]));
    return {};
  }

  // Makes tiles, or finds that they are what they were. False: too many.
  Result<bool> make(const Tiles& tiles) {
    looked_at_.insert(tiles.begin(), tiles.end());
    if (looked_at_.size() > kMostTiles) return false;
    Roots missing;
    for (const TileKey& tile : tiles) {
      for (const RootEdge& root : BorderLines::roots_of(field_.lattice, tile)) {
        if (!borders_.has(root)) missing.insert(root);
      }
    }
    if (auto refined = refine(missing); !refined) return tl::unexpected(refined.error());
    Tiles parents;
    for (const TileKey& tile : tiles) {
      if (tile.level > 0) parents.insert(tile.parent());
    }
    if (auto decoded = decode_interiors(parents); !decoded) return tl::unexpected(decoded.error());
    struct Job {
      TileKey tile;
      StoredTile earlier;
      Result<MadeTile> made;
      double seconds = 0;
    };
    std::vector<Job> jobs;
    for (const TileKey& tile : tiles) {
      Job job{tile, earlier_tiles_.find(tile).value_or(StoredTile()), {}};
      std::copy_if(changed_.begin(), changed_.end(), std::back_inserter(job.earlier.changed),
                   [&](const TileKey& bottom) { return is_below(bottom, tile); });
      jobs.push_back(std::move(job));
    }
    // The longest first: those that are not just compared, by size.
    const auto work = [](const Job& job) { return job.earlier.changed.empty() ? 0 : job.earlier.body.size(); };
    std::stable_sort(jobs.begin(), jobs.end(), [&](const Job& a, const Job& b) { return work(a) > work(b); });
    for_each_job(run(), static_cast<std::int64_t>(jobs.size()), [&](int, std::int64_t k) {
      Job& job = jobs[static_cast<std::size_t>(k)];
      const auto start = std::chrono::steady_clock::now();
      using Interior = std::span<const LocalVertex>;
      const Interior inherited = job.tile.level == 0 ? Interior() : interiors_.at(job.tile.parent());
      job.made = maker_.make(job.tile, inherited, job.earlier);
      job.seconds = seconds_since(start);
    });
    if (cancelled()) return fail(ErrorKind::kInterrupted, "interrupted");
    for (Job& job : jobs) {
      if (!job.made) return tl::unexpected(job.made.error());
      seconds_[job.tile.level] += job.seconds;
      made_.erase(job.tile);
      interiors_.erase(job.tile);
      if (job.made->figures.built) made_.emplace(job.tile, std::move(*job.made));
    }
    return true;
  }

  // The tiles of a level whose interior vertices are other ones than before, and that have children.
  std::vector<TileKey> moved(int level) const {
    std::vector<TileKey> tiles;
    for (const auto& [tile, made] : made_) {
      if (tile.level != level || made.figures.repeated || !plan_.is_split(tile)) continue;
      const auto before = earlier_.snapshot.find(body_of(tile));
      const auto then = before ? decode_interior(*before) : fail(ErrorKind::kNotFound, "");
      const auto now = decode_interior(made.value);
      if (!then || !now || *then != *now) tiles.push_back(tile);
    }
    return tiles;
  }

  // What was made, to be stored in the place of the earlier pieces.
  void collect() {
    for (auto& [tile, made] : made_) {
      pieces_->replace(body_of(tile), std::move(made.value));
      pieces_->replace(inputs_of(tile), std::move(made.inputs));
    }
    const auto add = [&](const PieceKey& key) {
      if (!earlier_.snapshot.find(key)) return;  // no such corner
      TileMaker::BorderPiece piece = maker_.make_border_piece(key);
      if (!earlier_.has(key, piece.value)) pieces_->replace(key, std::move(piece.value));
    };
    for (const RootEdge& root : roots_) {
      for (const PieceKey& edge : reach_.edges_along(root)) add(edge);
    }
    for (const TileKey& bottom : changed_) {
      for (const PieceKey& corner : reach_.corners_at(bottom)) add(corner);
    }
  }

  // A piece on its way into the level's figures and the content hash.
  struct Entry {
    PieceKey key;
    ByteView value, inputs;  // inputs: of a body that was not made
    bool is_new = false, is_read = false;
    ContentHash::ValueDigest digest{};
    Result<TileFigures> tile;
    Result<BorderFigures> border;
  };
  Entry entry_of(const PieceKey& key, ByteView value, bool is_new) const {
    Entry entry{key, value, {}, is_new, false, {}, {}, {}};
    if (key.kind != PieceKind::kBody) return entry;
    const TileKey tile{key.level, key.i, key.j};
    if (const auto made = made_.find(tile); is_new && made != made_.end()) {
      entry.tile = made->second.figures;
    } else {
      entry.inputs = earlier_.snapshot.find(inputs_of(tile)).value_or(ByteView());
    }
    return entry;
  }

  // Finds what a piece counts for. Thread safe for different entries.
  void read(Entry& entry, const ContentHash::ValueDigest* digest = nullptr) const {
    if (entry.is_read) return;
    entry.is_read = true;
    if (entry.key.kind == PieceKind::kInputs) return;
    entry.digest = digest != nullptr ? *digest : ContentHash::digest_of(entry.value);
    if (entry.key.kind != PieceKind::kBody) {
      entry.border = maker_.figures_of(entry.key, entry.value);
    } else if (!entry.inputs.empty()) {
      entry.tile = TileMaker::figures_of({entry.value, entry.inputs, {}});
    }
  }

  // Reads earlier pieces while tiles are made one after the other and a processor has nothing to do. A piece that turns
  // out to be another one is read again.
  void read_ahead() try {
    const auto snapshot = earlier_.store.snapshot();
    if (!snapshot) return;
    TileStore::Cursor cursor(*snapshot);
    auto digest = earlier_.digests.begin();
    while (ahead_.size() < kMostAhead && !cancelled()) {
      const auto piece = cursor.next();
      if (!piece || !*piece) return;
      const PieceKey& key = (*piece)->key;
      // The views outlive the snapshot: it is the same file in memory.
      Entry entry{key, (*piece)->value, {}, false, false, {}, {}, {}};
      if (key.kind == PieceKind::kBody) {
        entry.inputs = snapshot->find(inputs_of({key.level, key.i, key.j})).value_or(ByteView());
      }
      const bool has_digest = key.kind != PieceKind::kInputs && digest != earlier_.digests.end();
      read(entry, has_digest ? &*digest++ : nullptr);
      ahead_.push_back(std::move(entry));
    }
  } catch (const std::bad_alloc&) {  // what is there is of use
  }

  // Counts pieces, which come in order, and takes them away.
  Result<void> count(std::vector<Entry>& entries) {
    constexpr std::size_t kAtOnce = 32;
    const bool are_read = std::all_of(entries.begin(), entries.end(), [](const Entry& entry) { return entry.is_read; });
    const std::size_t n = are_read ? 0 : (entries.size() + kAtOnce - 1) / kAtOnce;
    for_each_job(run(), static_cast<std::int64_t>(n), [&](int, std::int64_t job) {
      const std::size_t begin = static_cast<std::size_t>(job) * kAtOnce;
      for (std::size_t k = begin; k < std::min(begin + kAtOnce, entries.size()); ++k) read(entries[k]);
    });
    if (cancelled()) return fail(ErrorKind::kInterrupted, "interrupted");
    for (Entry& entry : entries) {
      if (entry.key.kind == PieceKind::kBody && !entry.is_new && entry.tile) {
        entry.tile->copied = !looked_at_.contains({entry.key.level, entry.key.i, entry.key.j});
      }
      if (auto done = count(entry); !done) return done;
      n_unreleased_bytes_ += entry.value.size();
    }
    entries.clear();
    if (n_unreleased_bytes_ > kMostBytesAtOnce) {
      release_resident_maps();
      n_unreleased_bytes_ = 0;
    }
    return {};
  }

  Result<void> count(const Entry& entry) {
    const PieceKey& key = entry.key;
    if (!counter_ || key.level != level_) {
      finish_level();
      level_ = key.level;
      counter_.emplace(input_, spec_, key.level);
    }
    if (key.kind == PieceKind::kInputs) return {};
    if (key.kind == PieceKind::kBody) {
      if (!entry.tile) return tl::unexpected(entry.tile.error());
      counter_->add_tile({key.level, key.i, key.j}, *entry.tile, entry.value.size());
    } else {
      if (!entry.border) return tl::unexpected(entry.border.error());
      counter_->add_border_piece(key, *entry.border, entry.value.size());
    }
    hash_.add(piece_key_bytes(key), entry.digest);
    if (entry.is_new && !earlier_.has(key, entry.value)) outcome_.changed.push_back(key);
    return {};
  }

  void finish_level() {
    if (!counter_) return;
    outcome_.levels.push_back(counter_->finish());
    outcome_.breakdown.push_back(counter_->parts());
    outcome_.breakdown.back().seconds = seconds_[static_cast<std::size_t>(level_)];
    note_errors(outcome_.levels.back(), progress_);
    counter_.reset();
  }

  const PyramidInput& input_;
  const HeightField& field_;
  const EarlierPyramid& earlier_;
  const int bottom_level_;
  const TilePlan& plan_;
  const RefinementSpec& spec_;
  const std::string& path_;
  Progress& progress_;
  const UpdateReach reach_;
  BorderLines borders_;
  const TileMaker maker_;
  const EarlierTiles earlier_tiles_;
  std::vector<TileKey> changed_;  // bottom tiles that have all posts that changed
  Roots roots_;                   // stretches that may have changed
  Tiles looked_at_;
  std::map<TileKey, MadeTile, TileOrder> made_;                       // those that are not what they were
  std::map<TileKey, std::vector<LocalVertex>, TileOrder> interiors_;  // of bodies as they are known
  std::shared_ptr<PatchedPieces> pieces_;
  std::vector<double> seconds_;  // that tiles of a level took, of all threads together
  std::size_t n_unreleased_bytes_ = 0;
  int level_ = 0;
  std::optional<LevelCounter> counter_;  // of that level
  ContentHash hash_{ContentHash::Kind::kXxh3};
  PyramidOutcome outcome_;
  std::vector<Entry> ahead_;  // the thread's until it is joined
  std::jthread ahead_thread_;
};

}  // namespace

Result<std::optional<PyramidOutcome>> patch_levels(const PyramidInput& input, const TilePlan& plan,
                                                   const RefinementSpec& spec, const PostDigests& posts,
                                                   const std::string& path, Progress& progress) {
  PyramidPatcher patcher(input, plan, spec, posts, path, progress);
  const auto found = patcher.find_pieces();
  if (!found) return tl::unexpected(found.error());
  if (!*found) return std::nullopt;
  if (const auto read = posts_are_read(input.field); !read) return tl::unexpected(read.error());
  auto outcome = patcher.count();
  if (!outcome) return tl::unexpected(outcome.error());
  return std::optional(std::move(*outcome));
}

}  // namespace tind
