// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// `tind-build plan`: prints what a build would take and the data's problems. `argv[0]` is "plan". Returns the exit
/// status.
int plan_main(int argc, char** argv);

}  // namespace tind
