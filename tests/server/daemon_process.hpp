// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace tind::test {

/// The program `tind` as a child process, killed with the object if it still runs.
class DaemonProcess {
 public:
  /// Starts it and waits for its first line. `prepare` runs in the child before the program; standard error goes to
  /// `error_file` when one is given.
  explicit DaemonProcess(
      const std::vector<std::string>& arguments, const std::string& error_file = {},
      const std::function<void()>& prepare = [] {});
  ~DaemonProcess();
  DaemonProcess(const DaemonProcess&) = delete;
  DaemonProcess& operator=(const DaemonProcess&) = delete;

  void send(int signal) const;
  /// Waits for the end: the exit status, or minus the signal that ended it.
  int wait();
  int stop(int signal) {
    send(signal);
    return wait();
  }
  pid_t pid() const { return pid_; }

  std::string first_line;
  std::uint16_t port = 0;  ///< Of the first line.

 private:
  pid_t pid_ = -1;
  int out_ = -1;
};

}  // namespace tind::test
