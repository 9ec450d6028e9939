// SPDX-License-Identifier: GPL-3.0-or-later
// The reference: plain greedy triangulation of all posts of a DEM in ONE mesh with CGAL (Garland & Heckbert 1995): no
// tiles, borders, seeds, nesting or guard. What a pyramid's level costs more than this is the price of seams and
// levels. It is to be as fast as plain CGAL allows; what was tried is in docs/performance.md.
//   bench_greedy_baseline [--own-predicates] DEM TOLERANCE_M...
//                                                    prints vertices and processor seconds, a JSON object a line
//   bench_greedy_baseline DEM --report REPORT.json   adds the overhead to each level of a report of tind-build and
//   prints it

#include <CGAL/Delaunay_triangulation_2.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Simple_cartesian.h>
#include <CGAL/Triangulation_face_base_with_info_2.h>
#include <CGAL/Triangulation_vertex_base_with_info_2.h>
#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "storage/readers/gdal_raster.hpp"

namespace {

/// Heights in metres, n_rows x n_cols row-major; NaN is a void.
struct Posts {
  std::vector<float> heights_m;
  long n_rows = 0, n_cols = 0;
};

using PlainKernel = CGAL::Exact_predicates_inexact_constructions_kernel;

// What is left to gain by leaving plain CGAL (--own-predicates). Positions are whole numbers below 2^15, so doubles and
// the test below decide exactly what CGAL's exact kernel decides, at less cost. Points on one circle keep the diagonal
// that they have: CGAL's symbolic perturbation prefers one direction on a grid, which makes 4 % more vertices, and
// takes time.
constexpr long kMostPostsPerSide = 1 << 15;

struct GridKernel : CGAL::Simple_cartesian<double> {
  struct Side_of_oriented_circle_2 {
    using result_type = CGAL::Oriented_side;
    CGAL::Oriented_side operator()(const Point_2& a, const Point_2& b, const Point_2& c, const Point_2& d) const {
      const double ax = a.x() - d.x(), ay = a.y() - d.y(), bx = b.x() - d.x(), by = b.y() - d.y(), cx = c.x() - d.x(),
                   cy = c.y() - d.y();
      const double a2 = ax * ax + ay * ay, b2 = bx * bx + by * by, c2 = cx * cx + cy * cy;
      const double det = a2 * (bx * cy - by * cx) + b2 * (cx * ay - cy * ax) + c2 * (ax * by - ay * bx);
      // No rounding where the points are close to each other; 2^13 is more than all rounding below 2^62.
      if (a2 + b2 + c2 < 0x1p25 || std::abs(det) > 0x1p13) {
        return det > 0 ? CGAL::ON_POSITIVE_SIDE : CGAL::ON_NEGATIVE_SIDE;
      }
      return exact_determinant({ax, ay, bx, by, cx, cy}) > 0 ? CGAL::ON_POSITIVE_SIDE : CGAL::ON_NEGATIVE_SIDE;
    }

   private:
    // Of a determinant that is known to be small: modulo 2^64 it stays what it is.
    static std::int64_t exact_determinant(const std::array<double, 6>& v) {
      std::array<std::uint64_t, 6> n;
      for (std::size_t k = 0; k < 6; ++k) n[k] = static_cast<std::uint64_t>(static_cast<std::int64_t>(v[k]));
      const auto [ax, ay, bx, by, cx, cy] = n;
      return static_cast<std::int64_t>((ax * ax + ay * ay) * (bx * cy - by * cx) +
                                       (bx * bx + by * by) * (cx * ay - cy * ax) +
                                       (cx * cx + cy * cy) * (ax * by - ay * bx));
    }
  };
  Side_of_oriented_circle_2 side_of_oriented_circle_2_object() const { return {}; }
};

/// The worst post of a face. `key`: the bits of its error (f32, positive, so they order as it does), then the inverted
/// index of the post. An entry is out of date when its face has another key by now.
template <class FaceHandle>
struct Candidate {
  std::uint64_t key;
  FaceHandle face;
};

/// Candidates by error, in buckets 1/2048 of an octave wide, the last pushed first within one: one cache line an entry
/// where a heap of a million takes twenty.
template <class Candidate>
class BucketQueue {
 public:
  bool empty() const { return size_ == 0; }
  void push(const Candidate& candidate) {
    const std::size_t bucket = candidate.key >> kShift;
    buckets_[bucket].push_back(candidate);
    top_ = std::max(top_, bucket);
    ++size_;
  }
  Candidate pop() {
    while (buckets_[top_].empty()) --top_;
    const Candidate best = buckets_[top_].back();
    buckets_[top_].pop_back();
    --size_;
    return best;
  }

