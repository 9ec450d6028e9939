// SPDX-License-Identifier: GPL-3.0-or-later
// Tiny worlds as text (ESRI ASCII grids, VRT) through RasterMosaic and HeightGrid; then the real files.
#include "storage/readers/height_grid.hpp"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <sstream>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/readers/post_arrays.hpp"

namespace tind {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr char kWgs84[] = "EPSG:4326";

class HeightGridTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-height-grid-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  std::string write(const std::string& name, const std::string& text) {
    std::ofstream(folder_ / name, std::ios::binary) << text;
    return (folder_ / name).string();
  }
  /// An ASCII grid with posts at west + c * spacing, south + r * spacing; `height(r, c)`, row 0 southernmost.
  std::string write_grid(const std::string& name, double west, double south, double spacing, int n_rows, int n_cols,
                         const std::function<std::string(int, int)>& height) {
    std::ostringstream out;
    out << fmt::format("ncols {}\nnrows {}\nxllcenter {}\nyllcenter {}\ncellsize {}\nNODATA_value -9999\n", n_cols,
                       n_rows, west, south, spacing);
    for (int r = n_rows - 1; r >= 0; --r) {
      for (int c = 0; c < n_cols; ++c) out << height(r, c) << ' ';
      out << '\n';
    }
    return write(name, out.str());
  }
  /// A VRT over another raster: `crs` and `transform` replace its own, `band` is put into the band.
  std::string write_vrt(const std::string& name, const std::string& over, const std::string& crs,
                        const std::string& transform, const std::string& band, int n) {
    return write(
        name,
        fmt::format(R"(<VRTDataset rasterXSize="{0}" rasterYSize="{0}">{1}{2}<VRTRasterBand dataType="Float32" band="1">
{3}<SimpleSource><SourceFilename relativeToVRT="1">{4}</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>)",
                    n, crs.empty() ? "" : "<SRS>" + crs + "</SRS>",
                    transform.empty() ? "" : "<GeoTransform>" + transform + "</GeoTransform>", band, over));
  }

  Result<HeightGrid> load(const std::vector<std::string>& paths, int falloff = 8, double base = 0,
                          RasterOptions options = {}, int threads = 1) {
    auto mosaic = RasterMosaic::open(paths, options);
    if (!mosaic) return tl::unexpected(mosaic.error());
    Lattice lattice;
    lattice.level = 8;
    lattice.height_exponent = 6;
    return HeightGrid::load(*mosaic, lattice, {base, falloff, folder_.string(), threads}, {});
  }
  /// The message of the failure; empty when there is none.
  std::string message(const std::vector<std::string>& paths, RasterOptions options = {}) {
    const auto grid = load(paths, 8, 0, options);
    return grid ? "" : grid.error().message;
  }

  fs::path folder_;
};

std::string number(double v) { return fmt::format("{}", v); }

/// Largest step between neighbouring posts of which at least one is no source post.
double steepest_outside(const HeightField& f) {
  double steepest = 0;
  const auto compare = [&](std::int64_t r, std::int64_t c, std::int64_t rr, std::int64_t cc) {
    if (f.origin_at(r, c) == PostOrigin::kSource && f.origin_at(rr, cc) == PostOrigin::kSource) return;
    steepest = std::max(steepest, std::abs(f.height_at(r, c) - f.height_at(rr, cc)));
  };
  for (std::int64_t r = 0; r < f.n_rows; ++r) {
    for (std::int64_t c = 0; c < f.n_cols; ++c) {
      if (r + 1 < f.n_rows) compare(r, c, r + 1, c);
      if (c + 1 < f.n_cols) compare(r, c, r, c + 1);
    }
  }
  return steepest;
}

TEST_F(HeightGridTest, PostsKeepTheirPlaceAndHeight) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 4, 5, [](int r, int c) { return number(100 * r + c); });
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_EQ(f.n_rows, 4 + 16);
  EXPECT_EQ(f.n_cols, 5 + 16);
  const double step = f.lattice.step_deg();
  EXPECT_NEAR(f.post_x(8) * step - 180, 10, 1e-9);
  EXPECT_NEAR(f.post_y(8) * step - 90, 45, 1e-9);
  for (int r = 0; r < 4; ++r) {
    for (int c = 0; c < 5; ++c) {
      EXPECT_EQ(f.height_at(8 + r, 8 + c), 100 * r + c);
      EXPECT_EQ(f.origin_at(8 + r, 8 + c), PostOrigin::kSource);
    }
  }
  EXPECT_EQ(grid->counts().source, 20u);
  EXPECT_EQ(grid->counts().filled, 0u);
}

/// Whether the field's blocks are those of its posts as they are.
bool has_own_blocks(const HeightField& f) {
  std::vector<std::byte> memory(PostBlocks::n_bytes(f.n_rows, f.n_cols));
  const PostBlocks fresh = PostBlocks::build(f, memory, 1);
  if (f.blocks == nullptr || f.blocks->n_levels() != fresh.n_levels()) return false;
  const int top = fresh.n_levels() - 1;
  bool same = true;
  for (int level = 0; level <= top; ++level) {
    for (std::int64_t i = 0; i < fresh.n_block_rows(level); ++i) {
      for (std::int64_t j = 0; j < fresh.n_block_cols(level); ++j) {
        same = same && std::memcmp(&f.blocks->block(level, i, j), &fresh.block(level, i, j), sizeof(PostBlock)) == 0 &&
               std::memcmp(&f.blocks->sums(level, i, j), &fresh.sums(level, i, j), sizeof(PostBlockSums)) == 0;
      }
    }
  }
  return same;
}

