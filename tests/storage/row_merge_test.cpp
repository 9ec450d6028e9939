// SPDX-License-Identifier: GPL-3.0-or-later
// Random mosaics of random kinds of files against the definition, post by post.
#include "storage/readers/row_merge.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

namespace tind {
namespace {

namespace fs = std::filesystem;

constexpr int kNodata = -9999, kSpacingDeg = 5;

class RowMergeTest : public ::testing::Test {
 protected:
  enum class Kind { kWhole, kFloat, kShort };
  struct File {
    int n_rows = 0, n_cols = 0, west = 0, south = 0;  // the last two in posts, from the meridian and the equator
    std::vector<std::optional<float>> heights;        // row 0 is the southernmost
  };

  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "tind-row-merge-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { fs::remove_all(folder_); }

  int pick(int least, int most) { return std::uniform_int_distribution(least, most)(random_); }

  File random_file(Kind kind) {
    File file{pick(2, 9), pick(2, 40), pick(-36, 35), pick(-10, 6), {}};
    // Whole files without a void, and some with many.
    const double voids = std::array{0.0, 0.0, 0.01, 0.4}[static_cast<std::size_t>(pick(0, 3))];
    for (int k = 0; k < file.n_rows * file.n_cols; ++k) {
      const int height = pick(-3, 3) * 100;
      if (std::bernoulli_distribution(voids)(random_)) {
        file.heights.emplace_back();
      } else if (kind == Kind::kFloat) {
        file.heights.emplace_back(static_cast<float>(height) + 0.25f);
      } else {
        file.heights.emplace_back(static_cast<float>(height));
      }
    }
    return file;
  }

  // A text grid, or raw numbers of 16 bits.
  std::string write(const File& file, Kind kind, int number) {
    const double west = file.west * kSpacingDeg, south = file.south * kSpacingDeg;
    const auto name = (folder_ / fmt::format("{}", number)).string();
    const auto value = [&](int k) {
      const auto& height = file.heights[static_cast<std::size_t>(k)];
      return height ? static_cast<double>(*height) : double{kNodata};
    };
    if (kind == Kind::kShort) {
      std::ofstream out(name + ".bil", std::ios::binary);
      for (int r = file.n_rows - 1; r >= 0; --r) {
        for (int c = 0; c < file.n_cols; ++c) {
          const auto v = static_cast<std::int16_t>(value(r * file.n_cols + c));
          const char bytes[] = {static_cast<char>(v & 255), static_cast<char>((v >> 8) & 255)};
          out.write(bytes, 2);
        }
      }
      std::ofstream(name + ".hdr") << fmt::format(
          "BYTEORDER I\nLAYOUT BIL\nNROWS {}\nNCOLS {}\nNBANDS 1\nNBITS 16\nPIXELTYPE SIGNEDINT\nNODATA {}\nULXMAP "
          "{}\nULYMAP {}\nXDIM {}\nYDIM {}\n",
          file.n_rows, file.n_cols, kNodata, west, south + (file.n_rows - 1) * kSpacingDeg, kSpacingDeg, kSpacingDeg);
      return name + ".bil";
    }
    std::ofstream out(name + ".asc");
    out << fmt::format("ncols {}\nnrows {}\nxllcenter {}\nyllcenter {}\ncellsize {}\nNODATA_value {}\n", file.n_cols,
                       file.n_rows, west, south, kSpacingDeg, kNodata);
    for (int r = file.n_rows - 1; r >= 0; --r) {
      for (int c = 0; c < file.n_cols; ++c) out << value(r * file.n_cols + c) << ' ';
      out << '\n';
    }
    return name + ".asc";
  }

  std::mt19937 random_{20261122};
  fs::path folder_;
};

TEST_F(RowMergeTest, GivesThePostsThatTheDefinitionGives) {
  int n_alone = 0, n_overlapping = 0, n_void = 0, n_wrapped = 0;
  for (int round = 0; round < 150; ++round) {
    std::map<std::string, File> files;
    std::vector<std::string> paths;
    for (int k = 0, n = pick(1, 6); k < n; ++k) {
      const Kind kind = static_cast<Kind>(pick(0, 2));
      const File file = random_file(kind);
      paths.push_back(write(file, kind, round * 10 + k));
      files[paths.back()] = file;
    }
    const auto mosaic = RasterMosaic::open(paths, {});
    ASSERT_TRUE(mosaic) << mosaic.error().message;
    const std::int64_t west_col = pick(0, 3), n_grid_cols = west_col + mosaic->n_cols + pick(0, 3);
    RowMerge merge(*mosaic, n_grid_cols, west_col, nullptr);
    HeightGridCounts counts;
    for (std::int64_t begin = 0, end = 0; begin < mosaic->n_rows; begin = end) {
      end = std::min<std::int64_t>(mosaic->n_rows, begin + pick(1, 7));
      const auto merged = merge.merge(begin, end);
      ASSERT_TRUE(merged) << merged.error().message;
      for (std::int64_t r = begin; r < end; ++r) {
        bool any = false;
        for (std::int64_t c = 0; c < n_grid_cols; ++c) {
          double sum = 0;
          int n = 0;
          float low = 0, high = 0;
          for (const RasterSource& source : mosaic->sources) {
            const File& file = files[source.path];
            const std::int64_t row = r - source.grid_row;
            if (row < 0 || row >= file.n_rows) continue;
            any = true;
            for (std::int64_t col = 0; col < file.n_cols; ++col) {
              if ((source.grid_col + col) % mosaic->n_cols != c - west_col) continue;
              if (source.grid_col + col >= mosaic->n_cols) ++n_wrapped;
              const auto& height = file.heights[static_cast<std::size_t>(row * file.n_cols + col)];
              if (!height) continue;
              low = n > 0 ? std::min(low, *height) : *height;
              high = n > 0 ? std::max(high, *height) : *height;
              sum += *height;
              ++n;
            }
          }
          if (!*merged) {
            ASSERT_FALSE(any);
            continue;
          }
          const auto at = static_cast<std::size_t>((r - begin) * n_grid_cols + c);
          ASSERT_EQ(merge.origins()[at], n > 0 ? PostOrigin::kSource : PostOrigin::kBase) << round;
          ASSERT_EQ(merge.heights_m()[at], n > 0 ? static_cast<float>(sum / n) : 0.0f) << round;
          counts.source += n > 0;
          counts.overlapping += n > 1;
          counts.disagreeing += n > 1 && low != high;
          n_alone += n == 1;
          n_overlapping += n > 1;
          n_void += n == 0;
        }
      }
      if (*merged) EXPECT_EQ(merge.heights_m().size(), static_cast<std::size_t>((end - begin) * n_grid_cols));
    }
    EXPECT_EQ(merge.counts().source, counts.source);
    EXPECT_EQ(merge.counts().overlapping, counts.overlapping);
    EXPECT_EQ(merge.counts().disagreeing, counts.disagreeing);
  }
  // All ways were gone.
  EXPECT_GT(n_alone, 1000);
  EXPECT_GT(n_overlapping, 1000);
  EXPECT_GT(n_void, 1000);
  EXPECT_GT(n_wrapped, 100);
}

}  // namespace
}  // namespace tind
