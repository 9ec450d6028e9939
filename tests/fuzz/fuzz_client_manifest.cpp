// SPDX-License-Identifier: GPL-3.0-or-later
// The client's reading of meta.json.
#include "tests/client/manifest_view.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace tind::client;
  const auto manifest = read_manifest({data, size});
  if (!manifest) return 0;
  // Wide rows are legal; looking for each one's siblings is only tried on manifests of a size that tests have.
  if (manifest->n_tiles() < 100'000) find_manifest_faults(*manifest);
  manifest->has({0, 0, 0});
  return 0;
}
