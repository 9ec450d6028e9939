// SPDX-License-Identifier: GPL-3.0-or-later
// The client's quantized-mesh decoder and its look at the mesh.
#include "tests/client/terrain_decode.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace tind::client;
  const auto mesh = read_terrain({data, size});
  if (!mesh) return 0;
  for (const auto& t : mesh->triangles) {
    for (const auto corner : t) require(corner < mesh->u.size(), "indices are in range");
  }
  find_mesh_faults(*mesh);
  return 0;
}
