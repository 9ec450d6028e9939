// SPDX-License-Identifier: GPL-3.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <iterator>
#include <map>
#include <nlohmann/json.hpp>

#include "config/command_line.hpp"
#include "config/settings.hpp"

namespace tind {
namespace {

using Variables = std::map<std::string, std::string>;

std::string read_file(const std::string& path) {
  std::ifstream in(path);
  EXPECT_TRUE(in.good()) << path;
  return {std::istreambuf_iterator<char>(in), {}};
}

std::variant<Settings, CommandExit, CheckRequest> run(const std::vector<std::string>& arguments,
                                                      const Variables& variables = {}) {
  return read_command_line(arguments, [&](const std::string& name) -> std::optional<std::string> {
    const auto found = variables.find(name);
    return found == variables.end() ? std::nullopt : std::optional(found->second);
  });
}
Settings settings_of(const std::vector<std::string>& arguments, const Variables& variables = {}) {
  const auto result = run(arguments, variables);
  if (const auto* exit = std::get_if<CommandExit>(&result)) {
    ADD_FAILURE() << exit->text;
    return {};
  }
  return std::get<Settings>(result);
}
CommandExit exit_of(const std::vector<std::string>& arguments, const Variables& variables = {}) {
  const auto result = run(arguments, variables);
  EXPECT_TRUE(std::holds_alternative<CommandExit>(result));
  return std::holds_alternative<CommandExit>(result) ? std::get<CommandExit>(result) : CommandExit{-1, {}};
}

class ConfigFile {
 public:
  explicit ConfigFile(const std::string& text) : path(testing::TempDir() + "tind-config-" + std::to_string(getpid())) {
    std::ofstream(path) << text;
  }
  ~ConfigFile() { unlink(path.c_str()); }
  std::string path;
};

TEST(Config, CheckTakesFilesAndNothingElse) {
  const auto asked = run({"--check", "a.tind", "b.tind", "--json"}, {{"TIND_THREADS", "many"}});
  ASSERT_TRUE(std::holds_alternative<CheckRequest>(asked));
  EXPECT_EQ(std::get<CheckRequest>(asked).paths, (std::vector<std::string>{"a.tind", "b.tind"}));
  EXPECT_TRUE(std::get<CheckRequest>(asked).as_json);
  EXPECT_EQ(exit_of({"--check"}).status, 2);
  EXPECT_EQ(exit_of({"--check"}, {{"TIND_DATASETS", "a.tind"}}).status, 2);
  EXPECT_EQ(exit_of({"a.tind", "--json"}).status, 2);
}

TEST(Config, CommandLineWinsOverEnvironmentOverFileOverDefaults) {
  const ConfigFile file(R"({"datasets": ["f.tind"], "threads": 2, "cache_mb": 2, "idle_timeout_s": 2})");
  const Variables variables = {{"TIND_THREADS", "3"}, {"TIND_CACHE_MB", "3"}, {"TIND_DATASETS", "e.tind:g.tind"}};
  const Settings s = settings_of({"c.tind", "--config", file.path, "--threads", "4"}, variables);
  EXPECT_EQ(s.threads, 4);
  EXPECT_EQ(s.cache_mb, 3);
  EXPECT_EQ(s.idle_timeout_s, 2);
  EXPECT_EQ(s.drain_timeout_s, Settings().drain_timeout_s);
  EXPECT_EQ(s.datasets, (std::vector<DatasetSpec>{"c.tind"}));
  EXPECT_EQ(settings_of({"--config", file.path}, variables).datasets,
            (std::vector<DatasetSpec>{{"e.tind"}, {"g.tind"}}));
  EXPECT_EQ(settings_of({"--config", file.path}).datasets, (std::vector<DatasetSpec>{"f.tind"}));
  EXPECT_EQ(settings_of({}, {{"TIND_CONFIG", file.path}}).threads, 2);
}

TEST(Config, UsageErrorsAreOneLineAndStatus2) {
  const ConfigFile unknown(R"({"colour": 1})"), wrong(R"({"threads": "2"})"), broken("{");
  const std::vector<std::vector<std::string>> cases = {{},
                                                       {"a.tind", "--nonsense"},
                                                       {"a.tind", "--threads", "x"},
                                                       {"a.tind", "--threads", "-1"},
                                                       {"a.tind", "--cache-mb", "99999999999"},
                                                       {"a.tind", "--config", "/nonexistent.json"},
                                                       {"a.tind", "--config", unknown.path}};
  for (const auto& arguments : cases) {
    const CommandExit exit = exit_of(arguments);
    EXPECT_EQ(exit.status, 2);
    EXPECT_EQ(std::count(exit.text.begin(), exit.text.end(), '\n'), 1) << exit.text;
    EXPECT_THAT(exit.text, testing::StartsWith("tind: "));
  }
  EXPECT_EQ(exit_of({"a.tind"}, {{"TIND_THREADS", "many"}}).status, 2);
  EXPECT_FALSE(overlay_json({}, R"({"colour": 1})", "f").has_value());
  EXPECT_FALSE(overlay_json({}, R"({"threads": "2"})", "f").has_value());
  EXPECT_FALSE(overlay_json({}, R"({"threads": 2.5})", "f").has_value());
  EXPECT_FALSE(overlay_json({}, R"({"datasets": "a"})", "f").has_value());
  EXPECT_FALSE(overlay_json({}, "{", "f").has_value());
  EXPECT_FALSE(overlay_json({}, "[]", "f").has_value());
}

TEST(Config, DatasetsAreNamedAndHaveBases) {
  const auto read = overlay_json({}, R"({"datasets": ["w.tind", {"path": "a-2.tind", "name": "a", "base": "w"},
      {"path": "folder", "base": "w", "base_mode": "parent_url"}]})",
                                 "f");
  ASSERT_TRUE(read.has_value()) << read.error().message;
  ASSERT_EQ(read->datasets.size(), 3u);
  EXPECT_EQ(read->datasets[0], DatasetSpec("w.tind"));
  EXPECT_EQ(read->datasets[1].name, "a");
  EXPECT_EQ(read->datasets[1].base, "w");
  EXPECT_EQ(read->datasets[1].base_mode, BaseMode::kMerge);
  EXPECT_EQ(read->datasets[2].base_mode, BaseMode::kParentUrl);
}

