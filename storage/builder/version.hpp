// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string_view>

#ifndef TIND_VERSION
#error "the build gives TIND_VERSION"
#endif

namespace tind {

/// The builder as the manifest and --version name it. The project's version grows whenever the same input gives other
/// bytes: unfinished and older pyramids are then not gone on with tile by tile.
inline constexpr std::string_view kGenerator = "tind-build " TIND_VERSION;

}  // namespace tind
