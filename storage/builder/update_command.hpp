// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// `tind-build update`: argv[0] is the command's name. Returns the exit status.
int update_main(int argc, char** argv);

}  // namespace tind