TEST_F(HeightGridTest, BlocksAreThoseOfTheFinishedPosts) {
  // With a void to fill, a falloff and a pole row to settle.
  const auto path = write_grid("a.asc", 10, 87, 0.25, 13, 30, [](int r, int c) {
    return r > 4 && r < 8 && c > 9 && c < 20 ? std::string("-9999") : number(7 * r + 3 * c);
  });
  auto grid = load({path}, 10, -5);
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_GT(grid->counts().filled, 0u);
  EXPECT_TRUE(has_own_blocks(grid->field()));
  const HeightGrid moved = std::move(*grid);
  EXPECT_TRUE(has_own_blocks(moved.field()));
  HeightField stale = moved.field();
  std::vector<float> heights(stale.heights_m, stale.heights_m + stale.n_rows * stale.n_cols);
  heights[100] += 1;
  stale.heights_m = heights.data();
  EXPECT_FALSE(has_own_blocks(stale));
}

TEST_F(HeightGridTest, PostsInMemoryAndInPagesAndTheirBlocksAreThoseOfFiles) {
  const auto path = write_grid("a.asc", 10, 45, 0.05, 130, 300, [](int r, int c) {
    return r > 4 && r < 8 && c > 9 && c < 20 ? std::string("-9999") : number(7 * r % 31 + 3 * c);
  });
  auto mosaic = RasterMosaic::open({path}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  Lattice lattice;
  lattice.level = 8;
  lattice.height_exponent = 6;
  auto plain = HeightGrid::load(*mosaic, lattice, {-5, 10, folder_.string(), 1}, {});
  ASSERT_TRUE(plain) << plain.error().message;
  EXPECT_FALSE(plain->field().blocks->is_on_demand());
  const std::uint64_t n_bytes = PostArrays::n_bytes(plain->field());
  for (const std::uint64_t in_memory_bytes : {n_bytes - 1, n_bytes}) {
    auto grid = HeightGrid::load(*mosaic, lattice, {-5, 10, folder_.string(), 2, in_memory_bytes}, {});
    ASSERT_TRUE(grid) << grid.error().message;
    EXPECT_EQ(grid->field().blocks->is_on_demand(), in_memory_bytes == n_bytes);
    const auto n_posts = static_cast<std::size_t>(plain->field().n_rows * plain->field().n_cols);
    ASSERT_EQ(std::memcmp(grid->field().heights_m, plain->field().heights_m, n_posts * sizeof(float)), 0);
    ASSERT_EQ(std::memcmp(grid->field().origins, plain->field().origins, n_posts * sizeof(PostOrigin)), 0);
    grid->field().blocks->block(0, 3, 5);
    auto moved = std::move(*grid);
    if (in_memory_bytes < n_bytes) {
      ASSERT_TRUE(moved.turn_into_pages(folder_.string(), 1 << 20, 2, nullptr));
      EXPECT_FALSE(moved.field().blocks->is_on_demand());
    }
    const PostBlocks &paged = *moved.field().blocks, &expected = *plain->field().blocks;
    for (int level = 0; level < expected.n_levels(); ++level) {
      for (std::int64_t i = 0; i < expected.n_block_rows(level); ++i) {
        for (std::int64_t j = 0; j < expected.n_block_cols(level); ++j) {
          ASSERT_EQ(std::memcmp(&paged.block(level, i, j), &expected.block(level, i, j), sizeof(PostBlock)), 0);
          ASSERT_EQ(std::memcmp(&paged.sums(level, i, j), &expected.sums(level, i, j), sizeof(PostBlockSums)), 0);
        }
      }
    }
  }
  auto grid = HeightGrid::load(*mosaic, lattice, {-5, 10, folder_.string(), 2, n_bytes}, {});
  ASSERT_TRUE(grid);
  EXPECT_TRUE(has_own_blocks(grid->field()));
}

// All that two fields say of their grid's posts.
void expect_same_posts(const HeightField& a, const HeightField& b) {
  ASSERT_EQ(a.n_rows, b.n_rows);
  ASSERT_EQ(a.n_cols, b.n_cols);
  const auto bits = [](double height_m) { return std::bit_cast<std::uint64_t>(height_m); };
  for (std::int64_t r = 0; r < a.n_rows; ++r) {
    for (std::int64_t c = 0; c < a.n_cols; ++c) {
      ASSERT_EQ(bits(a.height_at(r, c)), bits(b.height_at(r, c))) << r << ' ' << c;
      ASSERT_EQ(a.origin_at(r, c), b.origin_at(r, c)) << r << ' ' << c;
      const HeightField::Posts one = a.posts_from(r, c), other = b.posts_from(r, c);
      ASSERT_EQ(bits(static_cast<double>(*one.heights_m)), bits(static_cast<double>(*other.heights_m)));
      ASSERT_EQ(*one.origins, *other.origins) << r << ' ' << c;
    }
  }
  ASSERT_EQ(a.blocks->n_levels(), b.blocks->n_levels());
  for (int level = 0; level < a.blocks->n_levels(); ++level) {
    for (std::int64_t i = 0; i < a.blocks->n_block_rows(level); ++i) {
      for (std::int64_t j = 0; j < a.blocks->n_block_cols(level); ++j) {
        if (level >= a.blocks->most_level_at_once()) {
          const PostSummary one = a.blocks->summary(level, i, j), other = b.blocks->summary(level, i, j);
          EXPECT_EQ(one.min_height_m, other.min_height_m) << level << ' ' << i << ' ' << j;
          EXPECT_EQ(one.max_height_m, other.max_height_m) << level << ' ' << i << ' ' << j;
          EXPECT_EQ(one.n_source, other.n_source) << level << ' ' << i << ' ' << j;
          EXPECT_EQ(one.origins, other.origins) << level << ' ' << i << ' ' << j;
        }
        const PostBlock one = a.blocks->block(level, i, j), other = b.blocks->block(level, i, j);
        EXPECT_EQ(std::memcmp(&one, &other, sizeof one), 0) << level << ' ' << i << ' ' << j;
        const PostBlockSums sums = a.blocks->sums(level, i, j), others = b.blocks->sums(level, i, j);
        EXPECT_EQ(std::memcmp(&sums, &others, sizeof sums), 0) << level << ' ' << i << ' ' << j;
      }
    }
  }
}

TEST_F(HeightGridTest, PackedPostsAndTheirBlocksAreThoseOfArrays) {
  constexpr std::uint64_t kEnough = std::uint64_t{1} << 30;
  const auto hill = [](int r, int c) { return 40 * std::sin(0.1 * r) + 30 * std::cos(0.07 * c); };
  using Height = std::function<double(int, int)>;
  const std::vector<std::pair<const char*, Height>> kinds = {
      {"whole metres", [&](int r, int c) { return std::round(hill(r, c)); }},
      {"quarters", [&](int r, int c) { return std::round(4 * hill(r, c)) / 4; }},
      {"all kinds", hill},
      {"a few others", [&](int r, int c) { return std::round(hill(r, c)) + (r == 77 && c == 30 ? 0.1 : 0); }},
      {"zeros below zero", [](int r, int c) { return (r + c) % 3 == 0 ? -0.0 : 0.0; }},
      {"the least and the most", [](int r, int c) { return (r + c) % 2 == 0 ? -4096 : 12287.75; }},
      {"deep and high", [](int r, int c) { return r < 40   ? -4096.25
                                                  : c < 40 ? 12288
                                                           : r - 2.0 * c; }},
  };
  Lattice lattice;
  lattice.level = 8;
  for (const auto& [name, height] : kinds) {
    for (const auto& [n_rows, n_cols] : {std::pair(150, 133), std::pair(64, 200), std::pair(3, 2)}) {
      const std::string path = (folder_ / "posts.flt").string();
      std::ofstream file(path, std::ios::binary);
      for (int r = n_rows - 1; r >= 0; --r) {
        for (int c = 0; c < n_cols; ++c) {
          const auto value = static_cast<float>(height(r, c));
          file.write(reinterpret_cast<const char*>(&value), sizeof value);
        }
      }
      file.close();
      write("posts.hdr", fmt::format("ncols {}\nnrows {}\nxllcenter 10\nyllcenter 45\ncellsize 0.01\nbyteorder "
                                     "LSBFIRST\n",
                                     n_cols, n_rows));
      const auto mosaic = RasterMosaic::open({path}, {});
      ASSERT_TRUE(mosaic) << mosaic.error().message;
      for (const int falloff : {1, 8, 70}) {
        for (const int threads : {1, 3}) {
          const auto from = [&](bool may_be_pages) {
            return HeightGrid::load(*mosaic, lattice, {-5, falloff, folder_.string(), threads, kEnough, may_be_pages},
                                    {});
          };
          const auto arrays = from(false), pages = from(true);
          ASSERT_TRUE(arrays && pages) << (arrays ? pages.error().message : arrays.error().message);
          ASSERT_EQ(arrays->field().pages, nullptr);
          // Where two columns are nothing but a rim, arrays are as good.
          EXPECT_EQ(pages->field().pages != nullptr, n_cols > 2) << name << ' ' << falloff;
          SCOPED_TRACE(fmt::format("{}, {} columns, falloff {}, {} threads", name, n_cols, falloff, threads));
          expect_same_posts(arrays->field(), pages->field());
          EXPECT_EQ(arrays->counts().source, pages->counts().source);
          EXPECT_EQ(arrays->counts().falloff, pages->counts().falloff);
          EXPECT_EQ(arrays->notes(), pages->notes());
          if (HasFailure()) return;
          if (pages->field().pages == nullptr) continue;
          // Windows anywhere, as many of them as touch pages' ends in all ways.
          const HeightField &f = arrays->field(), &p = pages->field();
          for (const std::int64_t side : {1, 9, 64, 65, 130}) {
            for (std::int64_t r = 0; r + side <= f.n_rows; r += 13) {
              for (std::int64_t c = 0; c + side <= f.n_cols; c += 17) {
                std::vector<float> heights(static_cast<std::size_t>(side * side));
                std::vector<PostOrigin> origins(heights.size());
                p.pages->copy(r, c, side, side, heights.data(), origins.data());
                for (std::int64_t k = 0; k < side; ++k) {
                  const std::int64_t at = (r + k) * f.n_cols + c;
                  ASSERT_EQ(std::memcmp(&heights[static_cast<std::size_t>(k * side)], f.heights_m + at,
                                        static_cast<std::size_t>(side) * sizeof(float)),
                            0);
                  ASSERT_TRUE(std::equal(f.origins + at, f.origins + at + side, origins.begin() + k * side));
                }
              }
            }
          }
        }
      }
    }
  }
}

TEST_F(HeightGridTest, PackedPostsOfSeveralSourcesAreThoseOfArrays) {
  const auto a = write_grid("a.asc", 10, 45, 0.01, 90, 80, [](int r, int c) { return number(r * c % 37); });
  const auto b = write_grid("b.asc", 10.7, 45, 0.01, 90, 80, [](int r, int c) { return number(r * (c + 70) % 41); });
  const auto mosaic = RasterMosaic::open({a, b}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  Lattice lattice;
  lattice.level = 8;
  const auto from = [&](bool may_be_pages) {
    return HeightGrid::load(*mosaic, lattice, {0, 8, folder_.string(), 2, std::uint64_t{1} << 30, may_be_pages}, {});
  };
  const auto arrays = from(false), pages = from(true);
  ASSERT_TRUE(arrays && pages);
  ASSERT_NE(pages->field().pages, nullptr);
  expect_same_posts(arrays->field(), pages->field());
  EXPECT_GT(pages->counts().disagreeing, 100u);
  EXPECT_EQ(arrays->counts().source, pages->counts().source);
  EXPECT_EQ(arrays->counts().disagreeing, pages->counts().disagreeing);
  EXPECT_EQ(arrays->field().disagreement_m, pages->field().disagreement_m);
}

TEST_F(HeightGridTest, PostsAreNotPackedWhereARimIsNotAllThatIsVoid) {
  constexpr std::uint64_t kEnough = std::uint64_t{1} << 30;
  Lattice lattice;
  lattice.level = 8;
  const auto grid_of = [&](const std::string& path, std::uint64_t in_memory_bytes) {
    const auto mosaic = RasterMosaic::open({path}, {});
    EXPECT_TRUE(mosaic) << mosaic.error().message;
    return HeightGrid::load(*mosaic, lattice, {-5, 8, folder_.string(), 2, in_memory_bytes, true}, {}).value();
  };
  const auto plain = [](int r, int c) { return number(r + c); };
  const auto whole = write_grid("whole.asc", 10, 45, 0.01, 90, 80, plain);
  EXPECT_NE(grid_of(whole, kEnough).field().pages, nullptr);
  EXPECT_EQ(grid_of(whole, 0).field().pages, nullptr);
  for (const auto& [row, col] : {std::pair(0, 0), std::pair(89, 79), std::pair(40, 40)}) {
    const auto path = write_grid("void.asc", 10, 45, 0.01, 90, 80,
                                 [&](int r, int c) { return r == row && c == col ? "-9999" : number(r + c); });
    const HeightGrid grid = grid_of(path, kEnough);
    EXPECT_EQ(grid.field().pages, nullptr);
    EXPECT_EQ(grid.counts().source, 90u * 80u - 1);
    EXPECT_EQ(grid.counts().filled, row == 40 ? 1u : 0u);
  }
  EXPECT_EQ(grid_of(write_grid("pole.asc", 10, 89.5, 0.01, 50, 60, plain), kEnough).field().pages, nullptr);
  EXPECT_EQ(grid_of(write_grid("ring.asc", -180, 20, 4, 10, 90, plain), kEnough).field().pages, nullptr);
}

TEST_F(HeightGridTest, LoadingStopsWhenItIsToldTo) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 40, 50, [](int r, int c) { return number(r * c); });
  auto mosaic = RasterMosaic::open({path}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  std::atomic<bool> cancel{false};
  HeightGridOptions options;
  options.scratch_dir = folder_.string();
  options.cancel = &cancel;
  EXPECT_TRUE(HeightGrid::load(*mosaic, Lattice{}, options, {}));
  // From the start, and from within.
  for (const bool at_once : {true, false}) {
    cancel = at_once;
    const auto grid = HeightGrid::load(*mosaic, Lattice{}, options, [&](double) { cancel = true; });
    ASSERT_FALSE(grid);
    EXPECT_EQ(grid.error().kind, ErrorKind::kInterrupted);
    EXPECT_EQ(grid.error().message, "interrupted");
  }
}

TEST_F(HeightGridTest, PostsThatNoDiskHoldsAreRefused) {
  // A global raster of 10^13 posts, as a text file.
  const auto grid_path = write_grid("a.asc", 0.5, -89.5, 1, 180, 360, [](int r, int c) { return number(r + c); });
  const auto path =
      write("planet.vrt", fmt::format(R"(<VRTDataset rasterXSize="3600000" rasterYSize="1800000"><SRS>EPSG:4326</SRS>
<GeoTransform>0,0.0001,0,90,0,-0.0001</GeoTransform><VRTRasterBand dataType="Float32" band="1"><SimpleSource>
<SourceFilename>{}</SourceFilename><SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="360" ySize="180"/>
<DstRect xOff="0" yOff="0" xSize="3600000" ySize="1800000"/></SimpleSource></VRTRasterBand></VRTDataset>)",
                                      grid_path));
  EXPECT_THAT(message({path}), AllOf(HasSubstr("scratch file of 3"), HasSubstr("write the output to another disk")));
}

