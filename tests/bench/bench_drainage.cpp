// SPDX-License-Identifier: GPL-3.0-or-later
// What drainage costs a post of the raster files given, by block size: CPU time of derive_drainage, reading excluded.
// usage: bench_drainage RASTER...

#include <cstdio>
#include <ctime>
#include <string>
#include <vector>

#include "core/drainage/drainage.hpp"
#include "core/level_spec.hpp"
#include "storage/readers/gdal_raster.hpp"

int main(int argc, char** argv) {
  const auto mosaic = tind::RasterMosaic::open(std::vector<std::string>(argv + 1, argv + argc), {});
  if (!mosaic) {
    std::fprintf(stderr, "bench_drainage: %s\n", mosaic.error().message.c_str());
    return 1;
  }
  tind::HeightField field;
  field.lattice.level = tind::level_of_spacing(mosaic->lon_spacing_deg) + 1;
  field.n_rows = mosaic->n_rows;
  field.n_cols = mosaic->n_cols;
  field.wraps = mosaic->wraps;
  const double step_deg = field.lattice.step_deg();
  field.x0 = (mosaic->west_deg + 180) / step_deg;
  field.y0 = (mosaic->south_deg + 90) / step_deg;
  field.dx = mosaic->lon_spacing_deg / step_deg;
  field.dy = mosaic->lat_spacing_deg / step_deg;
  const auto n = static_cast<std::size_t>(field.n_rows * field.n_cols);
  std::vector<float> heights_m(n, 0.0f), rows;
  std::vector<tind::PostOrigin> origins(n, tind::PostOrigin::kBase);
  for (std::size_t s = 0; s < mosaic->sources.size(); ++s) {
    const tind::RasterSource& source = mosaic->sources[s];
    std::uint64_t n_implausible = 0;
    if (const auto read = mosaic->read_rows(s, 0, source.n_used_rows, rows, n_implausible); !read) {
      std::fprintf(stderr, "bench_drainage: %s\n", read.error().message.c_str());
      return 1;
    }
    for (std::int64_t i = 0; i < source.n_used_rows * source.n_used_cols; ++i) {
      const float height = rows[static_cast<std::size_t>(i)];
      if (!(height == height)) continue;  // void
      const std::int64_t r = source.grid_row + i / source.n_used_cols,
                         c = (source.grid_col + i % source.n_used_cols) % field.n_cols;
      heights_m[static_cast<std::size_t>(r * field.n_cols + c)] = height;
      origins[static_cast<std::size_t>(r * field.n_cols + c)] = tind::PostOrigin::kSource;
    }
  }
  field.heights_m = heights_m.data();
  field.origins = origins.data();
  for (const std::int64_t side : {256, 1024, 4096}) {
    std::vector<std::vector<double>> scratch;
    tind::DrainageOptions options;
    options.bottom_level = field.lattice.level;
    options.max_change_m = 0.4 * field.dy * step_deg * 111000;
    options.block_side = side;
    const std::clock_t start = std::clock();
    const auto drainage = tind::derive_drainage(field, options, [&](std::size_t n_bytes) -> void* {
      scratch.emplace_back(n_bytes / sizeof(double) + 1);
      return scratch.back().data();
    });
    const double seconds = static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC;
    if (!drainage) {
      std::fprintf(stderr, "bench_drainage: %s\n", drainage.error().message.c_str());
      return 1;
    }
    std::printf("blocks of %lld posts: %.0f ns a post, %zu streams, %zu shores\n", static_cast<long long>(side),
                1e9 * seconds / static_cast<double>(n), drainage->streams.size(), drainage->shores.size());
  }
  return 0;
}
