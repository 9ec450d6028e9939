# SPDX-License-Identifier: GPL-3.0-or-later
"""The daemon and nginx as child processes on free ports, and what /proc says about them."""
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import threading
import time

START_S = 30
CLOCK_TICKS = os.sysconf("SC_CLK_TCK")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Process:
    """A child that is killed, at the latest, when the object goes."""

    def __init__(self, command, pin=None, **options):
        words = [str(word) for word in command]
        if pin is not None:
            words = ["taskset", "-c", str(pin)] + words
        self.process = subprocess.Popen(words, **options)
        self.pid = self.process.pid

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    def stop(self, sent=signal.SIGTERM, patience_s=30):
        self.process.send_signal(sent)
        return self.process.wait(patience_s)

    def pids(self):
        """The process and its children (nginx's workers)."""
        pids = [self.pid]
        for task in pathlib.Path(f"/proc/{self.pid}/task").iterdir():
            pids += [int(word) for word in (task / "children").read_text().split()]
        return pids

    def cpu_s(self):
        """Processor time so far, user and system, children included."""
        total = 0
        for pid in self.pids():
            fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
            total += int(fields[11]) + int(fields[12])
        return total / CLOCK_TICKS

    def n_open_files(self):
        return len(os.listdir(f"/proc/{self.pid}/fd"))

    def private_bytes(self):
        """Memory of its own: anonymous pages and written pages of private maps, not the datasets' pages."""
        text = pathlib.Path(f"/proc/{self.pid}/smaps_rollup").read_text()
        return sum(int(kb) * 1024 for kb in re.findall(r"^Private_Dirty: *([0-9]+) kB", text, re.M))

    def mapped(self, pattern):
        """The lines of /proc/PID/maps that match."""
        text = pathlib.Path(f"/proc/{self.pid}/maps").read_text()
        return [line for line in text.splitlines() if re.search(pattern, line)]


class Daemon(Process):
    """`tind` on a free port; `port` is what it printed, `log` what it wrote to standard error and output since."""

    def __init__(self, program, arguments, pin=None):
        super().__init__([program, *arguments, "--listen", "127.0.0.1:0"], pin, stdout=subprocess.PIPE,
                         stderr=subprocess.STDOUT, text=True, errors="replace")
        self.lines, self.port = [], None
        self.ready = threading.Event()
        threading.Thread(target=self.read_lines, daemon=True).start()
        if not self.ready.wait(START_S) or self.port is None:
            self.__exit__()
            raise RuntimeError(f"{program} did not start: {' / '.join(self.lines)}")

    def read_lines(self):
        for line in self.process.stdout:
            self.lines.append(line.rstrip())
            found = re.search(r"listening on http://[^ /]*:([0-9]+)", line)
            if found and self.port is None:
                self.port = int(found[1])
                self.ready.set()
        self.ready.set()


NGINX_SITE = """
worker_processes 1;
daemon off;
master_process on;
pid {folder}/nginx.pid;
error_log {folder}/error.log crit;
worker_rlimit_nofile 16384;
events {{ worker_connections 8192; multi_accept on; use epoll; }}
http {{
  access_log off;
  sendfile on;
  tcp_nopush on;
  tcp_nodelay on;
  server_tokens off;
  keepalive_timeout 300;
  keepalive_requests 100000000;
  reset_timedout_connection on;
  open_file_cache max=200000 inactive=600s;
  open_file_cache_valid 600s;
  open_file_cache_min_uses 1;
  open_file_cache_errors on;
  log_not_found off;
  default_type application/octet-stream;
  client_body_temp_path {folder}/body;
  proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/fastcgi;
  uwsgi_temp_path {folder}/uwsgi;
  scgi_temp_path {folder}/scgi;
  server {{
    listen 127.0.0.1:{port} backlog=8192 reuseport;
    root {root};
{server}
  }}
}}
"""


class Nginx(Process):
    """nginx with static files below `root`; `server` goes into the server block. `folder` takes its own files."""

    def __init__(self, root, folder, server, pin=None):
        program = find_nginx()
        folder = pathlib.Path(folder).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        self.port = free_port()
        config = folder / "nginx.conf"
        text = NGINX_SITE.format(folder=folder, root=pathlib.Path(root).resolve(), port=self.port, server=server)
        if os.geteuid() == 0:
            text = "user root;\n" + text
        config.write_text(text)
        super().__init__([program, "-p", folder, "-c", config], pin, stderr=subprocess.PIPE, text=True)
        deadline = time.monotonic() + START_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), 1).close()
                return
            except OSError:
                if self.process.poll() is not None or time.monotonic() > deadline:
                    self.__exit__()
                    raise RuntimeError(f"nginx did not start: {self.process.stderr.read()}") from None
                time.sleep(0.05)

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.terminate()  # lets the workers end, too
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                pass
        super().__exit__()


def find_nginx():
    """Debian keeps it in /usr/sbin, which is not on every PATH. None when it is not installed."""
    return shutil.which("nginx") or (shutil.which("/usr/sbin/nginx"))
