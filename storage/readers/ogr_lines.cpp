// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/readers/ogr_lines.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include <fmt/format.h>

#include "storage/readers/join_chains.hpp"
#include "storage/readers/line_features.hpp"
#include "storage/readers/noding.hpp"
#include "storage/readers/segment_grid.hpp"

namespace tind {
namespace {

/// A vertex may be this much farther than a post spacing from the one before, so that rounding to the lattice adds
/// none.
constexpr double kSlackPosts = 1.0 / 64;
constexpr double kNoHeight = std::numeric_limits<double>::quiet_NaN();

/// A feature of one of the files.
struct FeatureId {
  std::size_t file = 0;
  std::int64_t id = 0;
  friend bool operator==(const FeatureId&, const FeatureId&) = default;
  friend bool operator<(const FeatureId& a, const FeatureId& b) {
    return std::tie(a.file, a.id) < std::tie(b.file, b.id);
  }
};

/// Where a line on the lattice comes from.
struct Origin {
  FeatureId feature;
  bool is_shore = false;
  bool has_heights = false;
};

/// The part of a -> b within the box, by Liang and Barsky (1984): parameters, or nothing.
std::optional<std::pair<double, double>> clip(const SourceVertex& a, const SourceVertex& b,
                                              const BreakLineOptions& box) {
  double from = 0, to = 1;
  const auto side = [&](double direction, double room) {  // direction * t <= room
    if (direction == 0) return room >= 0;
    const double t = room / direction;
    if (direction < 0)
      from = std::max(from, t);
    else
      to = std::min(to, t);
    return from <= to;
  };
  const double dx = b.x - a.x, dy = b.y - a.y;
  const bool inside =
      side(-dx, a.x - static_cast<double>(box.west_x)) && side(dx, static_cast<double>(box.east_x) - a.x) &&
      side(-dy, a.y - static_cast<double>(box.south_y)) && side(dy, static_cast<double>(box.north_y) - a.y);
  if (!inside) return std::nullopt;
  return std::pair{from, to};
}

SourceVertex between(const SourceVertex& a, const SourceVertex& b, double t) {
  if (t <= 0) return a;
  if (t >= 1) return b;
  return {std::lerp(a.x, b.x, t), std::lerp(a.y, b.y, t), std::lerp(a.height_m, b.height_m, t)};
}

/// The middle one, the lower of two.
double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>((values.size() - 1) / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

class BreakLineReader {
 public:
  explicit BreakLineReader(const BreakLineOptions& options) : options_(options) {}

  Result<void> add(const BreakLineFile& spec);
  Result<void> node();
  BreakLines finish();

 private:
  void add_line(const SourceLine& source, bool lakes);
  void add_run(const SourceLine& source, const std::vector<SourceVertex>& run, bool is_whole, bool lakes);
  void level_shores(std::size_t first_line, const std::vector<std::optional<std::size_t>>& polygons);
  void note_meetings(const std::vector<LineMeeting>& meetings);
  LatticeLine densify(const LatticeLine& piece, bool has_heights) const;
  double limited_height(const BreakVertex& v, const std::vector<std::uint32_t>& lines);
  std::string label(const FeatureId& f) const { return fmt::format("{} feature {}", out_.sources[f.file].name, f.id); }
  std::string place(std::int64_t x, std::int64_t y) const {
    const double lon = options_.lattice.longitude_deg(x);
    return fmt::format("{:.6f}, {:.6f}", lon >= 180 ? lon - 360 : lon, options_.lattice.latitude_deg(y));
  }

  const BreakLineOptions& options_;
  BreakLines out_;
  std::vector<LatticeLine> lines_;
  std::vector<Origin> origins_;                       ///< Per line.
  std::vector<std::optional<std::size_t>> polygons_;  ///< Per line of the file that is being read.
  FindingList findings_;                              ///< Of the file that is being read.
  bool is_outside_ = true;
  std::vector<NodedPiece> pieces_;
  struct Change {
    double largest_m = 0;
    std::int64_t x = 0, y = 0;
  };
  std::map<FeatureId, Change> changes_;
};

Result<void> BreakLineReader::add(const BreakLineFile& spec) {
  const LineFrame frame{options_.lattice, options_.dx, options_.dy, options_.metres_per_unit, options_.shift_m};
  auto file = read_line_file(spec.spec, frame);
  if (!file) return tl::unexpected(file.error());
  out_.sources.push_back({file->name, file->sha256, file->n_features, spec.lakes});
  out_.counts.features += file->n_features;
  out_.counts.points += file->n_points;
  std::move(file->notes.begin(), file->notes.end(), std::back_inserter(out_.notes));
  findings_ = {};
  polygons_.clear();
  is_outside_ = true;
  const std::size_t first_line = lines_.size();
  for (const SourceLine& line : file->lines) add_line(line, spec.lakes);
  if (is_outside_) {
    LatticeXy low{}, high{};
    bool first = true;
    for (const SourceLine& line : file->lines) {
      for (const SourceVertex& v : line.vertices) {
        const LatticeXy p{std::llround(v.x), std::llround(v.y)};
        low = first ? p : LatticeXy{std::min(low.x, p.x), std::min(low.y, p.y)};
        high = first ? p : LatticeXy{std::max(high.x, p.x), std::max(high.y, p.y)};
        first = false;
      }
    }
    return fail(ErrorKind::kInvalidInput,
                fmt::format("{}: all its lines lie outside the data: they reach from {} to {}, the data from {} to {} "
                            "(longitude, latitude); is its CRS right?",
                            spec.spec, place(low.x, low.y), place(high.x, high.y),
                            place(options_.west_x, options_.south_y), place(options_.east_x, options_.north_y)));
  }
  level_shores(first_line, polygons_);
  for (const std::string& line : findings_.lines()) out_.notes.push_back(fmt::format("{}: {}", file->name, line));
  return {};
}

void BreakLineReader::add_line(const SourceLine& source, bool lakes) {
  const std::vector<SourceVertex>& v = source.vertices;
  if (v.size() == 1) {
    findings_.add("lines of one point were left out", fmt::format("feature {}", source.feature));
    is_outside_ = false;
    return;
  }
  const double width = static_cast<double>(options_.lattice.width());
  const double west = static_cast<double>(options_.west_x), east = static_cast<double>(options_.east_x);
  bool is_inside = false, is_cut = false;
  std::vector<SourceVertex> run;
  int run_turn = 0;  // whole turns by which the run was moved into the area
  const auto flush = [&] {
    if (run.empty()) return;
    add_run(source, run, run.size() == v.size(), lakes);
    is_inside = true;
    run.clear();
  };
  for (std::size_t i = 1; i < v.size(); ++i) {
    const double low = std::min(v[i - 1].x, v[i].x), high = std::max(v[i - 1].x, v[i].x);
    std::vector<int> turns;
    const auto last_turn = static_cast<int>(std::floor((east - low) / width));
    for (auto t = static_cast<int>(std::ceil((west - high) / width)); t <= last_turn; ++t) turns.push_back(t);
    // In the order in which the segment passes the area.
    if (v[i].x > v[i - 1].x) std::reverse(turns.begin(), turns.end());
    bool is_seen = false;
    for (const int turn : turns) {
      SourceVertex from = v[i - 1], to = v[i];
      from.x += turn * width;
      to.x += turn * width;
      const auto part = clip(from, to, options_);
      if (!part || part->first == part->second) continue;  // beside it, or it is touched in a point
      is_seen = true;
      if (part->first > 0 || turn != run_turn) flush();
      if (run.empty()) run.push_back(between(from, to, part->first));
      run.push_back(between(from, to, part->second));
      run_turn = turn;
      if (part->second < 1) flush();
      is_cut = is_cut || part->first > 0 || part->second < 1;
    }
    if (!is_seen) {
      is_cut = true;
      flush();
    }
  }
  flush();
  out_.counts.cut += is_inside && is_cut ? 1 : 0;
  out_.counts.outside += is_inside ? 0 : 1;
  is_outside_ = is_outside_ && !is_inside;
}

void BreakLineReader::add_run(const SourceLine& source, const std::vector<SourceVertex>& run, bool is_whole,
                              bool lakes) {
  LatticeLine line;
  std::int64_t n_repeated = 0;
  bool has_heights = false;
  for (const SourceVertex& v : run) {
    // Clipping may leave a position an ulp outside.
    const BreakVertex p{std::clamp<std::int64_t>(std::llround(v.x), options_.west_x, options_.east_x),
                        std::clamp<std::int64_t>(std::llround(v.y), options_.south_y, options_.north_y), v.height_m};
    has_heights = has_heights || !std::isnan(p.height_m);
    if (!line.empty() && line.back().x == p.x && line.back().y == p.y) {
      ++n_repeated;
      line.back().height_m = std::fmin(line.back().height_m, p.height_m);
      continue;
    }
    line.push_back(p);
  }
  const std::string feature = fmt::format("feature {}", source.feature);
  if (is_whole && n_repeated > 0) {
    out_.counts.repeated += n_repeated;
    findings_.add("vertices on the same lattice point as the one before were dropped", feature, n_repeated);
  }
  if (line.size() < 2) {
    if (is_whole) findings_.add("lines that shrink to one lattice point were left out", feature);
    return;
  }
  // On a globe without a side in the east both sides are one line.
  const bool on_seam = options_.wraps && std::all_of(line.begin(), line.end(),
                                                     [&](const BreakVertex& p) { return p.x == options_.east_x; });
  if (on_seam) return;
  if (lakes && !source.polygon) findings_.add("lines that enclose no lake were taken as break lines", feature);
  const bool is_shore = lakes && source.polygon.has_value();
  lines_.push_back(std::move(line));
  origins_.push_back({{out_.sources.size() - 1, source.feature}, is_shore, has_heights});
  polygons_.push_back(is_shore ? source.polygon : std::nullopt);
}

/// Gives all rings of a lake its one height.
void BreakLineReader::level_shores(std::size_t first_line, const std::vector<std::optional<std::size_t>>& polygons) {
  std::map<std::size_t, std::vector<std::size_t>> lakes;
  for (std::size_t i = 0; i < polygons.size(); ++i) {
    if (polygons[i]) lakes[*polygons[i]].push_back(first_line + i);
  }
  for (const auto& [polygon, rings] : lakes) {
    std::vector<double> given, found;
    for (const std::size_t ring : rings) {
      for (const BreakVertex& v : densify(lines_[ring], true)) {
        if (!std::isnan(v.height_m)) given.push_back(v.height_m);
        found.push_back(options_.surface_m(v.x, v.y));
      }
    }
    const double height_m = median(given.empty() ? found : given);
    if (!given.empty()) {
      const auto [low, high] = std::minmax_element(given.begin(), given.end());
      if (*high - *low > options_.max_change_m) {
        findings_.add("lakes have shores at different heights: the median was taken",
                      fmt::format("feature {} ({:.2f} to {:.2f} m)", origins_[rings.front()].feature.id, *low, *high));
      }
    }
    for (const std::size_t ring : rings) {
      for (BreakVertex& v : lines_[ring]) v.height_m = height_m;
      origins_[ring].has_heights = true;
    }
  }
}

void BreakLineReader::note_meetings(const std::vector<LineMeeting>& meetings) {
  FindingList findings;
  // Neighbouring parcels meet all along their border: the first place of each pair is enough.
  std::map<std::tuple<FeatureId, FeatureId, bool>, std::string> first_place;
  for (const LineMeeting& m : meetings) {
    const auto [a, b] = std::minmax({origins_[m.a].feature, origins_[m.b].feature});
    std::string& example = first_place[{a, b, m.shared_piece}];
    if (example.empty()) {
      example = fmt::format("{} {} {} {}", label(a), a == b ? "with itself" : "and " + label(b),
                            m.shared_piece ? "from" : "at", place(m.x, m.y));
    }
    ++(m.shared_piece ? out_.counts.shared : out_.counts.meetings);
    findings.add(m.shared_piece ? "stretches run on top of each other: kept once"
                                : "places where lines cross, or touch elsewhere than in their ends: cut there",
                 example);
  }
  for (const std::string& line : findings.lines()) out_.notes.push_back("break lines: " + line);
}

/// A vertex at least at every post spacing.
LatticeLine BreakLineReader::densify(const LatticeLine& piece, bool has_heights) const {
  LatticeLine out{piece.front()};
  for (std::size_t i = 1; i < piece.size(); ++i) {
    const BreakVertex &a = piece[i - 1], &b = piece[i];
    const double dx = static_cast<double>(b.x - a.x), dy = static_cast<double>(b.y - a.y);
    const auto n = static_cast<std::int64_t>(
        std::ceil(std::max(std::abs(dx) / options_.dx, std::abs(dy) / options_.dy) - kSlackPosts));
    for (std::int64_t k = 1; k < n; ++k) {
      const double t = static_cast<double>(k) / static_cast<double>(n);
      const BreakVertex v{a.x + std::llround(t * dx), a.y + std::llround(t * dy),
                          has_heights ? std::lerp(a.height_m, b.height_m, t) : kNoHeight};
      if (v.x != out.back().x || v.y != out.back().y) out.push_back(v);
    }
    if (b.x != out.back().x || b.y != out.back().y) out.push_back(b);
  }
  return out;
}

/// Cuts the lines at each other, then makes them dense: in this order lines on top of each other get the same vertices.
/// New vertices are off their segment by up to half a step, so they have to be noded again.
Result<void> BreakLineReader::node() {
  auto first = node_lines(lines_);
  if (!first) return tl::unexpected(first.error());
  note_meetings(first->meetings);
  std::vector<LatticeLine> dense;
  std::size_t n_vertices = 0;
  for (const NodedPiece& piece : first->pieces) {
    const bool has_heights =
        std::any_of(piece.lines.begin(), piece.lines.end(), [&](std::uint32_t l) { return origins_[l].has_heights; });
    dense.push_back(densify(piece.vertices, has_heights));
    n_vertices += dense.back().size();
    if (n_vertices > kMaxLineVertices) {
      return fail(ErrorKind::kInvalidInput,
                  fmt::format("the break lines have more than {} vertices at the posts' spacing; "
                              "give fewer lines",
                              kMaxLineVertices));
    }
  }
  auto second = node_lines(dense);
  if (!second) return tl::unexpected(second.error());
  pieces_ = std::move(second->pieces);
  for (NodedPiece& piece : pieces_) {
    std::vector<std::uint32_t> lines;
    for (const std::uint32_t l : piece.lines)
      lines.insert(lines.end(), first->pieces[l].lines.begin(), first->pieces[l].lines.end());
    std::sort(lines.begin(), lines.end());
    lines.erase(std::unique(lines.begin(), lines.end()), lines.end());
    piece.lines = std::move(lines);
  }
  return {};
}

/// The height of a vertex of a piece of `lines`, within the promise.
double BreakLineReader::limited_height(const BreakVertex& v, const std::vector<std::uint32_t>& lines) {
  const double surface_m = options_.surface_m(v.x, v.y);
  if (std::isnan(v.height_m)) return surface_m;
  const double change_m = std::abs(v.height_m - surface_m);
  if (change_m <= options_.max_change_m) return v.height_m;
  for (const std::uint32_t l : lines) {
    if (!origins_[l].has_heights) continue;
    Change& change = changes_[origins_[l].feature];
    if (change_m > change.largest_m) change = {change_m, v.x, v.y};
  }
  return std::clamp(v.height_m, surface_m - options_.max_change_m, surface_m + options_.max_change_m);
}

BreakLines BreakLineReader::finish() {
  // A lake's height wins at its shore's nodes, the lower of two lakes'.
  std::map<LatticeXy, double> shore_nodes;
  std::set<LatticeXy> nodes;
  const auto is_shore = [&](const NodedPiece& piece) {
    return std::any_of(piece.lines.begin(), piece.lines.end(), [&](std::uint32_t l) { return origins_[l].is_shore; });
  };
  for (NodedPiece& piece : pieces_) {
    if (!is_shore(piece)) continue;
    double height_m = kNoHeight;
    for (const std::uint32_t l : piece.lines) {
      if (origins_[l].is_shore) height_m = std::fmin(height_m, lines_[l].front().height_m);
    }
    for (BreakVertex& v : piece.vertices) v.height_m = height_m;
    for (const BreakVertex* v : {&piece.vertices.front(), &piece.vertices.back()}) {
      const auto at = shore_nodes.try_emplace({v->x, v->y}, height_m).first;
      at->second = std::min(at->second, height_m);
    }
  }
  std::vector<KindChain> chains;
  for (const NodedPiece& piece : pieces_) {
    KindChain& chain = chains.emplace_back();
    chain.is_shore = is_shore(piece);
    chain.chain.weight = options_.weight;
    for (std::size_t i = 0; i < piece.vertices.size(); ++i) {
      BreakVertex v = piece.vertices[i];
      const bool is_node = i == 0 || i + 1 == piece.vertices.size();
      if (is_node) {
        if (const auto at = shore_nodes.find({v.x, v.y}); at != shore_nodes.end()) v.height_m = at->second;
      }
      const double height_m = limited_height(v, piece.lines);
      const bool is_new = !is_node || nodes.insert({v.x, v.y}).second;
      if (is_new && !std::isnan(v.height_m) && height_m != v.height_m) {
        ++out_.counts.limited;
        out_.counts.largest_change_m = std::max(out_.counts.largest_change_m, std::abs(height_m - v.height_m));
      }
      chain.chain.vertices.push_back({v.x, v.y, height_m});
    }
  }
  for (KindChain& joined : join_chains(std::move(chains))) {
    out_.counts.vertices += static_cast<std::int64_t>(joined.chain.vertices.size());
    out_.chains.push_back(std::move(joined.chain));
    out_.is_shore.push_back(joined.is_shore);
  }
  if (out_.chains.empty()) out_.notes.emplace_back("break lines: nothing is left to follow");
  if (!changes_.empty()) {
    std::vector<std::pair<FeatureId, Change>> worst(changes_.begin(), changes_.end());
    std::stable_sort(worst.begin(), worst.end(),
                     [](const auto& a, const auto& b) { return a.second.largest_m > b.second.largest_m; });
    std::vector<std::string> examples;
    for (std::size_t i = 0; i < std::min(worst.size(), FindingList::kMaxExamples); ++i) {
      const auto& [feature, change] = worst[i];
      examples.push_back(
          fmt::format("{} by {:.2f} m at {}", label(feature), change.largest_m, place(change.x, change.y)));
    }
    out_.notes.push_back(
        fmt::format("break lines: {} vertices of {} features are off the surface by more than {:g} m and were moved "
                    "that near, for the "
                    "promise at the posts stands; farthest off: {}{}",
                    out_.counts.limited, worst.size(), options_.max_change_m, fmt::join(examples, ", "),
                    worst.size() > examples.size() ? ", ..." : ""));
  }
  return std::move(out_);
}

}  // namespace

BreakLineOptions break_line_options(const HeightField& field, double max_change_m) {
  BreakLineOptions options;
  options.lattice = field.lattice;
  options.dx = field.dx;
  options.dy = field.dy;
  options.wraps = field.wraps;
  options.max_change_m = max_change_m;
  options.surface_m = [&field](std::int64_t x, std::int64_t y) {
    return field.lattice.height_m(field.lattice_height(x, y));
  };
  std::int64_t south = field.n_rows - 1, north = 0, west = field.n_cols - 1, east = 0;
  for (std::int64_t r = 0; r < field.n_rows; ++r) {
    for (std::int64_t c = 0; c < field.n_cols; ++c) {
      const PostOrigin origin = field.origin_at(r, c);
      if (origin == PostOrigin::kBase || origin == PostOrigin::kFalloff) continue;
      south = std::min(south, r);
      north = std::max(north, r);
      west = std::min(west, c);
      east = std::max(east, c);
    }
  }
  const auto inward = [](double low, double high) {
    return std::pair{static_cast<std::int64_t>(std::ceil(low)), static_cast<std::int64_t>(std::floor(high))};
  };
  std::tie(options.west_x, options.east_x) = inward(field.post_x(west), field.post_x(east));
  std::tie(options.south_y, options.north_y) = inward(field.post_y(south), field.post_y(north));
  if (field.wraps) {
    options.west_x = static_cast<std::int64_t>(std::ceil(field.x0));
    options.east_x = options.west_x + field.lattice.width();
  }
  return options;
}

Result<BreakLines> read_break_lines(std::span<const BreakLineFile> files, const BreakLineOptions& options) {
  BreakLineReader reader(options);
  for (const BreakLineFile& file : files) {
    if (auto added = reader.add(file); !added) return tl::unexpected(added.error());
  }
  if (auto noded = reader.node(); !noded) return tl::unexpected(noded.error());
  return reader.finish();
}

}  // namespace tind
