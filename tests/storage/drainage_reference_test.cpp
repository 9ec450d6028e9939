// SPDX-License-Identifier: GPL-3.0-or-later
// Drainage of real terrain against TauDEM's (../shared/data/streams), read through the project's own readers.
#include <cmath>
#include <filesystem>
#include <optional>
#include <string>

#include <gtest/gtest.h>

#include "core/drainage/compare.hpp"
#include "core/drainage/flow.hpp"
#include "storage/readers/gdal_raster.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;

/// A raster's cells, row 0 southernmost; NaN where it has none.
struct Grid {
  std::int64_t n_rows = 0, n_cols = 0;
  std::vector<float> values;
  double mid_lat_deg = 0, lon_step_deg = 0, lat_step_deg = 0;
};

/// `unit`: factor on the values (the reader takes what lies beyond 30 km for voids).
std::optional<Grid> read(const fs::path& path, double unit = 1) {
  RasterOptions options;
  options.metres_per_unit = unit;
  const auto mosaic = RasterMosaic::open({path.string()}, options);
  if (!mosaic) {
    ADD_FAILURE() << mosaic.error().message;
    return std::nullopt;
  }
  Grid grid;
  grid.n_rows = mosaic->sources[0].n_rows;
  grid.n_cols = mosaic->sources[0].n_cols;
  NativePosts posts;
  if (const auto ok = mosaic->read_native_rows(0, 0, grid.n_rows, posts); !ok) {
    ADD_FAILURE() << ok.error().message;
    return std::nullopt;
  }
  grid.mid_lat_deg = posts.lat_deg[static_cast<std::size_t>(grid.n_rows / 2 * grid.n_cols)];
  grid.lon_step_deg = posts.lon_deg[1] - posts.lon_deg[0];
  grid.lat_step_deg = posts.lat_deg[0] - posts.lat_deg[static_cast<std::size_t>(grid.n_cols)];
  for (std::int64_t r = grid.n_rows - 1; r >= 0; --r) {
    const auto row = posts.heights_m.begin() + r * grid.n_cols;
    grid.values.insert(grid.values.end(), row, row + grid.n_cols);
  }
  return grid;
}

/// 1 at posts whose water may come from beyond the data: rim posts and all that lies downstream of one.
std::vector<std::uint8_t> edge_contaminated(const Flow& flow, const std::vector<float>& heights_m) {
  std::vector<std::uint8_t> dirty(heights_m.size(), 0);
  for (std::int64_t i = 0; i < flow.n_rows * flow.n_cols; ++i) {
    const std::int64_t r = i / flow.n_cols, c = i % flow.n_cols;
    bool rim = std::isnan(heights_m[static_cast<std::size_t>(i)]);
    for (std::size_t d = 0; d < 8; ++d) {
      const std::int64_t rr = r + kStepRows[d], cc = c + kStepCols[d];
      rim = rim || rr < 0 || cc < 0 || rr >= flow.n_rows || cc >= flow.n_cols ||
            std::isnan(heights_m[static_cast<std::size_t>(rr * flow.n_cols + cc)]);
    }
    for (std::int64_t at = rim ? i : -1; at >= 0 && !dirty[static_cast<std::size_t>(at)];) {
      dirty[static_cast<std::size_t>(at)] = 1;
      const std::size_t d = flow.directions[static_cast<std::size_t>(at)];
      at = d < 8 ? at + kStepRows[d] * flow.n_cols + kStepCols[d] : -1;
    }
  }
  return dirty;
}

fs::path shared(const char* name) { return fs::path(TIND_SHARED_DATA) / name; }

class EnoRiver : public ::testing::Test {
 protected:
  void SetUp() override {
    const fs::path folder = shared("streams/eno-nc-geographic");
    if (!fs::exists(folder)) GTEST_SKIP() << "needs " << folder;
    dem_ = read(folder / "enogeo.tif");
    filled_ = read(folder / "enogeofel.tif");
    directions_ = read(folder / "enogeop.tif");
    kilo_cells_ = read(folder / "enogeoad8.tif", 1e-3);
    streams_ = read(folder / "enogeosrc2.tif");
    ASSERT_TRUE(dem_ && filled_ && directions_ && kilo_cells_ && streams_);
    flow_ =
        flow_of(dem_->values.data(), dem_->n_rows, dem_->n_cols,
                111320 * std::cos(dem_->mid_lat_deg * M_PI / 180) * dem_->lon_step_deg, 110950 * dem_->lat_step_deg);
    dirty_ = edge_contaminated(flow_, dem_->values);
  }

  std::optional<Grid> dem_, filled_, directions_, kilo_cells_, streams_;
  Flow flow_;
  std::vector<std::uint8_t> dirty_;
};

TEST_F(EnoRiver, FilledSurfaceIsTauDemsEverywhere) { EXPECT_EQ(flow_.filled_m, filled_->values); }

