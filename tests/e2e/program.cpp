// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/e2e/program.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <iterator>
#include <sstream>

namespace tind::test {
namespace {

constexpr int kStartTimeoutMs = 20'000;

/// Starts the program with its outputs on the given descriptors; -1: not started.
pid_t start(const std::string& name, const std::vector<std::string>& arguments, int out, int err,
            const std::function<void()>& prepare) {
  const std::string path = std::string(TIND_BIN_DIR) + "/" + name;
  std::vector<char*> argv = {const_cast<char*>(path.c_str())};
  for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const pid_t pid = fork();
  if (pid != 0) return pid;
  if (out >= 0) dup2(out, STDOUT_FILENO);
  if (err >= 0) dup2(err, STDERR_FILENO);
  prepare();
  execv(path.c_str(), argv.data());
  _exit(127);
}

int wait_for(pid_t pid) {
  int status = 0;
  if (waitpid(pid, &status, 0) != pid) return -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace

Finished run_program(const std::string& name, const std::vector<std::string>& arguments,
                     const std::function<void()>& prepare) {
  const ScratchFolder folder;
  const std::string out_path = folder.file("out"), err_path = folder.file("err");
  const int out = open(out_path.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0600);
  const int err = open(err_path.c_str(), O_CREAT | O_WRONLY | O_CLOEXEC, 0600);
  Finished finished;
  const pid_t pid = start(name, arguments, out, err, prepare);
  if (pid > 0) finished.status = wait_for(pid);
  close(out);
  close(err);
  finished.out = read_file(out_path);
  finished.err = read_file(err_path);
  return finished;
}

Daemon::Daemon(const std::vector<std::string>& tind_files) {
  std::array<int, 2> ends{};
  if (pipe2(ends.data(), O_CLOEXEC) != 0) return;
  std::vector<std::string> arguments = tind_files;
  arguments.insert(arguments.end(), {"--listen", "127.0.0.1:0"});
  pid_ = start("tind", arguments, ends[1], -1, [] {});
  close(ends[1]);
  out_ = ends[0];
  // The first line names the port.
  std::string line;
  pollfd waiting{out_, POLLIN, 0};
  while (line.find('\n') == std::string::npos && poll(&waiting, 1, kStartTimeoutMs) == 1) {
    std::array<char, 256> buffer{};
    const ssize_t n = read(out_, buffer.data(), buffer.size());
    if (n <= 0) return;
    line.append(buffer.data(), static_cast<std::size_t>(n));
  }
  const auto at = line.find("http://");
  if (at == std::string::npos) return;
  url_ = line.substr(at, line.find_first_of(" \r\n", at) - at);
  while (!url_.empty() && url_.back() == '/') url_.pop_back();
}

int Daemon::stop() {
  if (pid_ <= 0) return -1;
  kill(pid_, SIGTERM);
  const int status = wait_for(pid_);
  pid_ = -1;
  return status;
}

Daemon::~Daemon() {
  stop();
  if (out_ >= 0) close(out_);
}

ScratchFolder::ScratchFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "tind-e2e-XXXXXX").string();
  if (mkdtemp(name.data()) == nullptr) std::abort();
  path_ = name;
}

ScratchFolder::~ScratchFolder() {
  std::error_code ignored;
  std::filesystem::permissions(path_, std::filesystem::perms::owner_all, ignored);
  std::filesystem::remove_all(path_, ignored);
}

std::string read_file(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

void write_file(const std::string& path, const std::string& text) {
  std::ofstream out(path, std::ios::binary | std::ios::trunc);
  out << text;
}

std::size_t count_lines(const std::string& text) {
  std::istringstream in(text);
  std::size_t n = 0;
  for (std::string line; std::getline(in, line);) n += line.empty() ? 0 : 1;
  return n;
}

}  // namespace tind::test
