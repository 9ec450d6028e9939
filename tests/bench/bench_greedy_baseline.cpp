// SPDX-License-Identifier: GPL-3.0-or-later
// Plain greedy triangulation of all posts of a DEM in ONE mesh (Garland & Heckbert 1995): no tiles, borders, seeds,
// nesting or guard. What a pyramid's level costs more than this is the price of seams and levels.
//   bench_greedy_baseline DEM TOLERANCE_M...         prints the vertices for each tolerance
//   bench_greedy_baseline DEM --report REPORT.json   adds the overhead to each level of a report of tind-build and
//   prints it

#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <nlohmann/json.hpp>
#include <queue>
#include <string>
#include <string_view>
#include <tuple>
#include <vector>

#include "storage/readers/gdal_raster.hpp"
#include "storage/readers/height_grid.hpp"

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using VertexBase = CGAL::Triangulation_vertex_base_with_info_2<double, Kernel>;  // height
using FaceBase = CGAL::Triangulation_face_base_with_info_2<unsigned, Kernel>;    // stamp
using Mesh = CGAL::Delaunay_triangulation_2<Kernel, CGAL::Triangulation_data_structure_2<VertexBase, FaceBase>>;

struct Candidate {
  double error;
  long row, column;
  unsigned stamp;
  Mesh::Face_handle face;
  bool operator<(const Candidate& other) const {
    return std::tuple(error, -row, -column) < std::tuple(other.error, -other.row, -other.column);
  }
};

class Greedy {
 public:
  Greedy(const tind::HeightField& field, double tolerance) : field_(field), tolerance_(tolerance) {
    // The source's own posts: the grid less its rim of falloff.
    while (field_.origin_at(field_.n_rows / 2, first_column_) != tind::PostOrigin::kSource) ++first_column_;
    while (field_.origin_at(first_row_, field_.n_cols / 2) != tind::PostOrigin::kSource) ++first_row_;
    last_column_ = field_.n_cols - 1 - first_column_;
    last_row_ = field_.n_rows - 1 - first_row_;
  }

  std::size_t run() {
    for (const long r : {first_row_, last_row_}) {
      for (const long c : {first_column_, last_column_}) insert(r, c, {});
    }
    for (auto f : mesh_.finite_face_handles()) scan(f);
    while (!heap_.empty()) {
      const Candidate best = heap_.top();
      heap_.pop();
      if (best.stamp != best.face->info()) continue;
      const auto v = insert(best.row, best.column, best.face);
      auto f = mesh_.incident_faces(v);
      const auto end = f;
      do {
        if (!mesh_.is_infinite(f)) scan(f);
      } while (++f != end);
    }
    return mesh_.number_of_vertices();
  }

 private:
  Mesh::Vertex_handle insert(long r, long c, Mesh::Face_handle hint) {
    const auto v = mesh_.insert(Kernel::Point_2(static_cast<double>(c), static_cast<double>(r)), hint);
    v->info() = field_.height_at(r, c);
    return v;
  }

  void scan(Mesh::Face_handle f) {
    const unsigned stamp = ++f->info();
    const auto &a = f->vertex(0)->point(), &b = f->vertex(1)->point(), &c = f->vertex(2)->point();
    const double za = f->vertex(0)->info(), bz = f->vertex(1)->info() - za, cz = f->vertex(2)->info() - za;
    const double bx = b.x() - a.x(), by = b.y() - a.y(), cx = c.x() - a.x(), cy = c.y() - a.y();
    const double area = bx * cy - by * cx, sx = (bz * cy - cz * by) / area, sy = (cz * bx - bz * cx) / area;
    const auto [y_low, y_high] = std::minmax({a.y(), b.y(), c.y()});
    Candidate best{tolerance_, 0, 0, stamp, f};
    for (long r = static_cast<long>(y_low); r <= static_cast<long>(y_high); ++r) {
      double left = INFINITY, right = -INFINITY;
      const auto cut = [&](const Kernel::Point_2& p, const Kernel::Point_2& q) {
        const double y = static_cast<double>(r);
        if (std::min(p.y(), q.y()) > y || std::max(p.y(), q.y()) < y) return;
        for (const double x : {p.y() == q.y() ? p.x() : p.x() + (q.x() - p.x()) * (y - p.y()) / (q.y() - p.y()),
                               p.y() == q.y() ? q.x() : p.x() + (q.x() - p.x()) * (y - p.y()) / (q.y() - p.y())}) {
          left = std::min(left, x);
          right = std::max(right, x);
        }
      };
      cut(a, b);
      cut(b, c);
      cut(c, a);
      for (long k = static_cast<long>(std::ceil(left - 1e-9)); k <= static_cast<long>(std::floor(right + 1e-9)); ++k) {
        const double z = za + sx * (static_cast<double>(k) - a.x()) + sy * (static_cast<double>(r) - a.y());
        const double error = std::abs(z - field_.height_at(r, k));
        if (error > best.error) {
          best.error = error;
          best.row = r;
          best.column = k;
        }
      }
    }
    if (best.error > tolerance_) heap_.push(best);
  }

