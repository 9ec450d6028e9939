// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>

namespace tind::test {

/// Replaces operator new for the program that links it. Largest single request since reset, in bytes. One thread.
std::size_t largest_request();
void reset_largest_request();

}  // namespace tind::test
