// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/e2e/build_program.hpp"

#include <algorithm>

#include "storage/tile_store.hpp"
#include "storage/zstd_codec.hpp"

namespace tind::test {

using testing::HasSubstr;
using testing::StartsWith;

void BuildProgram::expect_refusal(const Finished& finished, const std::string& word, int status) const {
  EXPECT_EQ(finished.status, status);
  EXPECT_EQ(count_lines(finished.err), 1u) << finished.err;
  EXPECT_THAT(finished.err, StartsWith("tind-build: "));
  EXPECT_THAT(finished.err, HasSubstr(word));
  EXPECT_EQ(finished.out, "");
  for (const std::string& name : files()) {
    EXPECT_THAT(name, testing::Not(HasSubstr("out.tind"))) << "was left behind";
    EXPECT_THAT(name, testing::Not(HasSubstr(".gpkg"))) << "was left behind";
  }
}

std::vector<std::string> BuildProgram::files() const {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder.path())) {
    names.push_back(entry.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

void BuildProgram::expect_build(const std::vector<std::string>& inputs, const std::vector<std::string>& more) const {
  auto arguments = inputs;
  arguments.insert(arguments.end(), {"-o", output});
  arguments.insert(arguments.end(), more.begin(), more.end());
  const auto finished = build(arguments);
  ASSERT_EQ(finished.status, 0) << finished.err;
  EXPECT_EQ(finished.err, "");
}

void BuildProgram::expect_verified(const std::vector<std::string>& sources,
                                   const std::vector<std::string>& more) const {
  const Daemon daemon({output});
  std::vector<std::string> arguments = {daemon.url() + "/out", "--cuts", "60", "--quiet"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  arguments.emplace_back("--source");
  arguments.insert(arguments.end(), sources.begin(), sources.end());
  const auto finished = run_program("tind-verify", arguments);
  EXPECT_EQ(finished.status, 0) << finished.out << finished.err;
}

Manifest BuildProgram::manifest() const {
  const auto store = TileStore::open(output);
  if (!store) {
    ADD_FAILURE() << store.error().message;
    return {};
  }
  const auto snapshot = store->snapshot();
  return decode_manifest(unpack_value(*snapshot->find_manifest()).value()).value();
}

}  // namespace tind::test
