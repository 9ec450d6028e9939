// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/piece_blob.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  (void)tind::decode_interior({data, size});
  const auto value = tind::decode_body({data, size});
  if (!value) return 0;
  // Compared as bytes: a record may hold NaN, which no value equals.
  const tind::Bytes bytes = tind::encode_body(*value);
  const auto again = tind::decode_body(bytes);
  require(again.has_value(), "what was encoded can be decoded");
  require(tind::encode_body(*again) == bytes, "decoding and encoding change nothing");
  for (const tind::Bytes& stored : {bytes, tind::pack_body(*value)}) {
    const auto interior = tind::decode_interior(stored);
    require(interior.has_value() && *interior == value->interior, "a body's interior can be read alone");
  }
  return 0;
}
