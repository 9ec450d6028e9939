// SPDX-License-Identifier: GPL-3.0-or-later
#include "storage/doctor/check_command.hpp"

#include <fmt/format.h>
#include <unistd.h>

#include <chrono>
#include <nlohmann/json.hpp>

namespace tind {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t kMostPrinted = 20;  // of faults, in text; JSON has all that are kept
constexpr double kMegabyte = 1e6;

// One line that renews itself on a terminal, one every half minute elsewhere.
class ProgressLine {
 public:
  ProgressLine(std::FILE* stream, std::string path)
      : stream_(stream), path_(std::move(path)), is_terminal_(stream && ::isatty(::fileno(stream))) {}
  ~ProgressLine() {
    if (is_open_) std::fputs("\r\033[K", stream_);
  }

  void update(double share) {
    if (!stream_) return;
    const auto now = Clock::now();
    const std::chrono::duration<double> since_start = now - start_, since_print = now - printed_;
    if (since_print.count() < (is_terminal_ ? 0.2 : 30)) return;
    printed_ = now;
    const double left_s = share > 0 ? since_start.count() * (1 - share) / share : 0;
    fmt::print(stream_, "{}{}: {:.0f} %, {:.0f} s left{}", is_terminal_ ? "\r" : "", path_, 100 * share, left_s,
               is_terminal_ ? "\033[K" : "\n");
    std::fflush(stream_);
    is_open_ = is_terminal_;
  }

 private:
  std::FILE* stream_;
  std::string path_;
  bool is_terminal_ = false, is_open_ = false;
  Clock::time_point start_ = Clock::now(), printed_ = start_;
};

void print_text(std::FILE* out, const std::string& path, const CheckReport& report) {
  const std::string read =
      report.n_levels == 0
          ? fmt::format("{:.1f} MB", static_cast<double>(report.file_bytes) / kMegabyte)
          : fmt::format("{} tiles on levels 0..{}, {} pieces, {} triangles, {:.1f} MB, content hash {}", report.n_tiles,
                        report.n_levels - 1, report.n_pieces, report.n_triangles,
                        static_cast<double>(report.file_bytes) / kMegabyte, report.content_hash);
  if (report.is_sound()) {
    fmt::print(out, "{}: sound: {}, in {:.1f} s\n", path, read, report.seconds);
    return;
  }
  fmt::print(out, "{}: damaged: {} fault{}; {}, in {:.1f} s\n", path, report.n_faults, report.n_faults == 1 ? "" : "s",
             read, report.seconds);
  for (std::size_t k = 0; k < report.faults.size() && k < kMostPrinted; ++k) {
    fmt::print(out, "  {}: {}\n", report.faults[k].where, report.faults[k].what);
  }
  if (report.n_faults > kMostPrinted)
    fmt::print(out, "  and {} more (--json has them)\n", report.n_faults - kMostPrinted);
}

nlohmann::json to_json(const std::string& path, const CheckReport& report) {
  nlohmann::json faults = nlohmann::json::array();
  for (const Fault& f : report.faults) faults.push_back({{"where", f.where}, {"what", f.what}});
  return {{"file", path},
          {"sound", report.is_sound()},
          {"n_faults", report.n_faults},
          {"faults", std::move(faults)},
          {"file_bytes", report.file_bytes},
          {"n_levels", report.n_levels},
          {"n_tiles", report.n_tiles},
          {"n_pieces", report.n_pieces},
          {"n_triangles", report.n_triangles},
          {"content_hash", report.content_hash},
          {"seconds", report.seconds}};
}

}  // namespace

int run_check(const CheckCommand& command, std::FILE* out, std::FILE* progress) {
  int status = 0;
  nlohmann::json files = nlohmann::json::array();
  for (const std::string& path : command.paths) {
    CheckOptions options;
    options.threads = command.threads;
    Result<CheckReport> report = [&] {
      ProgressLine line(progress, path);
      options.progress = [&](double share) { line.update(share); };
      return check_file(path, options);
    }();
    if (!report || !report->is_sound()) status = 1;
    if (command.as_json) {
      files.push_back(report ? to_json(path, *report)
                             : nlohmann::json{{"file", path}, {"sound", false}, {"error", report.error().message}});
    } else if (report) {
      print_text(out, path, *report);
    } else {
      fmt::print(out, "{}\n", report.error().message);
    }
    std::fflush(out);
  }
  if (command.as_json) {
    fmt::print(out, "{}\n", files.dump(2, ' ', false, nlohmann::json::error_handler_t::replace));
  }
  return status;
}

}  // namespace tind