TEST(Config, MessagesNameFileMemberAndWhatIsAllowed) {
  const std::pair<const char*, std::vector<const char*>> cases[] = {
      {R"({"threads": "2"})", {"f.json", "\"threads\"", "from 0 to 1024"}},
      {R"({"threads": 2000})", {"f.json", "\"threads\"", "2000", "from 0 to 1024"}},
      {R"({"watch": "maybe"})", {"f.json", "\"watch\"", "maybe", "auto, poll, off"}},
      {R"({"listen": 80})", {"f.json", "\"listen\"", "string"}},
      {R"({"colour": 1})", {"f.json", "\"colour\"", "not a setting"}},
      {R"({"datasets": ["a", 1]})", {"f.json", "\"datasets\"[1]", "path"}},
      {R"({"datasets": [""]})", {"\"datasets\"[0]"}},
      {R"({"datasets": [{"name": "x"}]})", {"\"datasets\"[0]", "\"path\" is missing"}},
      {R"({"datasets": [{"path": "x", "name": "a/b"}]})", {"slash"}},
      {R"({"datasets": [{"path": "x", "base_mode": "both"}]})", {"both", "merge", "parent_url"}},
      {R"({"datasets": [{"path": "x", "color": "red"}]})", {"color", "path, name, base"}},
      {R"({"datasets": [{"path": 7}]})", {"\"path\" is not a string"}},
      {"{\n  \"threads\": 2,,\n}", {"f.json", "line 2, column 16"}},
  };
  for (const auto& [text, words] : cases) {
    const auto read = overlay_json({}, text, "f.json");
    ASSERT_FALSE(read.has_value()) << text;
    for (const char* word : words) EXPECT_THAT(read.error().message, testing::HasSubstr(word));
  }
}

