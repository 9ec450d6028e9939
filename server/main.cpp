// SPDX-License-Identifier: GPL-3.0-or-later
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>

#include "config/command_line.hpp"
#include "server/listener.hpp"
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
  auto site = tind::make_site(settings);
  if (!site) return report(site.error());
  std::signal(SIGPIPE, SIG_IGN);  // a client that went away is an error of its write, not of the daemon
  const tind::SiteHolder holder(std::make_shared<const tind::Site>(std::move(*site)));
  tind::Handler handler(settings);
  const auto served = tind::serve(settings, handler, holder, [](const std::string& where) {
    std::printf("tind: listening on http://%s\n", where.c_str());
    std::fflush(stdout);
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