  const tind::HeightField& field_;
  const double tolerance_;
  long first_column_ = 0, first_row_ = 0, last_column_ = 0, last_row_ = 0;
  Mesh mesh_;
  std::priority_queue<Candidate> heap_;
};

// Levels whose plain mesh is smaller than this say nothing: there seeds and corners are all there is.
constexpr std::size_t kFewVertices = 200;

int add_to_report(const tind::HeightField& field, const std::string& path) {
  nlohmann::json report = nlohmann::json::parse(std::ifstream(path));
  fmt::print("{:>5} {:>10} {:>10} {:>10} {:>9} {:>7} {:>8} {:>10} {:>12}\n", "level", "E_L m", "plain", "tind",
             "outside", "seeds", "border", "overhead %", "apart from *");
  for (auto& level : report["levels"]) {
    const auto plain = Greedy(field, level["tolerance_m"]).run();
    const auto count = [&](const char* name) { return level[name].get<double>(); };
    const double vertices = count("vertices") - count("vertices_outside");
    const double border = count("vertices_border") + count("vertices_corner");
    const double percent = 100 * (vertices / static_cast<double>(plain) - 1);
    const double apart = 100 * ((vertices - border - count("vertices_seed")) / static_cast<double>(plain) - 1);
    level["vertices_plain_greedy"] = plain;
    level["overhead_percent"] = percent;
    level["overhead_percent_without_borders_and_seeds"] = apart;
    fmt::print("{:>5} {:>10.2f} {:>10} {:>10} {:>9} {:>7} {:>8} ", level["level"].get<int>(), count("tolerance_m"),
               plain, count("vertices"), count("vertices_outside"), count("vertices_seed"), border);
    if (plain < kFewVertices) {
      fmt::print("{:>10} {:>12}\n", "-", "-");
    } else {
      fmt::print("{:>10.2f} {:>12.2f}\n", percent, apart);
    }
  }
  fmt::print(
      "plain: one mesh over all posts, no tiles. overhead: of the vertices inside the data.\n"
      "* borders (corners among them) and seeds taken out of the count.\n");
  std::ofstream(path) << report.dump(2) << "\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    fmt::print(stderr, "usage: bench_greedy_baseline DEM TOLERANCE_M... | DEM --report REPORT.json\n");
    return 2;
  }
  const auto mosaic = tind::RasterMosaic::open({argv[1]}, {});
  if (!mosaic) {
    fmt::print(stderr, "bench_greedy_baseline: {}\n", mosaic.error().message);
    return 1;
  }
  tind::Lattice lattice;
  lattice.level = 12;
  tind::HeightGridOptions options;
  options.scratch_dir = ".";
  const auto grid = tind::HeightGrid::load(*mosaic, lattice, options, [](double) {});
  if (!grid) {
    fmt::print(stderr, "bench_greedy_baseline: {}\n", grid.error().message);
    return 1;
  }
  if (std::string_view(argv[2]) == "--report" && argc == 4) return add_to_report(grid->field(), argv[3]);
  for (int i = 2; i < argc; ++i) {
    const double tolerance = std::atof(argv[i]);
    fmt::print("{} {}\n", tolerance, Greedy(grid->field(), tolerance).run());
  }
}