TEST_F(HeightGridTest, FalloffReachesTheBaseAtItsDistanceWithoutACliff) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 20, 20, [](int, int c) { return c < 10 ? "2000" : "0"; });
  const auto grid = load({path}, 32, -50);
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  for (std::int64_t r = 0; r < f.n_rows; ++r) {
    for (std::int64_t c = 0; c < f.n_cols; ++c) {
      const std::int64_t dr = std::max<std::int64_t>({32 - r, r - 51, 0}),
                         dc = std::max<std::int64_t>({32 - c, c - 51, 0});
      const PostOrigin expected = dr * dr + dc * dc == 0        ? PostOrigin::kSource
                                  : dr * dr + dc * dc < 32 * 32 ? PostOrigin::kFalloff
                                                                : PostOrigin::kBase;
      ASSERT_EQ(f.origin_at(r, c), expected) << r << " " << c;
      if (expected == PostOrigin::kBase) {
        ASSERT_EQ(f.height_at(r, c), -50) << r << " " << c;
      }
      ASSERT_GE(f.height_at(r, c), -50);
      ASSERT_LE(f.height_at(r, c), 2000);
    }
  }
  // The nearest post jumps by 2000 m in the middle of the southern and northern side. At the cliff of the data itself
  // the falloff cannot be smooth; four posts out it is.
  double steepest = 0;
  for (std::int64_t c = 0; c + 1 < f.n_cols; ++c)
    steepest = std::max(steepest, std::abs(f.height_at(28, c + 1) - f.height_at(28, c)));
  EXPECT_LT(steepest, 400);
}

