// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <string>
#include <vector>

#include "storage/manifest.hpp"
#include "tests/e2e/program.hpp"

namespace tind::test {

/// tind-build run in a folder of its own, as a user meets it.
class BuildProgram : public testing::Test {
 protected:
  ScratchFolder folder;
  const std::string output = folder.file("out.tind");

  /// Runs `tind-build ARGUMENTS -q`.
  static Finished build(
      std::vector<std::string> arguments, const std::function<void()>& prepare = [] {}) {
    arguments.emplace_back("-q");
    return run_program("tind-build", arguments, prepare);
  }
  /// Ended with `status` and one line on stderr that names `word`; nothing on stdout, no file of an output left behind.
  void expect_refusal(const Finished& finished, const std::string& word, int status = 1) const;
  /// Names of all files in the folder.
  std::vector<std::string> files() const;
  /// Builds `inputs` with `more` into `output`; a failure is one of the test.
  void expect_build(const std::vector<std::string>& inputs, const std::vector<std::string>& more = {}) const;
  /// Serves `output` and lets tind-verify hold `sources` against it with `more` options.
  void expect_verified(const std::vector<std::string>& sources, const std::vector<std::string>& more = {}) const;
  /// The manifest of `output`.
  Manifest manifest() const;
};

}  // namespace tind::test
