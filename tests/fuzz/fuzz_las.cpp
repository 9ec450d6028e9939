// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <cmath>
#include <vector>

#include "storage/readers/las.hpp"
#include "storage/readers/point_crs.hpp"
#include "tests/fuzz/fuzz_target.hpp"
#include "tests/support/memory_source.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::span bytes(data, size);
  tind::test::MemorySource source(bytes);
  const auto header = tind::read_las_header(source, "fuzz");
  if (!header) return 0;
  require(header->record_bytes >= 20 && header->points_offset <= size &&
              header->n_points <= (size - header->points_offset) / header->record_bytes,
          "all points of an accepted header lie within the file");
  std::vector<tind::LasPoint> points;
  tind::decode_las_points(*header, bytes.subspan(header->points_offset, header->n_points * header->record_bytes),
                          points);
  require(points.size() == header->n_points, "every record is a point");
  const auto crs = tind::PointCrs::from_las(header->crs, "fuzz");
  if (!crs || !*crs) return 0;
  std::vector<double> x, y;
  for (const tind::LasPoint& p : points) x.push_back(p.x), y.push_back(p.y);
  const std::size_t n_nowhere = (*crs)->to_degrees(x, y);
  const auto n_finite =
      static_cast<std::size_t>(std::count_if(x.begin(), x.end(), [](double v) { return std::isfinite(v); }));
  require(n_nowhere + n_finite == points.size(), "a point has degrees or is counted");
  return 0;
}