TEST(Config, WhatIsPrintedIsAConfigurationFileThatSaysTheSame) {
  const ConfigFile file(
      R"({"datasets": ["w.tind", {"path": "a.tind", "name": "b", "base": "w", "base_mode": "parent_url"},
      {"path": "c.tind", "base": "w"}], "threads": 2, "cache_mb": 2})");
  const Variables variables = {{"TIND_CACHE_MB", "3"}};
  const std::vector<std::string> arguments = {"--config", file.path, "--idle-timeout-s", "9", "--watch", "poll"};
  std::vector<std::string> printing = arguments;
  printing.push_back("--print-config");
  const CommandExit printed = exit_of(printing, variables);
  EXPECT_EQ(printed.status, 0);
  const auto read = overlay_json({}, printed.text, "printed");
  ASSERT_TRUE(read.has_value()) << read.error().message;
  EXPECT_EQ(*read, settings_of(arguments, variables));
  EXPECT_EQ(read->cache_mb, 3);
  EXPECT_EQ(read->watch, "poll");

  printing.back() += "=origins";
  const auto origins = nlohmann::json::parse(exit_of(printing, variables).text);
  EXPECT_EQ(origins["threads"]["from"], file.path);
  EXPECT_EQ(origins["cache_mb"]["from"], "TIND_CACHE_MB");
  EXPECT_EQ(origins["cache_mb"]["value"], 3);
  EXPECT_EQ(origins["watch"]["from"], "--watch");
  EXPECT_EQ(origins["listen"]["from"], "default");
  EXPECT_EQ(origins["datasets"]["from"], file.path);
  EXPECT_EQ(exit_of({"a.tind", "--print-config=nonsense"}).status, 2);
  EXPECT_EQ(exit_of({"--print-config"}).status, 0) << "also without datasets";
}

TEST(Config, HelpNamesEveryOptionWithItsDefault) {
  const CommandExit help = exit_of({"--help"});
  EXPECT_EQ(help.status, 0);
  for (const OptionSpec& option : option_table()) {
    EXPECT_THAT(help.text, testing::HasSubstr(flag_of(option)));
    EXPECT_THAT(help.text, testing::HasSubstr(option.value_name));
  }
  EXPECT_THAT(help.text, testing::HasSubstr("127.0.0.1:8080"));
  EXPECT_EQ(exit_of({"--version"}).status, 0);
}

TEST(Config, ExampleSchemaAndManualAgreeWithTheCode) {
  const std::string example_text = read_file(TIND_CONFIG_DIR "/tind.example.json");
  const auto example = nlohmann::json::parse(example_text);
  const auto schema = nlohmann::json::parse(read_file(TIND_CONFIG_DIR "/settings.schema.json"));
  const std::string manual = read_file(TIND_DOCS_DIR "/man/tind.1.md");
  auto read = overlay_json({}, example_text, "example");
  ASSERT_TRUE(read.has_value()) << read.error().message;
  read->datasets.clear();
  EXPECT_EQ(*read, Settings()) << "the example shows the defaults";
  EXPECT_EQ(example.size(), option_table().size() + 2) << "each option, the datasets and the schema";
  const auto& properties = schema.at("properties");
  EXPECT_EQ(properties.size(), option_table().size() + 2);
  for (const OptionSpec& option : option_table()) {
    SCOPED_TRACE(option.name);
    EXPECT_TRUE(example.contains(option.name));
    const auto& property = properties.at(option.name);
    EXPECT_EQ(property.at("description"), option.help);
    if (const auto* text = std::get_if<std::string Settings::*>(&option.member)) {
      EXPECT_EQ(property.at("default"), Settings().**text);
      if (const auto choices = choices_of(option); !choices.empty()) {
        EXPECT_EQ(property.at("enum"), nlohmann::json(choices));
      } else {
        EXPECT_FALSE(property.contains("enum"));
      }
    } else {
      EXPECT_EQ(property.at("default"), Settings().*std::get<int Settings::*>(option.member));
      EXPECT_EQ(property.at("minimum"), option.minimum);
      EXPECT_EQ(property.at("maximum"), option.maximum);
    }
    EXPECT_THAT(manual, testing::HasSubstr(flag_of(option) + "** *" + option.value_name + "*"));
    EXPECT_THAT(manual, testing::HasSubstr(option.help));
  }
}

}  // namespace
}  // namespace tind
