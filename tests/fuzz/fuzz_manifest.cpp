// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/manifest.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto manifest = tind::decode_manifest({data, size});
  if (!manifest) return 0;
  manifest->has_tile({0, 0, 0});
  const std::string text = tind::encode_manifest(*manifest);
  const auto* bytes = reinterpret_cast<const std::uint8_t*>(text.data());
  const auto again = tind::decode_manifest({bytes, text.size()});
  require(again.has_value(), "what was encoded can be decoded");
  require(tind::encode_manifest(*again) == text, "decoding and encoding change nothing");
  return 0;
}
