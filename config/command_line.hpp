// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <string>
#include <variant>
#include <vector>

#include "config/settings.hpp"

namespace tind {

/// The program has nothing more to do: print and exit.
struct CommandExit {
  int status = 0;    ///< 0: --help or --version, `text` for stdout; 2: usage, `text` for stderr.
  std::string text;  ///< Ends with a newline.
};

/// `tind --check`: files to be checked instead of served.
struct CheckRequest {
  std::vector<std::string> paths;
  bool as_json = false;
};

/// The daemon's settings, or what else it is asked to do: command line, over environment (TIND_*), over configuration
/// file (--config or TIND_CONFIG), over defaults. `arguments`: without the program's name. Reads the configuration
/// file; thread safe otherwise.
std::variant<Settings, CommandExit, CheckRequest> read_command_line(const std::vector<std::string>& arguments,
                                                                    const Environment& environment);

}  // namespace tind
