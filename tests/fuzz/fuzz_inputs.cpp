// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/inputs_blob.hpp"
#include "storage/value_hash.hpp"
#include "tests/fuzz/fuzz_target.hpp"

namespace {

void decode(tind::ByteView record) {
  const auto inputs = tind::decode_inputs(record);
  const auto head = tind::decode_inputs_head(record);
  if (!inputs) return;
  require(head && head->frame == inputs->frame && head->posts == inputs->posts && head->body == inputs->body,
          "what is decoded has such a head");
  const tind::Bytes bytes = tind::encode_inputs(*inputs);
  const auto again = tind::decode_inputs(bytes);
  require(again.has_value(), "what was encoded can be decoded");
  require(*again == *inputs, "encoding and decoding change nothing");
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  decode({data, size});
  // And with the hash that it should end with, which no chance would hit upon.
  tind::Bytes sealed(data, data + size);
  tind::ByteWriter seal;
  seal.fixed(tind::value_hash(sealed));
  const tind::Bytes end = seal.take();
  sealed.insert(sealed.end(), end.begin(), end.end());
  decode(sealed);
  return 0;
}
