// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdio>
#include <string>
#include <vector>

#include "storage/doctor/doctor.hpp"

namespace tind {

struct CheckCommand {
  std::vector<std::string> paths;
  bool as_json = false;
  int threads = 0;  ///< 0: one per core.
};

/// `tind --check`: checks the files one after the other and prints what was found to `out`, how far it is to `progress`
/// (nullptr: nowhere). Returns the exit status: 0 all are sound, 1 one is damaged or cannot be read.
int run_check(const CheckCommand& command, std::FILE* out, std::FILE* progress);

}  // namespace tind
