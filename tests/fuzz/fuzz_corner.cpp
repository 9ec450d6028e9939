// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/piece_blob.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto value = tind::decode_corner({data, size});
  if (!value) return 0;
  // Compared as bytes: a record may hold NaN, which no value equals.
  const tind::Bytes bytes = tind::encode_corner(*value);
  const auto again = tind::decode_corner(bytes);
  require(again.has_value(), "what was encoded can be decoded");
  require(tind::encode_corner(*again) == bytes, "decoding and encoding change nothing");
  return 0;
}