TEST_F(EnoRiver, DirectionsAreTauDemsButForTies) {
  std::int64_t same = 0, compared = 0, same_in_flats = 0, in_flats = 0;
  for (std::size_t i = 0; i < flow_.directions.size(); ++i) {
    if (std::isnan(directions_->values[i]) || flow_.directions[i] >= 8) continue;  // TauDEM has none on the rim
    const bool equal = static_cast<int>(directions_->values[i]) == flow_.directions[i] + 1;
    (flow_.in_flat[i] ? in_flats : compared) += 1;
    (flow_.in_flat[i] ? same_in_flats : same) += equal;
  }
  RecordProperty("same_outside_flats", std::to_string(same) + " of " + std::to_string(compared));
  RecordProperty("same_in_flats", std::to_string(same_in_flats) + " of " + std::to_string(in_flats));
  EXPECT_GT(compared, 550000);
  EXPECT_GT(static_cast<double>(same), 0.998 * static_cast<double>(compared));
  // Flats have no one answer: TauDEM weighs its two gradients in another way.
  EXPECT_GT(static_cast<double>(same_in_flats), 0.9 * static_cast<double>(in_flats));
}

TEST_F(EnoRiver, AccumulationIsTauDemsWhereNoWaterComesFromBeyondTheRim) {
  std::int64_t close = 0, compared = 0;
  for (std::size_t i = 0; i < flow_.cells.size(); ++i) {
    if (dirty_[i] || std::isnan(kilo_cells_->values[i])) continue;
    const double expected = 1000.0 * static_cast<double>(kilo_cells_->values[i]);
    ++compared;
    close += std::abs(flow_.cells[i] - expected) <= 0.01 * expected + 1e-3;
  }
  EXPECT_GT(compared, 580000);
  EXPECT_GT(static_cast<double>(close), 0.985 * static_cast<double>(compared));
}

TEST_F(EnoRiver, StreamsMatchTheReference) {
  // TauDEM draws no stream where water may come from beyond the rim; so do we here.
  std::vector<std::uint8_t> ours = channel_mask(flow_, 200), theirs(ours.size()), their_directions(ours.size());
  std::vector<std::uint8_t> unsure(ours.size());
  for (std::size_t i = 0; i < ours.size(); ++i) {
    ours[i] = ours[i] && !dirty_[i];
    theirs[i] = streams_->values[i] > 0;
    const float d = directions_->values[i];
    their_directions[i] = std::isnan(d) ? kNoFlow : static_cast<std::uint8_t>(d - 1);
    unsure[i] = flow_.in_flat[i] || flow_.raised[i];
  }
  const auto extracted = stream_posts(dem_->n_rows, dem_->n_cols, ours.data(), flow_.directions.data());
  const auto reference = stream_posts(dem_->n_rows, dem_->n_cols, theirs.data(), their_directions.data());
  const auto report = [&](const char* name, const StreamMatch& m) {
    std::printf(
        "%s: reference %.0f cells, extracted %.0f, completeness %.4f, correctness %.4f, quality %.4f, mean "
        "distance %.3f cells\n",
        name, m.reference_length, m.extracted_length, m.completeness(), m.correctness(), m.quality(), m.mean_distance);
  };
  const StreamMatch sure = compare_streams(dem_->n_rows, dem_->n_cols, extracted, reference, 2, unsure);
  report("outside filled flats", sure);
  EXPECT_GT(sure.reference_length, 15000);
  EXPECT_GE(sure.completeness(), 0.99);
  EXPECT_GE(sure.correctness(), 0.99);
  const StreamMatch all = compare_streams(dem_->n_rows, dem_->n_cols, extracted, reference, 2);
  report("over all", all);
  EXPECT_GE(all.completeness(), 0.98);
  EXPECT_GE(all.correctness(), 0.98);
  // The measure itself notices another network: the streams of a four times larger area.
  std::vector<std::uint8_t> fewer = channel_mask(flow_, 800);
  for (std::size_t i = 0; i < fewer.size(); ++i) fewer[i] = fewer[i] && !dirty_[i];
  const StreamMatch sparse =
      compare_streams(dem_->n_rows, dem_->n_cols,
                      stream_posts(dem_->n_rows, dem_->n_cols, fewer.data(), flow_.directions.data()), reference, 2);
  EXPECT_LT(sparse.completeness(), 0.7);
}

TEST(LoganRiver, FilledSurfaceIsTauDemsEverywhere) {
  const fs::path folder = shared("streams/utah-logan");
  if (!fs::exists(folder)) GTEST_SKIP() << "needs " << folder;
  const auto dem = read(shared("raster/utah-logan-vrt/output.vrt")), filled = read(folder / "loganvrtfel.tif");
  ASSERT_TRUE(dem && filled);
  ASSERT_EQ(dem->values.size(), filled->values.size());
  const Flow flow = flow_of(dem->values.data(), dem->n_rows, dem->n_cols, 100, 100);
  std::int64_t different = 0;
  for (std::size_t i = 0; i < filled->values.size(); ++i) {
    if (std::isnan(filled->values[i])) continue;
    different += flow.filled_m[i] != filled->values[i];
  }
  EXPECT_EQ(different, 0);
}

}  // namespace
}  // namespace tind
