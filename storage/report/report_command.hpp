// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace tind {

/// `tind-build report ...` (docs/man/tind-build-report.1.md): argv[0] is "report". Prints the report on standard
/// output. Returns the exit status: 0 measured, 1 failed, 2 wrong usage.
int report_main(int argc, char** argv);

}  // namespace tind
