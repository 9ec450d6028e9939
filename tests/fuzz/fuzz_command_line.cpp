// SPDX-License-Identifier: GPL-3.0-or-later
#include <string>
#include <string_view>
#include <vector>

#include "config/command_line.hpp"
#include "tests/fuzz/fuzz_target.hpp"

// Arguments, one a line. None may name a file: the fuzzer is not to read the machine's.
int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  std::vector<std::string> arguments;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    if (line.find('/') != line.npos || line.find("--config") != line.npos || line.find('\0') != line.npos) continue;
    arguments.emplace_back(line);
  }
  const auto read = tind::read_command_line(arguments, [](const std::string&) { return std::nullopt; });
  if (const auto* settings = std::get_if<tind::Settings>(&read)) {
    for (const tind::OptionSpec& option : tind::option_table()) {
      if (const auto* member = std::get_if<int tind::Settings::*>(&option.member)) {
        const int value = settings->**member;
        require(value >= option.minimum && value <= option.maximum, "numbers are within their limits");
      }
    }
  } else if (const auto* done = std::get_if<tind::CommandExit>(&read)) {
    require(done->status == 0 || done->status == 2, "the exit status is one of ours");
    require(done->text.ends_with("\n"), "what is said ends its line");
  }
  return 0;
}
