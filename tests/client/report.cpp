// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/client/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>

namespace tind::client {
namespace {

constexpr std::size_t kKeptOffenders = 5;

std::string metres(const std::optional<double>& value) {
  return value ? fmt::format("{:.3f}", *value) : std::string("-");
}

nlohmann::json number_or_null(const std::optional<double>& value) {
  return value ? nlohmann::json(*value) : nlohmann::json(nullptr);
}

}  // namespace

void Check::looked_at(std::uint64_t n) {
  const std::lock_guard lock(mutex_);
  count_ += n;
}

void Check::fail(const std::string& offender) {
  const std::lock_guard lock(mutex_);
  ++failures_;
  if (offenders_.size() < kKeptOffenders) offenders_.push_back(offender);
}

void Check::skip(std::string why) {
  const std::lock_guard lock(mutex_);
  skipped_ = std::move(why);
}

void Check::note(std::string text) {
  const std::lock_guard lock(mutex_);
  if (notes_.size() < kKeptOffenders) notes_.push_back(std::move(text));
}

std::uint64_t Check::count() const {
  const std::lock_guard lock(mutex_);
  return count_;
}

std::uint64_t Check::failures() const {
  const std::lock_guard lock(mutex_);
  return failures_;
}

std::vector<std::string> Check::offenders() const {
  const std::lock_guard lock(mutex_);
  return offenders_;
}

std::vector<std::string> Check::notes() const {
  const std::lock_guard lock(mutex_);
  return notes_;
}

std::string Check::skipped() const {
  const std::lock_guard lock(mutex_);
  return skipped_;
}

bool Check::held() const {
  const std::lock_guard lock(mutex_);
  return failures_ == 0 && (count_ > 0 || !skipped_.empty());
}

Check& Report::add(const std::string& id, const std::string& promise, const std::string& unit) {
  return checks_.emplace_back(id, promise, unit);
}

Check* Report::find(const std::string& id) {
  for (Check& check : checks_) {
    if (check.id() == id) return &check;
  }
  return nullptr;
}

bool Report::all_held() const {
  return std::all_of(checks_.begin(), checks_.end(), [](const Check& check) { return check.held(); });
}

std::string Report::text() const {
  std::string out;
  const auto line = [&](std::string text) { out += text + "\n"; };
  line(fmt::format("{} ({} tiles stored, {} checked{})", url, tiles_stored, tiles_checked,
                   sample < 1 ? fmt::format(", sample {} of them, seed {}", sample, seed) : std::string()));
  for (const auto& source : sources) line("source: " + source);
  line("");
  line(fmt::format("{:>5} {:>12} {:>7} {:>10} {:>10} {:>10} {:>11} {:>11} {:>11} {:>11} {:>11}", "level", "E_L [m]",
                   "tiles", "vertices", "triangles", "posts", "stored max", "measured", "rmse", "tessellated",
                   ".terrain"));
  for (const auto& l : levels) {
    line(fmt::format("{:>5} {:>12.4f} {:>7} {:>10} {:>10} {:>10} {:>11} {:>11} {:>11} {:>11} {:>11}", l.level,
                     l.tolerance_m, l.tiles, l.vertices, l.triangles, l.posts, metres(l.stored_max_error_m),
                     metres(l.measured_max_error_m), metres(l.measured_rmse_m), metres(l.tessellated_max_error_m),
                     metres(l.terrain_max_error_m)));
  }
  line(
      "  (stored max: as the tiles say; measured, rmse: |TIN - h| here, at the source's posts; tessellated: the same "
      "inside");
  line("   re-triangulated virtual triangles; .terrain: the served mesh, rounded to 0..32767. Metres.)");
  if (cuts.cuts > 0) {
    line("");
    std::string gaps;
    for (std::size_t g = 1; g < cuts.joints_by_gap.size(); ++g) {
      if (cuts.joints_by_gap[g] > 0) gaps += fmt::format(" {}:{}", g, cuts.joints_by_gap[g]);
    }
    line(fmt::format("cuts: {} (seed {}), {} leaves, {} triangles, {} virtual triangles re-triangulated", cuts.cuts,
                     seed, cuts.leaves, cuts.triangles, cuts.tessellated_vts));
    line(fmt::format("      tile sides met by finer tiles, by largest gap:{}", gaps.empty() ? " none" : gaps));
    if (!sources.empty()) {
      line(fmt::format(
          "      largest error in a re-triangulated virtual triangle: {:.3f} m; largest share of E_L: {:.4f}",
          cuts.max_error_m, cuts.max_error_of_tolerance));
    }
  }
  line("");
  std::size_t n_failed = 0, n_skipped = 0;
  for (const Check& check : checks_) {
    const std::string skipped = check.skipped();
    const char* verdict = !check.held() ? "FAIL" : !skipped.empty() ? "skip" : "ok";
    n_failed += check.held() ? 0 : 1;
    n_skipped += check.held() && !skipped.empty() ? 1 : 0;
    line(fmt::format("{:<4} {:<20} {:>12} {:<12} {}", verdict, check.id(), check.count(), check.unit(),
                     check.promise()));
    if (!skipped.empty()) line("       not run: " + skipped);
    if (check.failures() == 0 && !check.held()) line("       nothing was there to look at");
    const auto offenders = check.offenders();
    for (const auto& offender : offenders) line("       - " + offender);
    if (check.failures() > offenders.size()) {
      line(fmt::format("       - ... {} in all", check.failures()));
    }
    for (const auto& note : check.notes()) line("       note: " + note);
  }
  line("");
  line(n_failed == 0 ? fmt::format("all {} checks held{} ({:.1f} s)", checks_.size() - n_skipped,
                                   n_skipped > 0 ? fmt::format(", {} not run", n_skipped) : std::string(), seconds)
                     : fmt::format("{} of {} checks FAILED ({:.1f} s)", n_failed, checks_.size(), seconds));
  return out;
}

nlohmann::json Report::json() const {
  nlohmann::json out;
  out["url"] = url;
  out["dataset"] = dataset;
  out["ok"] = all_held();
  out["sources"] = sources;
  out["seed"] = seed;
  out["sample"] = sample;
  out["tiles_stored"] = tiles_stored;
  out["tiles_checked"] = tiles_checked;
  out["disagreement_m"] = disagreement_m;
  out["seconds"] = seconds;
  out["checks"] = nlohmann::json::array();
  for (const Check& check : checks_) {
    out["checks"].push_back({{"id", check.id()},
                             {"promise", check.promise()},
                             {"held", check.held()},
                             {"count", check.count()},
                             {"unit", check.unit()},
                             {"failures", check.failures()},
                             {"offenders", check.offenders()},
                             {"notes", check.notes()},
                             {"skipped", check.skipped()}});
  }
  out["levels"] = nlohmann::json::array();
  for (const auto& l : levels) {
    out["levels"].push_back({{"level", l.level},
                             {"tolerance_m", l.tolerance_m},
                             {"tiles", l.tiles},
                             {"vertices", l.vertices},
                             {"triangles", l.triangles},
                             {"virtual_triangles", l.vts},
                             {"posts", l.posts},
                             {"stored_max_error_m", number_or_null(l.stored_max_error_m)},
                             {"measured_max_error_m", number_or_null(l.measured_max_error_m)},
                             {"measured_rmse_m", number_or_null(l.measured_rmse_m)},
                             {"tessellated_max_error_m", number_or_null(l.tessellated_max_error_m)},
                             {"terrain_max_error_m", number_or_null(l.terrain_max_error_m)}});
  }
  out["cuts"] = {{"cuts", cuts.cuts},
                 {"leaves", cuts.leaves},
                 {"triangles", cuts.triangles},
                 {"tessellated_virtual_triangles", cuts.tessellated_vts},
                 {"joints", cuts.joints},
                 {"joints_by_gap", cuts.joints_by_gap},
                 {"max_error_m", cuts.max_error_m},
                 {"max_error_of_tolerance", cuts.max_error_of_tolerance}};
  return out;
}

}  // namespace tind::client
