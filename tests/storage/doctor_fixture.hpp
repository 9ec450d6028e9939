// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "storage/builder/build.hpp"
#include "storage/doctor/doctor.hpp"
#include "tests/storage/damaged_store.hpp"

namespace tind::test {

constexpr std::uint8_t kLevel = 9;  // of the damaged tile; the bottom level is 10
using Change = std::function<void(DamagedStore&)>;

inline std::string text_of(const CheckReport& report) {
  std::string text = fmt::format("{} faults\n", report.n_faults);
  for (const Fault& fault : report.faults) text += fault.where + ": " + fault.what + "\n";
  return text;
}

/// A small real pyramid, and a tile in the middle of it to be damaged.
class DoctorTest : public ::testing::Test {
 protected:
  // A real DEM, kept small: every case runs in a process of its own.
  static void SetUpTestSuite() {
    std::string name = (std::filesystem::temp_directory_path() / "tind-doctor-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder() = name;
    BuildOptions options;
    options.source.inputs = {TIND_TEST_DATA "/sangre_de_cristo.tif"};
    options.output = path("sound.tind");
    options.lines.drainage = false;
    Progress silent(nullptr);
    const auto built = build_pyramid(options, silent);
    ASSERT_TRUE(built) << built.error().message;
  }
  static void TearDownTestSuite() { std::filesystem::remove_all(folder()); }

  static std::filesystem::path& folder() {
    static std::filesystem::path path;
    return path;
  }
  static std::string path(const std::string& name) { return (folder() / name).string(); }

  void SetUp() override {
    DamagedStore store(path("sound.tind"));
    // A tile with data in the middle of the pyramid whose south edge is half of its parent's, with vertices of both.
    for (const auto& [key, value] : store.records()) {
      if (key.size() != 10 || key[9] != static_cast<std::uint8_t>(PieceKind::kBody) || key[0] != kLevel) continue;
      std::uint64_t code = 0;
      for (std::size_t b = 1; b < 9; ++b) code = code << 8 | key[b];
      const TileKey tile{kLevel, morton_decode_even(code), morton_decode_even(code >> 1)};
      if (tile.y % 2 != 0 || store.body(tile).interior.size() < 8 || store.body(tile).stats.n_posts == 0) continue;
      const EdgeChain south = store.edge({PieceKind::kEdgeH, kLevel, tile.x, tile.y});
      const auto is_old = [](const EdgeVertex& v) { return v.entry < kLevel; };
      if (south.inner.size() < 3 || !std::any_of(south.inner.begin(), south.inner.end(), is_old) ||
          std::all_of(south.inner.begin(), south.inner.end(), is_old)) {
        continue;
      }
      tile_ = tile;
      south_ = {PieceKind::kEdgeH, kLevel, tile.x, tile.y};
      body_ = {PieceKind::kBody, kLevel, tile.x, tile.y};
      inputs_ = {PieceKind::kInputs, kLevel, tile.x, tile.y};
      old_vertex_ =
          static_cast<std::size_t>(std::find_if(south.inner.begin(), south.inner.end(), is_old) - south.inner.begin());
      new_vertex_ = static_cast<std::size_t>(std::find_if_not(south.inner.begin(), south.inner.end(), is_old) -
                                             south.inner.begin());
      return;
    }
    FAIL() << "no such tile";
  }

  static CheckReport check(const std::string& file) {
    CheckOptions options;
    options.threads = 2;
    auto report = check_file(file, options);
    EXPECT_TRUE(report) << report.error().message;
    return report ? std::move(*report) : CheckReport{};
  }
  static CheckReport check(const DamagedStore& store) {
    store.write(path("damaged.tind"));
    return check(path("damaged.tind"));
  }

  static bool has_fault(const CheckReport& report, const std::string& where, const std::string& what) {
    return std::any_of(report.faults.begin(), report.faults.end(), [&](const Fault& fault) {
      return fault.where.find(where) != std::string::npos && fault.what.find(what) != std::string::npos;
    });
  }

  /// The content hash tells of `change`; with the hash made right a fault whose place has `where` and whose text has
  /// `what`.
  void expect_found(const std::string& field, const Change& change, const std::string& where,
                    const std::string& what) const {
    SCOPED_TRACE(field);
    DamagedStore store(path("sound.tind"));
    change(store);
    const CheckReport as_is = check(store);
    EXPECT_TRUE(has_fault(as_is, "manifest", "content_hash") || has_fault(as_is, where, what)) << text_of(as_is);
    store.renew_hash();
    const CheckReport hidden = check(store);
    EXPECT_TRUE(has_fault(hidden, where, what)) << "expected " << where << ": " << what << "\n" << text_of(hidden);
    EXPECT_FALSE(has_fault(hidden, "manifest", "content_hash")) << text_of(hidden);
  }
  void expect_body_fault(const std::string& field, const std::function<void(TileBody&)>& change,
                         const std::string& what) const {
    expect_found(
        "body: " + field, [&](DamagedStore& s) { s.change_body(tile_, change); }, name_of(tile_), what);
  }
  void expect_edge_fault(const std::string& field, const std::function<void(EdgeChain&)>& change,
                         const std::string& where, const std::string& what) const {
    expect_found(
        "edge: " + field, [&](DamagedStore& s) { s.change_edge(south_, change); }, where, what);
  }

  TileKey tile_;
  PieceKey south_, body_, inputs_;
  std::size_t old_vertex_ = 0, new_vertex_ = 0;  // of the south edge: entered before this level, at it
};

}  // namespace tind::test
