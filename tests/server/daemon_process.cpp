// SPDX-License-Identifier: GPL-3.0-or-later
#include "daemon_process.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>

namespace tind::test {

DaemonProcess::DaemonProcess(const std::vector<std::string>& arguments, const std::string& error_file,
                             const std::function<void()>& prepare) {
  static const std::string program = TIND_BIN_DIR "/tind";
  int ends[2];
  if (pipe(ends) != 0) return;
  pid_ = fork();
  if (pid_ == 0) {
    dup2(ends[1], STDOUT_FILENO);
    close(ends[0]);
    close(ends[1]);
    if (!error_file.empty()) dup2(open(error_file.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600), STDERR_FILENO);
    prepare();
    std::vector<char*> argv = {const_cast<char*>(program.c_str())};
    for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    execv(program.c_str(), argv.data());
    _exit(127);
  }
  close(ends[1]);
  char c;
  while (read(ends[0], &c, 1) == 1 && c != '\n') first_line += c;
  out_ = ends[0];
  const auto colon = first_line.rfind(':');
  if (colon != first_line.npos) port = static_cast<std::uint16_t>(std::atoi(first_line.c_str() + colon + 1));
}

DaemonProcess::~DaemonProcess() {
  if (pid_ > 0) stop(SIGKILL);
  close(out_);
}

void DaemonProcess::send(int signal) const { kill(pid_, signal); }

int DaemonProcess::wait() {
  int status = 0;
  waitpid(pid_, &status, 0);
  pid_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

}  // namespace tind::test
