// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string_view>

namespace tind {

/// The builder as the manifest names it. Grows whenever the same input gives other bytes: unfinished and older pyramids
/// are then not gone on with tile by tile.
inline constexpr std::string_view kGenerator = "tind-build 0.2.0";

}  // namespace tind
