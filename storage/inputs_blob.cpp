// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/inputs_blob.hpp"

#include <algorithm>

namespace tind {
namespace {

constexpr std::uint8_t kInputsTag = 'I';

}  // namespace

Bytes encode_inputs(const TileInputs& inputs) {
  ByteWriter out;
  out.fixed(kInputsTag);
  out.raw(inputs.digest);
  for (const std::uint64_t n :
       {inputs.n_inserted, inputs.n_of_lines, inputs.n_outside, inputs.n_line_pieces, inputs.n_left_out}) {
    out.uvarint(n);
  }
  return out.take();
}

Result<TileInputs> decode_inputs(ByteView record) {
  ByteReader in(record);
  TileInputs inputs;
  const bool tagged = in.fixed<std::uint8_t>() == kInputsTag;
  const ByteView digest = in.raw(inputs.digest.size());
  std::copy(digest.begin(), digest.end(), inputs.digest.begin());
  for (std::uint64_t* n :
       {&inputs.n_inserted, &inputs.n_of_lines, &inputs.n_outside, &inputs.n_line_pieces, &inputs.n_left_out}) {
    *n = in.uvarint();
  }
  if (!tagged || !in.finished()) return fail(ErrorKind::kCorrupt, "broken inputs record");
  return inputs;
}

}  // namespace tind
