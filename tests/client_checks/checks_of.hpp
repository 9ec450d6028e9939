// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <set>

#include "tests/client/verify.hpp"
#include "tests/client_checks/memory_pyramid.hpp"

namespace tind::test {

/// The source posts of the small world.
inline const client::SourcePosts& world_posts() {
  static const client::SourcePosts posts = client::read_source_posts({small_world().raster}, {}).value();
  return posts;
}

/// Runs all checks with the source.
inline std::unique_ptr<client::Report> run_checks(client::TileSource& source, int cuts = 24) {
  client::VerifyOptions options;
  options.dataset = "p";
  options.cuts = cuts;
  auto report = client::verify(source, &world_posts(), options);
  EXPECT_TRUE(report.has_value()) << report.error();
  return report ? std::move(*report) : nullptr;
}

/// Names of the checks that did not hold.
inline std::set<std::string> failed_checks(client::Report& report) {
  std::set<std::string> failed;
  const auto all = report.json();
  for (const auto& check : all["checks"]) {
    if (!check["held"].template get<bool>()) failed.insert(check["id"].template get<std::string>());
  }
  return failed;
}

/// All offenders of a check in one text.
inline std::string offenders_of(client::Report& report, const std::string& id) {
  std::string text;
  for (const auto& offender : report.find(id)->offenders()) text += offender + "\n";
  return text;
}

}  // namespace tind::test
