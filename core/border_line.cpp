// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/border_line.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <optional>

#include "core/format/quantized_mesh.hpp"

namespace tind {
namespace {

struct Sample {
  double t = 0;
  double height_m = 0;
  /// What the tile's surface may differ from the line's at the post: as it lies off the line (at most half a lattice
  /// step), its share of the rise to the posts beside it, across the line...
  double rise_m = 0;
  double off_line = 0;  ///< ...and of twice the tolerance: its distance from the line in post spacings.
};

class RootEdgeRefiner {
 public:
  RootEdgeRefiner(const HeightField& field, const RefinementSpec& spec, const RootEdge& root,
                  std::span<const LineCrossing> crossings, const std::function<bool(int, std::int64_t)>& is_split)
      : field_(field), spec_(spec), root_(root), crossings_(crossings), is_split_(is_split) {
    find_posts_on_line();
    collect_samples();
    collect_points();
  }

  std::vector<LineVertex> run(std::span<const std::int64_t> pins) {
    const std::int64_t end = root_.start + field_.lattice.tile_side(root_.level);
    std::vector<LineVertex> inherited = {make_vertex(root_.start, root_.level)};
    for (const std::int64_t t : pins) inherited.push_back(make_vertex(t, root_.level));
    inherited.push_back(make_vertex(end, root_.level));
    sort_unique(inherited);
    std::vector<LineVertex> out;
    refine(root_.level, root_.start, std::move(inherited), out);
    return out;
  }

 private:
  double x_of(double t) const { return root_.vertical ? static_cast<double>(root_.at) : t; }
  double y_of(double t) const { return root_.vertical ? t : static_cast<double>(root_.at); }

  LineVertex make_vertex(std::int64_t t, int entry) const {
    const std::int64_t x = root_.vertical ? root_.at : t, y = root_.vertical ? t : root_.at;
    return {t, field_.lattice_height(x, y), static_cast<std::uint8_t>(entry)};
  }

  static void sort_unique(std::vector<LineVertex>& vertices) {
    std::stable_sort(vertices.begin(), vertices.end(), [](const auto& a, const auto& b) { return a.t < b.t; });
    vertices.erase(
        std::unique(vertices.begin(), vertices.end(), [](const auto& a, const auto& b) { return a.t == b.t; }),
        vertices.end());
  }

  // Posts that round onto the line cannot become vertices of the tiles beside it: the line itself answers for them.
  void find_posts_on_line() {
    const double first = root_.vertical ? field_.x0 : field_.y0, step = root_.vertical ? field_.dx : field_.dy;
    const std::int64_t n = root_.vertical ? field_.n_cols : field_.n_rows;
    const double width = static_cast<double>(field_.lattice.width());
    for (const double turn : {-width, 0.0, width}) {
      if (!root_.vertical && turn != 0.0) continue;
      const double u = (static_cast<double>(root_.at) + turn - first) / step, nearest = std::round(u);
      if (nearest < 0 || nearest >= static_cast<double>(n) || std::abs(u - nearest) * step > 0.5) continue;
      across_ = static_cast<std::int64_t>(nearest);
      off_line_ = std::abs(u - nearest);
    }
  }

  // The sample at post row or column `k`, at t.
  Sample make_sample(std::int64_t k, double t) const {
    if (across_ < 0) return {t, field_.sample_m(x_of(t), y_of(t)), 0, 0};
    const std::int64_t n = root_.vertical ? field_.n_cols : field_.n_rows;
    const auto height_at = [&](std::int64_t across) {
      return root_.vertical ? field_.height_at(k, across) : field_.height_at(across, k);
    };
    Sample sample{t, height_at(across_), 0, off_line_};
    for (std::int64_t beside : {across_ - 1, across_ + 1}) {
      if (root_.vertical && field_.wraps) beside = (beside + n) % n;
      if (beside < 0 || beside >= n) continue;
      sample.rise_m = std::max(sample.rise_m, off_line_ * std::abs(height_at(beside) - sample.height_m));
    }
    return sample;
  }

  // Crossings of the line with post rows or columns, in order of t.
  void collect_samples() {
    const double begin = static_cast<double>(root_.start);
    const double end = begin + static_cast<double>(field_.lattice.tile_side(root_.level));
    const double first = root_.vertical ? field_.y0 : field_.x0, step = root_.vertical ? field_.dy : field_.dx;
    const std::int64_t n = root_.vertical ? field_.n_rows : field_.n_cols;
    const double width = static_cast<double>(field_.lattice.width());
    // The grid may run past longitude 180: look at it one turn to the west and to the east, too.
    const std::array<double, 3> shifts = {-width, 0.0, width};
    for (const double shift : shifts) {
      if (root_.vertical && shift != 0.0) continue;
      const auto low = std::max<std::int64_t>(0, static_cast<std::int64_t>(std::ceil((begin - first - shift) / step)));
      const auto high =
          std::min<std::int64_t>(n - 1, static_cast<std::int64_t>(std::floor((end - first - shift) / step)));
      for (std::int64_t k = low; k <= high; ++k) {
        const double t = first + static_cast<double>(k) * step + shift;
        if (!field_.covers(x_of(t), y_of(t))) continue;
        samples_.push_back(make_sample(k, t));
      }
    }
    std::stable_sort(samples_.begin(), samples_.end(), [](const Sample& a, const Sample& b) { return a.t < b.t; });
  }

