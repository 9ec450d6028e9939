// SPDX-License-Identifier: GPL-3.0-or-later
// The client's LAS reader.
#include <algorithm>
#include <cmath>

#include "tests/client/las_points.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace tind::client;
  const auto read = [=](std::uint64_t offset, std::size_t n) {
    if (offset >= size) return Blob{};
    const std::size_t end = static_cast<std::size_t>(offset) + std::min(n, size - static_cast<std::size_t>(offset));
    return Blob(data + offset, data + end);
  };
  ClassFilter all;
  all.set();
  const auto las = read_las(read, size, all);
  if (!las) return 0;
  require(las->x.size() == las->y.size() && las->x.size() == las->z.size(), "all columns have one size");
  require(las->x.size() * 20 <= size, "no point comes from nowhere");
  std::uint64_t counted = 0;
  for (const auto n : las->n_of_class) counted += n;
  require(counted == las->x.size(), "all classes were asked for");
  return 0;
}
