// SPDX-License-Identifier: GPL-3.0-or-later
// The client reads the source's posts itself; its reading must be right where the builder's could be wrong.
#include "tests/client/source_posts.hpp"

#include <fmt/format.h>
#include <gdal_priv.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace tind::client {
namespace {

using testing::HasSubstr;

struct RasterSpec {
  double west = 10, north = 50;  ///< Of the first post.
  double spacing = 0.5;
  std::optional<double> nodata;
  const char* unit = "";
  double scale = 1, offset = 0;
  double rotation = 0;
};

/// Writes a raster in memory, row by row from the north.
std::string write_raster(const std::string& name, const RasterSpec& spec, const std::vector<std::vector<float>>& rows) {
  GDALAllRegister();
  const std::string path = "/vsimem/" + name + ".tif";
  const auto n_cols = static_cast<int>(rows[0].size()), n_rows = static_cast<int>(rows.size());
  GDALDataset* dataset =
      GetGDALDriverManager()->GetDriverByName("GTiff")->Create(path.c_str(), n_cols, n_rows, 1, GDT_Float32, nullptr);
  double transform[6] = {
      spec.west - spec.spacing / 2, spec.spacing, spec.rotation, spec.north + spec.spacing / 2, 0, -spec.spacing};
  dataset->SetGeoTransform(transform);
  GDALRasterBand* band = dataset->GetRasterBand(1);
  if (spec.nodata) band->SetNoDataValue(*spec.nodata);
  band->SetUnitType(spec.unit);
  band->SetScale(spec.scale);
  band->SetOffset(spec.offset);
  for (int r = 0; r < n_rows; ++r) {
    auto row = rows[static_cast<std::size_t>(r)];
    EXPECT_EQ(band->RasterIO(GF_Write, 0, r, n_cols, 1, row.data(), n_cols, 1, GDT_Float32, 0, 0), CE_None);
  }
  GDALClose(dataset);
  return path;
}

TEST(SourcePosts, RowZeroIsTheSouthAndAPostIsACellsCentre) {
  const auto posts = read_source_posts({write_raster("plain", {}, {{1, 2, 3}, {4, 5, 6}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_rows, 2);
  EXPECT_EQ(posts->n_cols, 3);
  EXPECT_NEAR(posts->west_deg, 10, 1e-12);
  EXPECT_NEAR(posts->south_deg, 49.5, 1e-12);
  EXPECT_EQ(posts->heights_m, (std::vector<float>{4, 5, 6, 1, 2, 3}));
  EXPECT_EQ(posts->n_posts, 6u);
}

TEST(SourcePosts, VoidsUnitsScaleAndOffset) {
  RasterSpec spec;
  spec.nodata = -999;
  spec.unit = "ft";
  spec.scale = 2;
  spec.offset = 10;
  const auto posts = read_source_posts({write_raster("feet", spec, {{-999, 45, NAN}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_posts, 1u);
  EXPECT_TRUE(std::isnan(posts->heights_m[0]));
  EXPECT_FLOAT_EQ(posts->heights_m[1], 100 * 0.3048f);
  EXPECT_TRUE(posts->rounded);
  SourceOptions options;
  options.metres_per_unit = 1;
  options.nodata = 45;
  const auto other = read_source_posts({write_raster("feet2", spec, {{-999, 45, 1}})}, options);
  ASSERT_TRUE(other.has_value());
  EXPECT_EQ(other->heights_m[0], -999 * 2 + 10);
  EXPECT_TRUE(std::isnan(other->heights_m[1]));
}

TEST(SourcePosts, OverlapKeepsEveryDifferentValue) {
  RasterSpec east;
  east.west = 11;
  const auto posts =
      read_source_posts({write_raster("w", {}, {{1, 2, 3}, {4, 5, 6}}), write_raster("e", east, {{3, 7}, {8, 9}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_cols, 4);
  EXPECT_EQ(posts->n_posts, 8u);
  ASSERT_EQ(posts->other_values.size(), 1u) << "3 agrees, 6 and 8 do not";
  EXPECT_EQ(posts->other_values.at(2), std::vector<float>{8});
  EXPECT_EQ(posts->disagreement_m, 2);
}

TEST(SourcePosts, RepeatedMeridianOfAGlobalGridIsFolded) {
  RasterSpec spec;
  spec.west = -180;
  spec.spacing = 90;
  spec.north = 0;
  const auto posts = read_source_posts({write_raster("globe", spec, {{1, 2, 3, 4, 1}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_posts, 4u);
  EXPECT_TRUE(posts->other_values.empty());
}

TEST(SourcePosts, ColumnsThatNearlyCloseAroundTheGlobeClose) {
  RasterSpec spec;
  spec.west = 0;
  spec.spacing = 30.2;
  spec.north = 0;
  const auto posts = read_source_posts({write_raster("nearly", spec, {{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_NEAR(posts->lon_spacing_deg, 30, 1e-12);
  EXPECT_EQ(posts->n_cols, 12);
  spec.spacing = 30.3;
  const auto open = read_source_posts({write_raster("open", spec, {{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}})}, {});
  ASSERT_TRUE(open.has_value()) << open.error();
  EXPECT_NEAR(open->lon_spacing_deg, 30.3, 1e-12) << "more than a tenth of a post off";
}

TEST(SourcePosts, DecimalsOfAHeaderAreNotTakenLiterally) {
  RasterSpec spec;
  spec.west = 10.00000004;
  spec.spacing = 0.00833333333;
  spec.north = 46.00000003;
  const auto posts = read_source_posts({write_raster("decimals", spec, {{1, 2}, {3, 4}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->lon_spacing_deg, 1.0 / 120);
  EXPECT_EQ(posts->west_deg, 10);
  EXPECT_NEAR(posts->latitude_of(2), 46, 1e-12);
}

TEST(SourcePosts, APoleIsOnePointAndRowsBeyondItAreNone) {
  RasterSpec spec;
  spec.west = -180;
  spec.spacing = 90;
  spec.north = 180;
  SourceOptions options;
  options.source_crs = "EPSG:4326";
  const auto posts = read_source_posts(
      {write_raster("poles", spec, {{9, 9, 9, 9}, {1, 2, 3, 4}, {5, 5, 5, 5}, {6, 6, 6, 6}, {8, 8, 8, 8}})}, options);
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_rows, 3);
  EXPECT_EQ(posts->n_posts, 12u);
  EXPECT_EQ(posts->disagreement_m, 3);
  EXPECT_EQ(posts->other_values.size(), 4u) << "all posts of the north pole, none of the south pole";
}

TEST(SourcePosts, HeightsBeyondAnyWorldAndMaskedCellsAreVoids) {
  const auto posts = read_source_posts({write_raster("wild", {}, {{-3.4e38f, 32767, 30001, -9999}})}, {});
  ASSERT_TRUE(posts.has_value()) << posts.error();
  EXPECT_EQ(posts->n_posts, 1u);
  EXPECT_EQ(posts->heights_m[3], -9999);
  const std::string masked = write_raster("masked", {}, {{1, 2, 3}});
  auto* dataset = static_cast<GDALDataset*>(GDALOpen(masked.c_str(), GA_Update));
  CPLSetConfigOption("GDAL_TIFF_INTERNAL_MASK", "YES");
  ASSERT_EQ(dataset->CreateMaskBand(GMF_PER_DATASET), CE_None);
  std::vector<std::uint8_t> mask = {255, 0, 255};
  ASSERT_EQ(dataset->GetRasterBand(1)->GetMaskBand()->RasterIO(GF_Write, 0, 0, 3, 1, mask.data(), 3, 1, GDT_Byte, 0, 0),
            CE_None);
  GDALClose(dataset);
  const auto seen = read_source_posts({masked}, {});
  ASSERT_TRUE(seen.has_value()) << seen.error();
  EXPECT_EQ(seen->n_posts, 2u);
  EXPECT_TRUE(std::isnan(seen->heights_m[1]));
}

TEST(SourcePosts, RefusesWhatIsNoSource) {
  EXPECT_THAT(read_source_posts({"/nowhere/x.tif"}, {}).error(), HasSubstr("GDAL"));
  RasterSpec rotated;
  rotated.rotation = 0.1;
  EXPECT_THAT(read_source_posts({write_raster("rotated", rotated, {{1, 2}})}, {}).error(),
              HasSubstr("manifest's grid"));
  RasterSpec shifted;
  shifted.west = 10.2;
  EXPECT_THAT(read_source_posts({write_raster("a", {}, {{1, 2}}), write_raster("b", shifted, {{1, 2}})}, {}).error(),
              HasSubstr("grid of its own"));
  RasterSpec metres;
  metres.west = 400000;
  EXPECT_THAT(read_source_posts({write_raster("metres", metres, {{1, 2}})}, {}).error(), HasSubstr("--source-crs"));
  RasterSpec voids;
  voids.nodata = 1;
  EXPECT_THAT(read_source_posts({write_raster("voids", voids, {{1, 1}})}, {}).error(), HasSubstr("no post"));
}

}  // namespace
}  // namespace tind::client