TEST_F(HeightGridTest, InteriorVoidContinuesAPlane) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 30, 40, [](int r, int c) {
    const bool hole = r >= 5 && r < 24 && c >= 6 && c < 33;
    return hole ? std::string("-9999") : number(10 * r + 3 * c);
  });
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().filled, 19u * 27u);
  const HeightField& f = grid->field();
  for (int r = 5; r < 24; ++r) {
    for (int c = 6; c < 33; ++c) {
      ASSERT_EQ(f.origin_at(8 + r, 8 + c), PostOrigin::kFilled);
      ASSERT_NEAR(f.height_at(8 + r, 8 + c), 10 * r + 3 * c, 0.5) << r << " " << c;
    }
  }
}

TEST_F(HeightGridTest, InteriorVoidStaysWithinItsRim) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 30, 30, [](int r, int c) {
    if (r == 0 || c == 0) return std::string("8000");  // no rim of the void
    const bool hole = (r - 15) * (r - 15) + (c - 15) * (c - 15) < 100;
    return hole ? std::string("-9999") : number(500 + (r * 37 + c * 91) % 200);
  });
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_GT(grid->counts().filled, 250u);
  for (std::int64_t i = 0; i < f.n_rows * f.n_cols; ++i) {
    if (f.origins[i] != PostOrigin::kFilled) continue;
    ASSERT_GE(f.heights_m[i], 500);
    ASSERT_LT(f.heights_m[i], 700);
  }
}

