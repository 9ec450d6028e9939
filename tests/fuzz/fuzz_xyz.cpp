// SPDX-License-Identifier: GPL-3.0-or-later
#include <vector>

#include "storage/readers/xyz_points.hpp"
#include "tests/fuzz/fuzz_target.hpp"
#include "tests/support/memory_source.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  // The result must not depend on how many points are asked for at a time.
  std::vector<tind::XyzPoint> results[2];
  bool failed[2] = {false, false};
  for (const int i : {0, 1}) {
    tind::test::MemorySource source({data, size});
    auto reader = tind::XyzReader::open(source, "fuzz");
    failed[i] = !reader;
    for (bool more = reader.has_value(); more;) {
      const auto next = reader->next(i == 0 ? 1 : 1000, results[i]);
      failed[i] = !next;
      more = next && *next;
    }
  }
  require(failed[0] == failed[1] && results[0].size() == results[1].size(), "batches do not matter");
  require(results[0].size() <= size, "a point takes a line");
  return 0;
}
