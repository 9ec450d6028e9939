// SPDX-License-Identifier: GPL-3.0-or-later
// Quadtree cuts of the whole globe: every mix of levels must join into one surface.
#include <fmt/format.h>

#include <algorithm>

#include "tests/client/checks.hpp"
#include "tests/client/cut_planner.hpp"
#include "tests/client/globe_mesh.hpp"
#include "tests/client/parallel.hpp"
#include "tests/client/tessellate.hpp"

namespace tind::client {
namespace {

/// Adds one leaf of a cut, adapted to its finer neighbours.
void add_leaf(Run& run, const Cut& cut, const Node& leaf, GlobeMesh& mesh, CutFigures& figures) {
  const Pyramid& pyramid = run.pyramid;
  std::array<std::optional<SideInserts>, 4> sides;
  bool any = false;
  for (int b = 0; b < 4; ++b) {
    const std::int32_t beyond = leaf.neighbours[static_cast<std::size_t>(b)];
    if (beyond < 0 || cut.split[static_cast<std::size_t>(beyond)] == 0) continue;
    int deepest = leaf.id.level;
    const auto line = pyramid.line_beyond(leaf, b, beyond, [&](std::int32_t index) {
      const bool divided = cut.split[static_cast<std::size_t>(index)] != 0;
      if (divided) deepest = std::max(deepest, pyramid.node(index).id.level + 1);
      return divided;
    });
    ++figures.joints;
    figures.joints_by_gap.resize(
        std::max(figures.joints_by_gap.size(), static_cast<std::size_t>(deepest - leaf.id.level) + 1));
    ++figures.joints_by_gap[static_cast<std::size_t>(deepest - leaf.id.level)];
    auto inserts = decode_by_entry_levels(*leaf.tile, b, line);
    if (!inserts) {
      run.check("cuts").fail(fmt::format("cut '{}': {}", cut.kind, inserts.error()));
      continue;
    }
    any = any || inserts->any;
    sides[static_cast<std::size_t>(b)] = std::move(*inserts);
  }
  if (!any) return mesh.add(leaf.id, leaf.tile->vertices, leaf.tile->triangles);
  const auto tessellated = tessellate(*leaf.tile, sides);
  if (!tessellated) {
    run.check("cuts").fail(fmt::format("cut '{}': {}", cut.kind, tessellated.error()));
    return mesh.add(leaf.id, leaf.tile->vertices, leaf.tile->triangles);
  }
  figures.tessellated_vts += tessellated->changed_vts;
  mesh.add(leaf.id, tessellated->vertices, tessellated->triangles);
  if (run.posts == nullptr) return;
  const double error =
      scan_changed_triangles(run, leaf.id, *tessellated, run.check("cut-error"), "in cut '" + cut.kind + "'");
  figures.max_error_m = std::max(figures.max_error_m, error);
  figures.max_error_of_tolerance = std::max(figures.max_error_of_tolerance, error / run.tolerance_m(leaf.id.level));
}

void merge(CutFigures& into, const CutFigures& from) {
  into.cuts += from.cuts;
  into.leaves += from.leaves;
  into.triangles += from.triangles;
  into.tessellated_vts += from.tessellated_vts;
  into.joints += from.joints;
  into.joints_by_gap.resize(std::max(into.joints_by_gap.size(), from.joints_by_gap.size()));
  for (std::size_t g = 0; g < from.joints_by_gap.size(); ++g) into.joints_by_gap[g] += from.joints_by_gap[g];
  into.max_error_m = std::max(into.max_error_m, from.max_error_m);
  into.max_error_of_tolerance = std::max(into.max_error_of_tolerance, from.max_error_of_tolerance);
}

}  // namespace

void check_cuts(Run& run) {
  Check& check = run.check("cuts");
  if (run.posts == nullptr) run.check("cut-error").skip("no --source was given");
  if (run.options.cuts <= 0) {
    check.skip("--cuts 0");
    run.check("cut-error").skip("--cuts 0");
    return;
  }
  const Pyramid& pyramid = run.pyramid;
  for (int x = 0; x < 2; ++x) {
    const std::int32_t root = pyramid.find({0, static_cast<std::uint32_t>(x), 0});
    if (root >= 0 && pyramid.node(root).tile != nullptr) continue;
    check.fail(fmt::format("root tile 0/{}/0 could not be read: no cut covers the globe", x));
    return;
  }
  const bool can_divide =
      std::any_of(pyramid.nodes().begin(), pyramid.nodes().end(), [](const Node& n) { return n.splittable(); });
  if (!can_divide && run.posts != nullptr) run.check("cut-error").skip("no tile has children");
  // Each worker reuses one mesh for its cuts.
  std::atomic<int> next{0};
  for_each_parallel(run.options.threads, run.options.threads, [&](std::size_t) {
    GlobeMesh mesh(pyramid.frame());
    CutFigures figures;
    for (int index = next++; index < run.options.cuts; index = next++) {
      const Cut cut = plan_cut(pyramid, run.options.seed, index);
      mesh.clear();
      for (const std::int32_t leaf : cut.leaves) add_leaf(run, cut, pyramid.node(leaf), mesh, figures);
      check.looked_at();
      ++figures.cuts;
      figures.leaves += cut.leaves.size();
      figures.triangles += mesh.n_triangles();
      for (const auto& fault : mesh.find_faults()) {
        check.fail(fmt::format("cut {} ('{}', {} leaves): {}", index, cut.kind, cut.leaves.size(), fault));
      }
    }
    const std::lock_guard lock(run.figures_mutex);
    merge(run.report.cuts, figures);
  });
  Check& errors = run.check("cut-error");
  if (run.posts != nullptr && can_divide && errors.count() == 0 && errors.failures() == 0) {
    errors.skip("no post lies in a virtual triangle that these cuts re-triangulate");
  }
}

}  // namespace tind::client