TEST_F(HeightGridTest, VoidThatTouchesTheRimFallsOff) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 40, 40, [](int, int c) { return c < 20 ? "1000" : "-9999"; });
  const auto grid = load({path}, 10, 0);
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().filled, 0u);
  const HeightField& f = grid->field();
  EXPECT_EQ(f.origin_at(30, 10 + 19), PostOrigin::kSource);
  EXPECT_EQ(f.origin_at(30, 10 + 28), PostOrigin::kFalloff);
  EXPECT_EQ(f.origin_at(30, 10 + 29), PostOrigin::kBase);
  EXPECT_NEAR(f.height_at(30, 10 + 24), 500, 5);
  EXPECT_LT(steepest_outside(f), 250);  // 100 on a straight side, more at the corners
}

TEST_F(HeightGridTest, NotANumberInfinityAndImplausibleHeightsAreVoids) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 7, 7, [](int r, int c) {
    if (r == 3 && c == 2) return std::string("nan");
    if (r == 3 && c == 3) return std::string("32767");
    if (r == 3 && c == 4) return std::string("-3.4e38");
    return std::string("12.5");
  });
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().filled, 3u);
  EXPECT_EQ(grid->counts().implausible, 2u);
  for (int c = 2; c <= 4; ++c) EXPECT_FLOAT_EQ(static_cast<float>(grid->field().height_at(8 + 3, 8 + c)), 12.5f);
  EXPECT_FALSE(grid->notes().empty());
}

TEST_F(HeightGridTest, ReliefOfMarsIsKept) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 4, 4, [](int r, int) { return r < 2 ? "-8200" : "21230"; });
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().source, 16u);
}

