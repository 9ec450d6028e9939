// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// `tind-build merge`: argv[0] is the command's name. Returns the exit status.
int merge_main(int argc, char** argv);

}  // namespace tind
