// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/result.hpp"
#include "storage/builder/build.hpp"

namespace CLI {
class App;
}

namespace tind {

/// Exit status of the commands of tind-build.
inline constexpr int kExitFailed = 1;
inline constexpr int kExitUsage = 2;

/// The options that shape a pyramid, as `tind-build` and its commands take them on the command line: one list, one help
/// text, one check. add_to() declares them, App::parse() fills this object (which must not move between), finish()
/// checks what CLI11 cannot.
class BuildArguments {
 public:
  /// Declares INPUT... and all options. `needs_output`: -o must be given.
  void add_to(CLI::App& app, bool needs_output);
  /// kInvalidInput names the option and what it takes. `cancel` is left to the caller.
  Result<BuildOptions> finish() const;

 private:
  void add_source(CLI::App& app);
  void add_lines(CLI::App& app);
  void add_work(CLI::App& app);

  BuildOptions options_;
  std::string mode_ = "non-standard", metres_ = "auto", resampling_ = "bilinear", classes_ = "2";
  std::string memory_ = "512M", shard_;
  std::vector<double> tolerances_;
  std::optional<double> lake_km2_;
  std::vector<std::string> break_lines_, lakes_;
  bool no_drainage_ = false;
};

/// "512" and "512M": 512 * 2^20 bytes, "2G": 2 * 2^30. kInvalidInput: anything else, or less than kLeastMemoryBytes.
Result<std::uint64_t> parse_memory(const std::string& text);
inline constexpr std::uint64_t kLeastMemoryBytes = std::uint64_t{64} << 20;

/// "I/N" with 0 <= I < N <= kMostShards. kInvalidInput: anything else.
Result<BuildOptions::Shard> parse_shard(const std::string& text);

}  // namespace tind