 private:
  static constexpr int kShift = 32 + 23 - 11;
  std::vector<std::vector<Candidate>> buckets_ = std::vector<std::vector<Candidate>>(std::size_t{1} << (63 - kShift));
  std::size_t top_ = 0, size_ = 0;
};

using Floats = float __attribute__((vector_size(16)));
using Ints = std::int32_t __attribute__((vector_size(16)));

// Positions in posts.
struct Corner {
  int x, y;
  float z;
};

template <class Kernel>
class Greedy {
  using VertexBase = CGAL::Triangulation_vertex_base_with_info_2<float, Kernel>;      // height
  using FaceBase = CGAL::Triangulation_face_base_with_info_2<std::uint64_t, Kernel>;  // key of its candidate
  using Mesh = CGAL::Delaunay_triangulation_2<Kernel, CGAL::Triangulation_data_structure_2<VertexBase, FaceBase>>;
  using FaceHandle = typename Mesh::Face_handle;
  using VertexHandle = typename Mesh::Vertex_handle;

 public:
  Greedy(const Posts& posts, double tolerance_m) : posts_(posts), tolerance_m_(static_cast<float>(tolerance_m)) {}

  std::size_t run() {
    for (const long r : {0L, posts_.n_rows - 1}) {
      for (const long c : {0L, posts_.n_cols - 1}) set_height(mesh_.insert(point(r, c)), r, c);
    }
    for (const auto f : mesh_.finite_face_handles()) scan(f);
    while (!queue_.empty()) {
      const Candidate<FaceHandle> best = queue_.pop();
      if (best.face->info() != best.key) continue;
      const std::uint32_t index = ~static_cast<std::uint32_t>(best.key);
      const auto v = insert(index / static_cast<std::uint32_t>(posts_.n_cols),
                            index % static_cast<std::uint32_t>(posts_.n_cols), best.face);
      auto f = mesh_.incident_faces(v);
      const auto end = f;
      do {
        if (!mesh_.is_infinite(f)) scan(f);
      } while (++f != end);
    }
    return mesh_.number_of_vertices();
  }

 private:
  static typename Kernel::Point_2 point(long r, long c) { return {static_cast<double>(c), static_cast<double>(r)}; }

  void set_height(VertexHandle v, long r, long c) const {
    const float z = posts_.heights_m[static_cast<std::size_t>(r * posts_.n_cols + c)];
    v->info() = z == z ? z : 0.0f;
  }

  // The post lies in the face or on one of its edges: told here, so that CGAL need not look for it.
  VertexHandle insert(long r, long c, FaceHandle face) {
    std::array<double, 3> x, y;
    for (int k = 0; k < 3; ++k) {
      x[k] = face->vertex(k)->point().x() - static_cast<double>(c);
      y[k] = face->vertex(k)->point().y() - static_cast<double>(r);
    }
    int edge = -1;
    for (int k = 0; k < 3; ++k) {
      const int a = Mesh::ccw(k), b = Mesh::cw(k);
      if (x[a] * y[b] == x[b] * y[a]) edge = k;
    }
    const auto v = mesh_.insert(point(r, c), edge < 0 ? Mesh::FACE : Mesh::EDGE, face, edge);
    set_height(v, r, c);
    return v;
  }

  void scan(FaceHandle f) {
    f->info() = 0;
    std::array<Corner, 3> v;
    for (int k = 0; k < 3; ++k) {
      const auto& p = f->vertex(k)->point();
      v[k] = {static_cast<int>(p.x()), static_cast<int>(p.y()), f->vertex(k)->info()};
    }
    const Corner o = v[0];
    const double bx = v[1].x - o.x, by = v[1].y - o.y, cx = v[2].x - o.x, cy = v[2].y - o.y;
    const double twice_area = bx * cy - by * cx;
    if (twice_area == 1) return;  // no posts but the corners (Pick's theorem)
    const double bz = v[1].z - o.z, cz = v[2].z - o.z;
    const auto slope_x = static_cast<float>((bz * cy - cz * by) / twice_area);
    const auto slope_y = static_cast<float>((cz * bx - bz * cx) / twice_area);
    if (v[0].y > v[1].y) std::swap(v[0], v[1]);
    if (v[1].y > v[2].y) std::swap(v[1], v[2]);
    if (v[0].y > v[1].y) std::swap(v[0], v[1]);
    const auto steps = [](const Corner& p, const Corner& q) {
      return q.y > p.y ? static_cast<double>(q.x - p.x) / (q.y - p.y) : 0.0;
    };
    const double long_side = steps(v[0], v[2]), lower = steps(v[0], v[1]), upper = steps(v[1], v[2]);
    float worst = tolerance_m_;
    std::uint32_t at = 0;
    for (int r = v[0].y; r <= v[2].y; ++r) {
      double left = v[0].x + long_side * (r - v[0].y);
      double right = r < v[1].y ? v[0].x + lower * (r - v[0].y) : v[1].x + upper * (r - v[1].y);
      if (left > right) std::swap(left, right);
      // Posts on an edge count for both faces. A post off an edge is 2^-15 or more away.
      left -= 1e-6;
      const int floor = static_cast<int>(left), first = floor + (floor < left), last = static_cast<int>(right + 1e-6);
      const std::int64_t row = std::int64_t{r} * posts_.n_cols;
      const float* heights = posts_.heights_m.data() + row;
      const float z = o.z + slope_y * static_cast<float>(r - o.y);
      const auto error = [&](int c) { return std::abs(z + slope_x * static_cast<float>(c - o.x) - heights[c]); };
      int c = first;
      if (last - first >= 7) {  // four at a time; which one it was only where there is a worse one
        Floats most = {0, 0, 0, 0};
        for (; c + 3 <= last; c += 4) {
          Floats h;
          std::memcpy(&h, heights + c, sizeof h);
          const Floats off = z + slope_x * (static_cast<float>(c - o.x) + Floats{0, 1, 2, 3}) - h;
          const Floats size = std::bit_cast<Floats>(std::bit_cast<Ints>(off) & 0x7fffffff);
          most = size > most ? size : most;
        }
        if (std::max(std::max(most[0], most[1]), std::max(most[2], most[3])) > worst) c = first;
      }
      for (; c <= last; ++c) {
        const float e = error(c);
        if (e > worst) {
          worst = e;
          at = static_cast<std::uint32_t>(row + c);
        }
      }
    }
    if (worst <= tolerance_m_) return;
    f->info() = std::uint64_t{std::bit_cast<std::uint32_t>(worst)} << 32 | ~at;
    queue_.push({f->info(), f});
  }

