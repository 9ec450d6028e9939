// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/zstd_codec.hpp"
#include "tests/fuzz/fuzz_target.hpp"

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto start = tind::unpack_start({data, size}, [](tind::ByteView, std::uint64_t) { return false; });
  const auto record = tind::unpack_value({data, size});
  require(!start || !record || *start == *record, "block by block gives the same record");
  if (!record) return 0;
  require(record->size() <= tind::kMaxRecordBytes, "no record beyond the limit");
  if (tind::is_zstd_frame(*record)) return 0;  // no record starts so, and pack_value may take that for granted
  const auto again = tind::unpack_value(tind::pack_value(*record));
  require(again.has_value() && *again == *record, "a record survives packing");
  return 0;
}