  // Irregular posts that round onto the line: they cannot become vertices of the tiles beside it.
  void collect_points() {
    if (field_.points.empty()) return;
    const double at = static_cast<double>(root_.at), start = static_cast<double>(root_.start);
    const double end = start + static_cast<double>(field_.lattice.tile_side(root_.level));
    const double width = static_cast<double>(field_.lattice.width());
    const double spacing = root_.vertical ? field_.dx : field_.dy;
    for (const double turn : {0.0, width}) {
      const double shift_x = turn, west = (root_.vertical ? at - 1 : start - 1) + shift_x;
      const double east = (root_.vertical ? at + 1 : end + 1) + shift_x;
      field_.points.for_blocks(
          west, root_.vertical ? start - 1 : at - 1, east, root_.vertical ? end + 1 : at + 1, [&](const PointPost& p) {
            const double x = p.x - shift_x;
            const double across = root_.vertical ? x : p.y, t = root_.vertical ? p.y : x;
            if (std::llround(across) != root_.at || t < start || t > end) return;
            samples_.push_back({t, static_cast<double>(p.height_m), 0, std::abs(across - at) / spacing});
          });
    }
    std::stable_sort(samples_.begin(), samples_.end(), [](const Sample& a, const Sample& b) { return a.t < b.t; });
  }

  // `vertices`: those inherited for the edge of `level` at `start`, both corners included. Appends all of the edge's
  // vertices to `out`; a corner that is already there is not repeated.
  void refine(int level, std::int64_t start, std::vector<LineVertex> vertices, std::vector<LineVertex>& out) {
    const std::int64_t side = field_.lattice.tile_side(level);
    const int segments = spec_.seed_segments[static_cast<std::size_t>(level)];
    for (int k = 1; k < segments; ++k) vertices.push_back(make_vertex(start + side / segments * k, level));
    for (const LineCrossing& c : crossings_) {
      if (c.entry == level && c.t > start && c.t < start + side) vertices.push_back(make_vertex(c.t, level));
    }
    sort_unique(vertices);  // stable: what was inherited keeps its entry level

    std::vector<LineVertex> refined;
    for (std::size_t k = 0; k + 1 < vertices.size(); ++k) {
      refined.push_back(vertices[k]);
      split(level, vertices[k], vertices[k + 1], refined);
    }
    refined.push_back(vertices.back());

    if (level < spec_.bottom_level() && is_split_(level, start)) {
      const std::int64_t middle = start + side / 2;
      refined.push_back(make_vertex(middle, level + 1));
      sort_unique(refined);
      const auto at = std::lower_bound(refined.begin(), refined.end(), middle,
                                       [](const LineVertex& v, std::int64_t t) { return v.t < t; });
      refine(level + 1, start, std::vector<LineVertex>(refined.begin(), at + 1), out);
      refine(level + 1, middle, std::vector<LineVertex>(at, refined.end()), out);
      return;
    }
    if (!out.empty() && out.back().t == refined.front().t) out.pop_back();
    out.insert(out.end(), refined.begin(), refined.end());
  }

  // Greedy insertion between a and b: worst sample first, then both halves. Appends what it inserts, in order.
  void split(int level, const LineVertex& a, const LineVertex& b, std::vector<LineVertex>& out) const {
    LineVertex left = a;
    std::vector<LineVertex> ends = {b};  // no recursion: halves may be as uneven as the samples wish
    while (!ends.empty()) {
      if (const auto middle = worst_between(level, left, ends.back())) {
        ends.push_back(*middle);
        continue;
      }
      left = ends.back();
      ends.pop_back();
      if (!ends.empty()) out.push_back(left);
    }
  }

