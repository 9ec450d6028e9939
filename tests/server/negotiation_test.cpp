// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/negotiation.hpp"

#include <gtest/gtest.h>

namespace tind {
namespace {

TEST(Negotiation, ChoosesByQThenZstdGzipIdentity) {
  EXPECT_EQ(choose_coding(std::nullopt), Coding::kIdentity);
  EXPECT_EQ(choose_coding(""), Coding::kIdentity);
  EXPECT_EQ(choose_coding("gzip, deflate, br, zstd"), Coding::kZstd);
  EXPECT_EQ(choose_coding("gzip, deflate"), Coding::kGzip);
  EXPECT_EQ(choose_coding("GZIP;Q=0.5"), Coding::kGzip);
  EXPECT_EQ(choose_coding("zstd;q=0.5, gzip;q=0.8"), Coding::kGzip);
  EXPECT_EQ(choose_coding("zstd;q=0, gzip;q=0"), Coding::kIdentity);
  EXPECT_EQ(choose_coding("identity;q=1, gzip;q=0.5"), Coding::kIdentity);
  EXPECT_EQ(choose_coding("*"), Coding::kZstd);
  EXPECT_EQ(choose_coding("zstd;q=0, *"), Coding::kGzip);
  EXPECT_EQ(choose_coding("*;q=0"), Coding::kIdentity);
  EXPECT_EQ(choose_coding("gzip;q=0.001"), Coding::kGzip);
  EXPECT_EQ(choose_coding("zstd;q=nonsense, gzip"), Coding::kGzip);
  EXPECT_EQ(choose_coding("br, deflate"), Coding::kIdentity);
  EXPECT_EQ(choose_coding(",,;;=,gzip"), Coding::kGzip);
}

TEST(Negotiation, MatchesEntityTagsWeaklyInLists) {
  const char* const tag = "\"abc,d-z\"";
  EXPECT_TRUE(etag_matches(tag, tag));
  EXPECT_TRUE(etag_matches("W/\"abc,d-z\"", tag));
  EXPECT_TRUE(etag_matches("\"x\", W/\"y\" ,\"abc,d-z\"", tag));
  EXPECT_TRUE(etag_matches(" * ", tag));
  EXPECT_FALSE(etag_matches("\"abc,d\"", tag));
  EXPECT_FALSE(etag_matches("abc,d-z", tag));
  EXPECT_FALSE(etag_matches("", tag));
  EXPECT_FALSE(etag_matches("\"abc", tag));
}

TEST(Negotiation, FindsNormalsInAcceptAndQuery) {
  EXPECT_TRUE(
      wants_normals("application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata,"
                    "application/octet-stream;q=0.9,*/*;q=0.01",
                    std::nullopt));
  EXPECT_TRUE(wants_normals(std::nullopt, "octvertexnormals-metadata"));
  EXPECT_TRUE(wants_normals("application/vnd.quantized-mesh;extensions=\"octvertexnormals\"", std::nullopt));
  EXPECT_FALSE(wants_normals("application/vnd.quantized-mesh,application/octet-stream;q=0.9,*/*;q=0.01", std::nullopt));
  EXPECT_FALSE(wants_normals("application/json;extensions=octvertexnormals", std::nullopt));
  EXPECT_FALSE(wants_normals(std::nullopt, "watermask-octvertexnormalsx"));
  EXPECT_FALSE(wants_normals(std::nullopt, std::nullopt));
}

}  // namespace
}  // namespace tind