TEST_F(HeightGridTest, OverlapIsTheMeanInAnyOrderOfArguments) {
  const auto west = write_grid("w.asc", 10, 45, 0.01, 5, 5, [](int r, int c) { return number(r + 100 * c); });
  const auto east = write_grid("e.asc", 10.04, 45, 0.01, 5, 5,
                               [](int r, int c) { return number(r + 400 + 100 * c + (r == 2 ? 3 : 0)); });
  const auto a = load({west, east}), b = load({east, west, east});
  ASSERT_TRUE(a) << a.error().message;
  ASSERT_TRUE(b) << b.error().message;
  const HeightField &f = a->field(), &g = b->field();
  EXPECT_EQ(f.n_cols, 9 + 16);
  EXPECT_EQ(a->counts().source, 45u);
  EXPECT_EQ(a->counts().overlapping, 5u);
  EXPECT_EQ(a->counts().disagreeing, 1u);
  EXPECT_EQ(f.disagreement_m, 1.5);
  EXPECT_EQ(f.height_at(8 + 2, 8 + 4), 403.5);
  ASSERT_EQ(f.n_rows * f.n_cols, g.n_rows * g.n_cols);
  EXPECT_EQ(std::memcmp(f.heights_m, g.heights_m, sizeof(float) * static_cast<std::size_t>(f.n_rows * f.n_cols)), 0);
  EXPECT_EQ(std::memcmp(f.origins, g.origins, static_cast<std::size_t>(f.n_rows * f.n_cols)), 0);
}

TEST_F(HeightGridTest, AnyNumberOfThreadsReadsTheSame) {
  // Several strips of rows, with one source, with both, and with a stretch that neither has.
  const auto height = [](int r, int c) {
    return r % 97 < 5 && c % 7 < 3 ? std::string("-9999") : number(r * 0.25 + c % 5);
  };
  const auto a = write_grid("a.asc", 10, 20, 0.01, 1700, 12, height);
  const auto b = write_grid("b.asc", 10.05, 30, 0.01, 1500, 9, height),
             c = write_grid("c.asc", 10, 50, 0.01, 30, 9, height);
  const auto one = load({a, b, c}), three = load({a, b, c}, 8, 0, {}, 3);
  ASSERT_TRUE(one) << one.error().message;
  ASSERT_TRUE(three) << three.error().message;
  const HeightField &f = one->field(), &g = three->field();
  ASSERT_EQ(f.n_rows, g.n_rows);
  ASSERT_EQ(f.n_cols, g.n_cols);
  for (std::int64_t row = 0; row < f.n_rows; ++row) {
    for (std::int64_t col = 0; col < f.n_cols; ++col) {
      ASSERT_EQ(f.height_at(row, col), g.height_at(row, col)) << row << " " << col;
      ASSERT_EQ(f.origin_at(row, col), g.origin_at(row, col)) << row << " " << col;
    }
  }
  EXPECT_EQ(f.disagreement_m, g.disagreement_m);
  EXPECT_GT(f.disagreement_m, 0);
  EXPECT_EQ(one->counts().source, three->counts().source);
  EXPECT_EQ(one->counts().overlapping, three->counts().overlapping);
  EXPECT_EQ(one->counts().disagreeing, three->counts().disagreeing);
  EXPECT_GT(one->counts().overlapping, 0u);
}

TEST_F(HeightGridTest, PostsFarApartInARowKeepTheirPlaces) {
  const auto height = [](int r, int c) { return number(1 + 10 * r + c); };
  const auto a = write_grid("a.asc", 10, 20, 0.01, 3, 4, height), b = write_grid("b.asc", 110, 20, 0.01, 3, 4, height);
  const auto grid = load({a, b});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  ASSERT_EQ(f.n_cols, 10004 + 16);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 4; ++c) {
      for (const std::int64_t col : {8 + c, 10008 + c}) {
        EXPECT_EQ(f.height_at(8 + r, col), 1 + 10 * r + c);
        EXPECT_EQ(f.origin_at(8 + r, col), PostOrigin::kSource);
      }
    }
    EXPECT_EQ(f.origin_at(8 + r, 5000), PostOrigin::kBase);
  }
  EXPECT_EQ(grid->counts().source, 24u);
}

TEST_F(HeightGridTest, UnitScaleAndOffsetOfTheFileAreHonouredAndFlagsOverride) {
  write_grid("a.asc", 10, 45, 0.01, 4, 4, [](int r, int) { return r == 0 ? "7" : "1000"; });
  const std::string transform = "9.995,0.01,0,45.035,0,-0.01";
  const auto feet = write_vrt("feet.vrt", "a.asc", kWgs84, transform, "<UnitType>ft</UnitType>", 4);
  const auto scaled = write_vrt("scaled.vrt", "a.asc", kWgs84, transform, "<Scale>0.1</Scale><Offset>5</Offset>", 4);
  const auto odd = write_vrt("odd.vrt", "a.asc", kWgs84, transform, "<UnitType>cubits</UnitType>", 4);
  const auto height = [&](const std::string& path, RasterOptions options) {
    const auto grid = load({path}, 8, 0, options);
    EXPECT_TRUE(grid) << grid.error().message;
    return grid ? grid->field().height_at(8 + 3, 8 + 3) : 0.0;
  };
  EXPECT_NEAR(height(feet, {}), 304.8, 1e-4);
  EXPECT_NEAR(height(scaled, {}), 105, 1e-4);
  EXPECT_NEAR(height(feet, {.nodata = {}, .metres_per_unit = 2.0}), 2000, 1e-4);
  EXPECT_NEAR(height(odd, {.nodata = {}, .metres_per_unit = 0.5}), 500, 1e-4);
  EXPECT_THAT(message({odd}), HasSubstr("cubits"));
  const auto grid = load({feet}, 8, 0, {.nodata = 7.0, .metres_per_unit = {}});
  ASSERT_TRUE(grid);
  EXPECT_EQ(grid->counts().source, 12u);
}

