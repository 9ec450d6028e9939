// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include "core/format/bytes.hpp"
#include "server/negotiation.hpp"

namespace tind {

struct Coded {
  Bytes bytes;
  Coding coding = Coding::kIdentity;
};

/// The bytes in `wanted` coding, or as they are where that is not shorter. gzip is one member, zstd one frame with
/// content size. Thread safe.
Coded apply_coding(Bytes bytes, Coding wanted);

/// The Content-Encoding value; "" for identity.
const char* coding_name(Coding coding);

}  // namespace tind
