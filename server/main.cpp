// SPDX-License-Identifier: GPL-3.0-or-later
#include <malloc.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <memory>

#include "config/command_line.hpp"
#include "server/catalog.hpp"
#include "server/keeper.hpp"
#include "server/listener.hpp"
#include "server/log.hpp"
#include "server/service_manager.hpp"
#include "storage/doctor/check_command.hpp"

namespace {

constexpr int kFailed = 1;

std::optional<std::string> environment(const std::string& name) {
  const char* value = std::getenv(name.c_str());
  return value ? std::optional<std::string>(value) : std::nullopt;
}

int report(const tind::Error& error) {
  std::fprintf(stderr, "tind: %s\n", error.message.c_str());
  return kFailed;
}

// The settings as they would be at a start now.
tind::Result<tind::Settings> read_settings(const std::vector<std::string>& arguments) {
  auto command = tind::read_command_line(arguments, environment);
  if (auto* settings = std::get_if<tind::Settings>(&command)) return std::move(*settings);
  std::string message = std::get<tind::CommandExit>(command).text;
  while (message.ends_with('\n')) message.pop_back();
  return tind::fail(tind::ErrorKind::kInvalidInput, std::move(message));
}

// Lines go through a queue as long as this lives, which must be longer than the threads that write them.
struct ErrorLog {
  explicit ErrorLog(const tind::Settings& settings) {
    tind::start_log(tind::log_level_of(settings.log_level), tind::log_format_of(settings.log_format));
  }
  ~ErrorLog() { tind::stop_log(); }
  ErrorLog(const ErrorLog&) = delete;
  ErrorLog& operator=(const ErrorLog&) = delete;
};

// What an encoding frees stays for the next one. By default glibc gives it back to the system each time: 35 page faults
// a tile of 8 KB, a tenth of the processor time of encoding it.
void keep_freed_memory() {
  constexpr int kMegabyte = 1 << 20;
  ::mallopt(M_MMAP_THRESHOLD, 8 * kMegabyte);
  ::mallopt(M_TRIM_THRESHOLD, 16 * kMegabyte);
}

int run(const std::vector<std::string>& arguments) {
  const auto command = tind::read_command_line(arguments, environment);
  if (const auto* done = std::get_if<tind::CommandExit>(&command)) {
    std::fputs(done->text.c_str(), done->status == 0 ? stdout : stderr);
    return done->status;
  }
  if (const auto* check = std::get_if<tind::CheckRequest>(&command)) {
    return tind::run_check({check->paths, check->as_json, 0}, stdout, stderr);
  }
  const auto& settings = std::get<tind::Settings>(command);
  keep_freed_memory();
  auto sockets = tind::take_passed_sockets();
  const auto catalog = tind::Catalog::open(settings);
  if (!catalog) return report(catalog.error());
  tind::block_signals();
  std::signal(SIGPIPE, SIG_IGN);  // a client that went away is an error of its write, not of the daemon
  tind::Handler handler(settings);
  const ErrorLog log(settings);
  std::unique_ptr<tind::LineSink> access_log;
  if (!settings.access_log.empty()) {
    auto opened = tind::LineSink::open(settings.access_log);
    if (!opened) return report(opened.error());
    access_log = std::move(*opened);
  }
  const auto on_reload = [&] {
    if (access_log) access_log->reopen();
  };
  tind::Keeper keeper(**catalog, settings, {[&] { return read_settings(arguments); }, on_reload});
  const auto served =
      tind::serve({settings, handler, (*catalog)->holder(), keeper, access_log.get(), std::move(sockets)},
                  [](const std::vector<std::string>& all) {
                    for (const std::string& where : all) std::printf("tind: listening on %s\n", where.c_str());
                    std::fflush(stdout);
                    tind::notify_service_manager("READY=1");
                  });
  return served ? 0 : report(served.error());
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(std::vector<std::string>(argv + 1, argv + argc));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "tind: %s\n", error.what());
    return kFailed;
  }
}