TEST_F(HeightGridTest, SouthUpRasterIsNotMirrored) {
  write_grid("a.asc", 10, 45, 0.01, 4, 4, [](int r, int c) { return number(10 * r + c); });
  // The file's first row (heights 30..33) is now the southernmost.
  const auto path = write_vrt("up.vrt", "a.asc", kWgs84, "9.995,0.01,0,44.995,0,0.01", "", 4);
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->field().height_at(8 + 0, 8 + 1), 31);
  EXPECT_EQ(grid->field().height_at(8 + 3, 8 + 1), 1);
}

TEST_F(HeightGridTest, GlobeFromZeroTo360ClosesAndStartsAtLongitudeMinus180) {
  const auto path =
      write_grid("g.asc", 5, -85, 10, 18, 36, [](int r, int c) { return number(r == 0 ? 7 : 100 * r + c); });
  const auto mosaic = RasterMosaic::open({path}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_TRUE(mosaic->wraps);
  EXPECT_DOUBLE_EQ(mosaic->west_deg, -175);
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_EQ(f.n_cols, 36);
  EXPECT_EQ(grid->counts().falloff, 0u);
  EXPECT_EQ(f.height_at(3, 18), 300);  // longitude 5: the file's first column
  EXPECT_EQ(f.height_at(3, 0), 318);
  // Across longitude 180: between the columns of 175 (17) and 185 (18).
  EXPECT_EQ(f.lattice_height(0, std::llround(f.post_y(3))), f.lattice.height_from_m(317.5));
  ASSERT_TRUE(f.continues_south);
  EXPECT_EQ(f.south_pole_m, 7);
  for (std::int64_t x = 0; x < f.lattice.width(); x += f.lattice.width() / 7) EXPECT_EQ(f.lattice_height(x, 0), 7 * 64);
}

TEST_F(HeightGridTest, PostsOnAPoleGetOneHeight) {
  const auto path =
      write_grid("g.asc", -180, -90, 10, 19, 37, [](int r, int c) { return number(r == 18 ? 100 + c % 36 : 5); });
  const auto grid = load({path});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_EQ(f.n_cols, 36);  // the repeated last column is dropped
  EXPECT_EQ(f.n_rows, 19);
  EXPECT_DOUBLE_EQ(f.north_pole_m, 117.5);
  EXPECT_DOUBLE_EQ(f.disagreement_m, 17.5);
  for (std::int64_t c = 0; c < 36; ++c) EXPECT_EQ(f.height_at(18, c), 117.5);
  EXPECT_FALSE(grid->notes().empty());
}

TEST_F(HeightGridTest, DataMayCrossLongitude180) {
  const auto west = write_grid("w.asc", 179, 10, 0.1, 11, 11, [](int, int c) { return number(c); });
  const auto east = write_grid("e.asc", -180, 10, 0.1, 11, 11, [](int, int c) { return number(10 + c); });
  const auto grid = load({east, west});
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_EQ(f.n_cols, 21 + 16);
  EXPECT_EQ(grid->counts().disagreeing, 0u);
  EXPECT_EQ(f.height_at(8 + 5, 8 + 20), 20);
  const std::int64_t y = std::llround(f.post_y(8 + 5)), x = std::llround(f.post_x(8 + 15));
  EXPECT_GT(x, f.lattice.width());
  EXPECT_EQ(f.lattice_height(x - f.lattice.width(), y), 15 * 64);
}

TEST_F(HeightGridTest, NearlyClosedGlobeFillsTheGapFromBothSides) {
  const auto path = write_grid("g.asc", -180, -40, 1, 60, 350, [](int, int) { return "900"; });
  const auto grid = load({path}, 16);
  ASSERT_TRUE(grid) << grid.error().message;
  const HeightField& f = grid->field();
  EXPECT_TRUE(f.wraps);
  EXPECT_EQ(f.n_cols, 360);
  EXPECT_GT(f.height_at(16 + 30, 355), 500);
  EXPECT_LT(steepest_outside(f), 150);
}

TEST_F(HeightGridTest, WhatCannotBeReadIsNamed) {
  write_grid("a.asc", 10, 45, 0.01, 4, 4, [](int, int) { return "1"; });
  const std::string good = (folder_ / "a.asc").string(), transform = "9.995,0.01,0,45.035,0,-0.01";
  const auto voids = write_grid("v.asc", 10, 45, 0.01, 4, 4, [](int, int) { return "-9999"; });
  EXPECT_THAT(message({(folder_ / "none.tif").string()}), HasSubstr("none.tif: no such file"));
  EXPECT_THAT(message({write("t.tif", "no raster")}), HasSubstr("not a raster"));
  EXPECT_THAT(message({write("e.tif", "")}), HasSubstr("is an empty file"));
  EXPECT_THAT(message({folder_.string()}), HasSubstr("is a folder"));
  EXPECT_THAT(message({write("e.zip", "PK")}), HasSubstr("zip"));
  EXPECT_THAT(message({write_vrt("n.vrt", "a.asc", kWgs84, "", "", 4)}), HasSubstr("no geotransform"));
  EXPECT_THAT(message({write_vrt("m.vrt", "a.asc", "", "400000,30,0,4000000,0,-30", "", 4)}), HasSubstr("no CRS"));
  EXPECT_THAT(message({voids}), HasSubstr("every post is a void"));
  EXPECT_THAT(message({}), HasSubstr("no input"));
  EXPECT_EQ(message({good}), "");
}

TEST_F(HeightGridTest, DamagedFileFailsInsteadOfGivingHeights) {
  std::ifstream in(fs::path(TIND_TEST_DATA) / "sangre_de_cristo.tif", std::ios::binary);
  std::string bytes((std::istreambuf_iterator<char>(in)), {});
  ASSERT_GT(bytes.size(), 700000u);
  std::fill_n(bytes.begin() + 600000, 20000, '\xff');
  const auto grid = load({write("damaged.tif", bytes)});
  ASSERT_FALSE(grid);
  EXPECT_EQ(grid.error().kind, ErrorKind::kIo);
  EXPECT_THAT(grid.error().message, HasSubstr("truncated or damaged"));
}

TEST_F(HeightGridTest, ShortRawFileIsNotReadAsZeros) {
  write("r.hdr",
        "ENVI\nsamples = 4\nlines = 4\nbands = 1\nheader offset = 0\nfile type = ENVI Standard\ndata type = 2\n"
        "interleave = bsq\nbyte order = 0\nmap info = {Geographic Lat/Lon, 1, 1, -118, 37, 0.01, 0.01, WGS-84}\n");
  EXPECT_EQ(message({write("r.img", std::string(32, '\1'))}), "");
  EXPECT_THAT(message({write("r.img", std::string(20, '\1'))}), HasSubstr("truncated"));
}

TEST_F(HeightGridTest, UnusableScratchFolderIsAnError) {
  const auto path = write_grid("a.asc", 10, 45, 0.01, 4, 4, [](int, int) { return "1"; });
  const auto mosaic = RasterMosaic::open({path}, {});
  ASSERT_TRUE(mosaic);
  const auto grid = HeightGrid::load(*mosaic, Lattice{}, {0, 8, (folder_ / "none").string()}, {});
  ASSERT_FALSE(grid);
  EXPECT_EQ(grid.error().kind, ErrorKind::kIo);
}

TEST_F(HeightGridTest, BundledDemIsReadPostByPost) {
  const std::string path = (fs::path(TIND_TEST_DATA) / "sangre_de_cristo.tif").string();
  const auto mosaic = RasterMosaic::open({path}, {});
  ASSERT_TRUE(mosaic) << mosaic.error().message;
  EXPECT_EQ(mosaic->west_deg, -106);
  EXPECT_EQ(mosaic->south_deg, 37);
  EXPECT_EQ(mosaic->lon_spacing_deg, 1.0 / 1200);
  EXPECT_EQ(mosaic->sources[0].name, "sangre_de_cristo.tif");
  EXPECT_EQ(mosaic->sources[0].sha256, "6c99b39c8d8c23aabf37b2bf93de2594d6e39ff534a117bf465eebcb4ea9dedd");
  const auto grid = load({path}, 64);
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().source, 2401u * 1201u);
  const HeightField& f = grid->field();
  EXPECT_EQ(f.height_at(64 + 1200 - 508, 64 + 617), 4322);  // Blanca Peak, row 508 from the north
  EXPECT_EQ(f.height_at(0, 0), 0);
}

