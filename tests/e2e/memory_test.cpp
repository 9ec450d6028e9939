// SPDX-License-Identifier: GPL-3.0-or-later
// What tind-build holds in memory. Alone in its program: the system tells the most of all children.
#include <cmath>
#include <cstdint>
#include <fstream>
#include <vector>

#include <gtest/gtest.h>
#include <sys/resource.h>

#include "tests/e2e/program.hpp"

namespace tind::test {
namespace {

// A raster of n x n posts: hills of a hundred posts, noise of 60 m, so that no block of posts is a plane.
void write_hills(const std::string& base, std::int64_t n) {
  write_file(base + ".hdr", "BYTEORDER I\nLAYOUT BIL\nNROWS " + std::to_string(n) + "\nNCOLS " + std::to_string(n) +
                                "\nNBANDS 1\nNBITS 16\nPIXELTYPE SIGNEDINT\nULXMAP 10\nULYMAP 46\n"
                                "XDIM 0.0008333333333333334\nYDIM 0.0008333333333333334\nNODATA -32768\n");
  write_file(base + ".prj",
             "GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,298.257223563]],PRIMEM[\"Greenwich\",0],"
             "UNIT[\"degree\",0.0174532925199433]]\n");
  std::ofstream file(base + ".bil", std::ios::binary);
  std::vector<std::int16_t> row(static_cast<std::size_t>(n));
  for (std::int64_t r = 0; r < n; ++r) {
    const double y = static_cast<double>(r);
    for (std::int64_t c = 0; c < n; ++c) {
      const double x = static_cast<double>(c);
      const auto mixed = static_cast<std::uint64_t>(r * 7919 + c * 104729) * 2654435761u >> 13;
      row[static_cast<std::size_t>(c)] =
          static_cast<std::int16_t>(900 * std::sin(y / 97) * std::cos(x / 131) + 300 * std::sin(y / 23 + x / 31) +
                                    static_cast<double>(mixed % 61));
    }
    file.write(reinterpret_cast<const char*>(row.data()), static_cast<std::streamsize>(2 * row.size()));
  }
}

// 36 million posts are 260 MB with their blocks. When all of it was mapped, 240 MB were held here of 128 allowed.
TEST(BuildMemory, PostsAreNotInMemoryAsAWhole) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "sanitizers keep several bytes of their own for each of the program's";
#endif
  const ScratchFolder folder;
  write_hills(folder.file("hills"), 6000);
  const Finished finished =
      run_program("tind-build", {folder.file("hills.bil"), "-o", folder.file("out.tind"), "--tolerance", "200",
                                 "--no-drainage", "--memory", "128M", "--threads", "2", "-q"});
  ASSERT_EQ(finished.status, 0) << finished.err;
  rusage usage{};
  ASSERT_EQ(getrusage(RUSAGE_CHILDREN, &usage), 0);
  EXPECT_GT(usage.ru_maxrss, 20 << 10) << "of the build, KB";
  EXPECT_LT(usage.ru_maxrss, 200 << 10);
}

}  // namespace
}  // namespace tind::test
