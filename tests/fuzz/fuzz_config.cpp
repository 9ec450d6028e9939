// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <map>
#include <string>
#include <string_view>

#include "config/settings.hpp"
#include "tests/fuzz/fuzz_target.hpp"

namespace {

using namespace tind;

// What was accepted is within its limits, and says the same when it is written down and read again. Only where all of
// it is ASCII: a path may have any bytes, and JSON cannot say those that are no UTF-8.
void check_settings(const Settings& settings, std::string_view input) {
  for (const OptionSpec& option : option_table()) {
    if (const auto* member = std::get_if<int Settings::*>(&option.member)) {
      const int value = settings.**member;
      require(value >= option.minimum && value <= option.maximum, "numbers are within their limits");
    }
  }
  const std::string text = print_settings(settings);
  if (!std::all_of(input.begin(), input.end(), [](char c) { return c > 0; })) return;
  const auto again = overlay_json(Settings{}, text, "again");
  require(again.has_value(), "what is printed can be read");
  require(*again == settings, "what is printed says the same");
}

}  // namespace

// A configuration file, and the environment: 'e' and then NAME=VALUE lines.
int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  if (!text.starts_with("e")) {
    const auto read = overlay_json(Settings{}, text, "fuzz.json");
    json_members(text);
    if (read) check_settings(*read, text);
    if (!read) require(!read.error().message.empty(), "a failure says why");
    return 0;
  }
  const std::string_view input = text;
  text.remove_prefix(1);
  std::map<std::string, std::string> variables;
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    const std::size_t equals = line.find('=');
    if (equals == line.npos) continue;
    variables["TIND_" + std::string(line.substr(0, equals))] = line.substr(equals + 1);
  }
  const auto read = overlay_environment(Settings{}, [&](const std::string& name) -> std::optional<std::string> {
    const auto found = variables.find(name);
    return found == variables.end() ? std::nullopt : std::optional(found->second);
  });
  if (read) check_settings(*read, input);
  return 0;
}
