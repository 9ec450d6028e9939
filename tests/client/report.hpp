// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

namespace tind::client {

/// One check: what it promises, how much was looked at, what was wrong. Thread safe; workers add their counts and
/// findings.
class Check {
 public:
  Check(std::string id, std::string promise, std::string unit)
      : id_(std::move(id)), promise_(std::move(promise)), unit_(std::move(unit)) {}

  /// Counts `n` more things that were looked at, good or bad.
  void looked_at(std::uint64_t n = 1);
  /// Records one offender in words a person understands. Only the first few texts are kept.
  void fail(const std::string& offender);
  /// Says in the report why the check did not run.
  void skip(std::string why);
  /// Adds a remark that is no failure.
  void note(std::string text);

  const std::string& id() const { return id_; }
  const std::string& promise() const { return promise_; }
  const std::string& unit() const { return unit_; }
  std::uint64_t count() const;
  std::uint64_t failures() const;
  std::vector<std::string> offenders() const;
  std::vector<std::string> notes() const;
  std::string skipped() const;
  /// No failure; a check that looked at nothing and was not skipped has not held either.
  bool held() const;

 private:
  std::string id_, promise_, unit_;
  mutable std::mutex mutex_;
  std::uint64_t count_ = 0, failures_ = 0;
  std::vector<std::string> offenders_, notes_;
  std::string skipped_;
};

/// Figures per level for the summary. Errors in metres; nullopt: not measured.
struct LevelFigures {
  int level = 0;
  double tolerance_m = 0;
  std::uint64_t tiles = 0, vertices = 0, triangles = 0, vts = 0, posts = 0;
  std::optional<double> stored_max_error_m, measured_max_error_m, measured_rmse_m, tessellated_max_error_m,
      terrain_max_error_m;
};

/// What the random cuts met.
struct CutFigures {
  std::uint64_t cuts = 0, leaves = 0, triangles = 0, tessellated_vts = 0, joints = 0;
  std::vector<std::uint64_t> joints_by_gap;  ///< [g]: tile sides of level L met by tiles of level up to L + g.
  double max_error_m = 0;                    ///< Of source posts in tessellated VTs; only with a source.
  double max_error_of_tolerance = 0;         ///< Largest error as a fraction of its E_L.
};

/// Everything a run found.
class Report {
 public:
  /// Adds a check; the reference stays valid. Not thread safe: checks are set up before the work starts.
  Check& add(const std::string& id, const std::string& promise, const std::string& unit);
  Check* find(const std::string& id);
  bool all_held() const;

  std::string url;
  std::string dataset;
  std::vector<std::string> sources;
  std::uint64_t seed = 0;
  double sample = 1;
  std::uint64_t tiles_stored = 0, tiles_checked = 0;
  double disagreement_m = 0;  ///< As the manifest claims it.
  double seconds = 0;
  std::vector<LevelFigures> levels;
  CutFigures cuts;

  /// The summary for people.
  std::string text() const;
  nlohmann::json json() const;

 private:
  std::deque<Check> checks_;
};

}  // namespace tind::client