  // A vertex at the worst sample between a and b, if one is beyond the tolerance.
  std::optional<LineVertex> worst_between(int level, const LineVertex& a, const LineVertex& b) const {
    const double tolerance = spec_.tolerance_m[static_cast<std::size_t>(level)];
    const double a_t = static_cast<double>(a.t), b_t = static_cast<double>(b.t);
    const double a_m = field_.lattice.height_m(a.z), b_m = field_.lattice.height_m(b.z);
    const double slope = (b_m - a_m) / (b_t - a_t);
    // Quantized-mesh rounds positions to 1/32767 of the side and heights to the level's step: samples are held to the
    // tolerance against that line, too.
    const std::int64_t side = field_.lattice.tile_side(level);
    const auto served = [&](const LineVertex& v) {
      const std::int64_t corner = v.t / side * side;
      return static_cast<double>(corner) +
             served_position(static_cast<double>(v.t - corner), static_cast<double>(side));
    };
    const double height_step = spec_.height_step_m[static_cast<std::size_t>(level)];
    const double served_a = served(a), served_length = served(b) - served_a;
    const double served_a_m = round_to_step(a_m, height_step), served_b_m = round_to_step(b_m, height_step);
    const double served_slope = served_length > 0 ? (served_b_m - served_a_m) / served_length : slope;
    double worst = tolerance;
    std::int64_t worst_t = 0;
    bool found = false;
    const auto consider = [&](double t, double height_m, double rise_m, double off_line) {
      // A post off the line sees the tile's surface, which within the tolerance climbs as steeply as its neighbours do.
      const double off_line_m = rise_m + off_line * 2 * tolerance;
      const double error = std::max(std::abs(a_m + slope * (t - a_t) - height_m),
                                    std::abs(served_a_m + served_slope * (t - served_a) - height_m)) +
                           off_line_m;
      if (error <= worst) return;
      const std::int64_t rounded = std::llround(t);
      if (rounded <= a.t || rounded >= b.t) return;  // a vertex is there already
      worst = error;
      worst_t = rounded;
      found = true;
    };
    auto sample =
        std::upper_bound(samples_.begin(), samples_.end(), a_t, [](double t, const Sample& s) { return t < s.t; });
    for (; sample != samples_.end() && sample->t < b_t; ++sample) {
      consider(sample->t, sample->height_m, sample->rise_m, sample->off_line);
    }
    const double base = field_.base_height_m;
    if (std::abs(a_m - base) > tolerance || std::abs(b_m - base) > tolerance) {
      const std::int64_t step = side / kCellsPerTile;
      for (std::int64_t t = (a.t / step + 1) * step; t < b.t; t += step) {
        const double real_t = static_cast<double>(t);
        if (!field_.covers(x_of(real_t), y_of(real_t))) consider(real_t, base, 0, 0);
      }
    }
    if (!found) return std::nullopt;
    return make_vertex(worst_t, level);
  }

  const HeightField& field_;
  const RefinementSpec& spec_;
  const RootEdge root_;
  const std::span<const LineCrossing> crossings_;
  const std::function<bool(int, std::int64_t)>& is_split_;
  std::vector<Sample> samples_;
  std::int64_t across_ = -1;  // the post row or column that rounds onto the line
  double off_line_ = 0;       // its distance from the line, in post spacings
};

}  // namespace

std::vector<LineVertex> refine_root_edge(const HeightField& field, const RefinementSpec& spec, const RootEdge& root,
                                         std::span<const std::int64_t> pins, std::span<const LineCrossing> crossings,
                                         const std::function<bool(int, std::int64_t)>& is_split) {
  return RootEdgeRefiner(field, spec, root, crossings, is_split).run(pins);
}

std::span<const LineVertex> line_between(std::span<const LineVertex> line, std::int64_t start, std::int64_t end) {
  const auto first =
      std::lower_bound(line.begin(), line.end(), start, [](const LineVertex& v, std::int64_t t) { return v.t < t; });
  const auto last =
      std::upper_bound(first, line.end(), end, [](std::int64_t t, const LineVertex& v) { return t < v.t; });
  return {first, last};
}

EdgeChain edge_of_level(std::span<const LineVertex> part, int level) {
  assert(part.size() >= 2 && part.front().entry <= level && part.back().entry <= level);
  EdgeChain edge;
  edge.start_entry = part.front().entry;
  edge.end_entry = part.back().entry;
  for (const LineVertex& v : part.subspan(1, part.size() - 2)) {
    if (v.entry <= level) edge.inner.push_back({v.t - part.front().t, v.z, v.entry});
  }
  return edge;
}

std::vector<EnvelopeKnot> envelope_of(std::span<const LineVertex> part, int level, const Lattice& lattice) {
  std::vector<EnvelopeKnot> knots;
  knots.reserve(part.size());
  int deepest = level;
  for (const LineVertex& v : part) {
    const double own = lattice.height_m(v.z);
    knots.push_back({static_cast<double>(v.t), own, own, own});
    deepest = std::max<int>(deepest, v.entry);
  }
  // B_deepest passes through every vertex; coarser polylines are chords over the vertices that they lack.
  for (int g = level; g < deepest; ++g) {
    for (std::size_t a = 0; a + 1 < part.size();) {
      std::size_t b = a + 1;
      while (part[b].entry > g) ++b;
      const double a_m = lattice.height_m(part[a].z), b_m = lattice.height_m(part[b].z);
      for (std::size_t k = a + 1; k < b; ++k) {
        const double value = a_m + (b_m - a_m) * (knots[k].t - knots[a].t) / (knots[b].t - knots[a].t);
        knots[k].high_m = std::max(knots[k].high_m, value);
        knots[k].low_m = std::min(knots[k].low_m, value);
        if (g == level) knots[k].own_m = value;
      }
      a = b;
    }
  }
  return knots;
}

}  // namespace tind
