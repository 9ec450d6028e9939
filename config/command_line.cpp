// SPDX-License-Identifier: GPL-3.0-or-later
#include "config/command_line.hpp"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <fstream>
#include <iterator>
#include <map>

#ifndef TIND_VERSION
#error "the build gives TIND_VERSION"
#endif

namespace tind {
namespace {

constexpr int kUsage = 2;

std::string default_of(const OptionSpec& option) {
  const Settings defaults;
  if (const auto* text = std::get_if<std::string Settings::*>(&option.member)) return defaults.**text;
  return std::to_string(defaults.*std::get<int Settings::*>(option.member));
}

CommandExit usage_error(const std::string& message) { return {kUsage, "tind: " + message + " (see tind --help)\n"}; }

Result<std::string> read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  std::string text(std::istreambuf_iterator<char>(in), {});
  if (!in.good() && !in.eof()) return fail(ErrorKind::kInvalidInput, path + ": cannot be read");
  return text;
}

}  // namespace

std::variant<Settings, CommandExit, CheckRequest> read_command_line(const std::vector<std::string>& arguments,
                                                                    const Environment& environment) {
  CLI::App app("Serves TIN pyramids made by tind-build over HTTP.", "tind");
  app.set_version_flag("--version", "tind " TIND_VERSION, "print the version and exit");
  app.set_help_flag("--help,-h", "print this help and exit");
  std::string print_config;  // a flag's text is "true"
  app.add_flag("--print-config", print_config,
               "print the settings in effect as a configuration file and exit; --print-config=origins says where each "
               "comes from");
  app.footer(
      "Each option can also be set by a variable of the environment (--idle-timeout-s: TIND_IDLE_TIMEOUT_S;\n"
      "datasets: TIND_DATASETS, separated by colons) or in the configuration file (idle_timeout_s). The command\n"
      "line wins over the environment, and this over the file.\n\n"
      "SIGTERM and SIGINT finish what is under way, then exit.\n"
      "Exit status: 0 stopped by a signal, 1 failed, 2 wrong usage; of --check: 0 sound, 1 damaged, 2 wrong usage.\n\n"
      "Examples: tind alps.tind andes.tind --listen 0.0.0.0:8080\n"
      "          tind --check alps.tind");
  std::vector<std::string> datasets;
  std::string config_path;
  app.add_option("datasets", datasets, "files made by tind-build, or folders of them; NAME.tind is served under /NAME/")
      ->type_name("NAME.tind");
  app.add_option("--config", config_path, "configuration file (JSON)")->type_name("FILE");
  bool is_check = false, as_json = false;
  app.add_flag("--check", is_check, "read the files whole and say whether they are sound; serve nothing");
  app.add_flag("--json", as_json, "with --check: print what was found as JSON")->needs("--check");
  std::map<const OptionSpec*, std::string> given;
  std::map<const OptionSpec*, CLI::Option*> added;
  for (const OptionSpec& option : option_table()) {
    added[&option] = app.add_option(flag_of(option), given[&option], option.help)
                         ->type_name(option.value_name)
                         ->default_str(default_of(option));
  }
  try {
    std::vector<std::string> reversed(arguments.rbegin(), arguments.rend());  // as CLI11 wants them
    app.parse(reversed);
  } catch (const CLI::CallForHelp&) {
    return CommandExit{0, app.help()};
  } catch (const CLI::CallForVersion&) {
    return CommandExit{0, app.version() + "\n"};
  } catch (const CLI::ParseError& error) {
    return usage_error(error.what());
  }

  if (!print_config.empty() && print_config != "true" && print_config != "origins") {
    return usage_error("--print-config=" + print_config + ": only =origins");
  }
  if (is_check) {
    if (datasets.empty()) return usage_error("--check: name at least one NAME.tind");
    return CheckRequest{datasets, as_json};
  }

  Settings settings;
  std::map<std::string, std::string> origins;
  if (config_path.empty()) config_path = environment("TIND_CONFIG").value_or("");
  if (!config_path.empty()) {
    const auto text = read_file(config_path);
    if (!text) return usage_error(text.error().message);
    const auto overlaid = overlay_json(settings, *text, config_path);
    if (!overlaid) return usage_error(overlaid.error().message);
    settings = *overlaid;
    for (const std::string& name : json_members(*text)) origins[name] = config_path;
  }
  const auto overlaid = overlay_environment(settings, environment);
  if (!overlaid) return usage_error(overlaid.error().message);
  settings = *overlaid;
  if (environment("TIND_DATASETS").value_or("") != "") origins["datasets"] = "TIND_DATASETS";
  for (const auto& [option, handle] : added) {
    if (environment(variable_of(*option))) origins[option->name] = variable_of(*option);
    if (handle->count() == 0) continue;
    origins[option->name] = flag_of(*option);
    const auto set = set_option(settings, *option, given[option], flag_of(*option));
    if (!set) return usage_error(set.error().message);
  }
  if (!datasets.empty()) {
    settings.datasets.assign(datasets.begin(), datasets.end());
    origins["datasets"] = "the command line";
  }
  if (!print_config.empty())
    return CommandExit{0, print_settings(settings, print_config == "origins" ? &origins : nullptr)};
  if (settings.datasets.empty()) return usage_error("no dataset: give at least one NAME.tind or a folder");
  return settings;
}

}  // namespace tind