  const Posts& posts_;
  const float tolerance_m_;
  Mesh mesh_;
  BucketQueue<Candidate<FaceHandle>> queue_;
};

/// Processor seconds of this process so far, user and system.
double processor_s() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

// Levels whose plain mesh is smaller than this say nothing: there seeds and corners are all there is.
constexpr std::size_t kFewVertices = 200;

int add_to_report(const Posts& posts, const std::string& path) {
  nlohmann::json report = nlohmann::json::parse(std::ifstream(path));
  fmt::print("{:>5} {:>10} {:>10} {:>10} {:>9} {:>7} {:>8} {:>10} {:>12}\n", "level", "E_L m", "plain", "tind",
             "outside", "seeds", "border", "overhead %", "apart from *");
  for (auto& level : report["levels"]) {
    const auto plain = Greedy<GridKernel>(posts, level["tolerance_m"]).run();
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

tind::Result<Posts> read_posts(const std::string& path) {
  const auto mosaic = tind::RasterMosaic::open({path}, {});
  if (!mosaic) return tl::unexpected(mosaic.error());
  const tind::RasterSource& source = mosaic->sources.at(0);
  Posts posts;
  posts.n_rows = source.n_used_rows;
  posts.n_cols = source.n_used_cols;
  if (posts.n_rows > kMostPostsPerSide || posts.n_cols > kMostPostsPerSide) {
    return tind::fail(tind::ErrorKind::kUnsupported, path + ": more than 32768 posts a side; cut it");
  }
  std::uint64_t n_implausible = 0;
  if (auto read = mosaic->read_rows(0, 0, source.n_used_rows, posts.heights_m, n_implausible); !read) {
    return tl::unexpected(read.error());
  }
  return posts;
}

}  // namespace

int main(int argc, char** argv) {
  const bool own_predicates = argc > 1 && std::string_view(argv[1]) == "--own-predicates";
  if (own_predicates) {
    --argc;
    ++argv;
  }
  if (argc < 3) {
    fmt::print(stderr,
               "usage: bench_greedy_baseline [--own-predicates] DEM TOLERANCE_M... | DEM --report REPORT.json\n");
    return 2;
  }
  const auto posts = read_posts(argv[1]);
  if (!posts) {
    fmt::print(stderr, "bench_greedy_baseline: {}\n", posts.error().message);
    return 1;
  }
  if (std::string_view(argv[2]) == "--report" && argc == 4) return add_to_report(*posts, argv[3]);
  const double reading_s = processor_s();
  for (int i = 2; i < argc; ++i) {
    const double start_s = processor_s(), tolerance_m = std::atof(argv[i]);
    const std::size_t n_vertices =
        own_predicates ? Greedy<GridKernel>(*posts, tolerance_m).run() : Greedy<PlainKernel>(*posts, tolerance_m).run();
    fmt::print(
        "{{\"tolerance_m\": {}, \"posts\": {}, \"vertices\": {}, \"meshing_cpu_s\": {:.2f}, \"reading_cpu_s\": "
        "{:.2f}}}\n",
        tolerance_m, posts->n_rows * posts->n_cols, n_vertices, processor_s() - start_s, reading_s);
  }
}
