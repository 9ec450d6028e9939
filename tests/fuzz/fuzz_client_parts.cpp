// SPDX-License-Identifier: GPL-3.0-or-later
// The client's .parts and piece decoders, and its assembly.
#include "tests/client/decode.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace tind::client;
  const auto bundle = read_bundle({data, size});
  if (!bundle) return 0;
  const LatticeFrame frame{kDeepestLevel, 0};
  const auto pieces = read_pieces(*bundle, frame);
  if (!pieces) return 0;
  const auto tile = assemble_pieces(bundle->id, *pieces, frame);
  if (!tile) return 0;
  require(tile->vertices.size() == tile->ring_size() + pieces->body.vertices.size(),
          "an assembled tile has all its vertices");
  for (int b = 0; b < 4; ++b) {
    const auto side = stored_side(*tile, b);
    for (std::size_t k = 1; k < side.size(); ++k) require(side[k].t > side[k - 1].t, "sides of assembled tiles ascend");
  }
  return 0;
}