TEST_F(HeightGridTest, FourSierraTilesMakeOneGrid) {
  const fs::path folder = fs::path(TIND_SHARED_DATA) / "raster/sierra-2x2";
  if (!fs::exists(folder)) GTEST_SKIP() << "needs " << folder;
  std::vector<std::string> paths;
  for (const auto& entry : fs::directory_iterator(folder)) paths.push_back(entry.path().string());
  const auto grid = load(paths, 64);
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_EQ(grid->counts().source, 2401u * 2401u);
  EXPECT_EQ(grid->counts().overlapping, 2u * 2401u - 1u);
  EXPECT_GT(grid->counts().disagreeing, 0u);
  EXPECT_LE(grid->field().disagreement_m, 0.5);
}

TEST_F(HeightGridTest, ZippedTileWithVoidsGrowsNoCliff) {
  const fs::path path = fs::path(TIND_SHARED_DATA) / "raster/coast-voids/N43E007.hgt.zip";
  if (!fs::exists(path)) GTEST_SKIP() << "needs " << path;
  const auto grid = load({path.string()}, 64);
  ASSERT_TRUE(grid) << grid.error().message;
  EXPECT_GT(grid->counts().filled, 1500u);
  EXPECT_LT(steepest_outside(grid->field()), 262);  // the steepest step of the source posts themselves is 261 m
}

}  // namespace
}  // namespace tind
