#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Idle connections cost little memory, and other clients do not notice them.

usage: idle_connections.py PROGRAMS [--connections N] [--requests N] [--max-bytes N]

Each connection has had one answer and then stays open. Memory is what the daemon wrote to itself (Private_Dirty), so the
dataset's pages do not count.
"""
import argparse
import pathlib
import resource
import socket

from world import TILES, Daemon, Programs, Verdict, Watch, folder, right_answers, settle, write_list


def connect(port):
    made = socket.create_connection(("127.0.0.1", port), 20)
    made.sendall(f"GET {TILES[0]}.terrain HTTP/1.1\r\nHost: h\r\n\r\n".encode())
    made.recv(65536)
    return made


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=Programs)
    parser.add_argument("--connections", type=int, default=10000)
    parser.add_argument("--requests", type=int, default=100000, help="of other clients, before and meanwhile")
    parser.add_argument("--max-bytes", type=int, default=8192, help="of user memory per connection")
    parser.add_argument("--slack", type=float, default=2.0, help="times that other clients' p99 may grow; a loaded machine needs more")
    options = parser.parse_args()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    if hard < options.connections + 200:
        parser.error(f"the hard limit of open files is {hard}")
    verdict = Verdict(f"{options.connections} idle connections")
    with folder() as work:
        work = pathlib.Path(work)
        options.programs.make(work / "world.tind", 60)
        addresses = write_list(work / "list.txt", right_answers(options.programs, {"a": work / "world.tind"}))
        with Daemon(options.programs.tind, [work / "world.tind", "--idle-timeout-s", "3600", "--max-connections", str(options.connections + 100)]) as daemon:
            others = options.programs, daemon, addresses, 64, options.requests
            Watch(*others).run()  # warms it
            before = Watch(*others).run()
            memory, files = daemon.private_bytes(), daemon.n_open_files()
            idle = [connect(daemon.port) for _ in range(options.connections)]
            each = (daemon.private_bytes() - memory) / options.connections
            meanwhile = Watch(*others).run()
            still = sum(1 for made in idle if alive(made))
            for made in idle:
                made.close()
            files_after = settle(daemon.n_open_files, files)
            verdict.require_good_end(daemon)
        verdict.require(each <= options.max_bytes, f"{each:.0f} bytes of user memory each (at most {options.max_bytes})")
        verdict.require(still == options.connections, f"{still} of {options.connections} stayed open")
        verdict.require(before.all_right() and meanwhile.all_right(), f"other clients: {meanwhile.n_answers()} right answers meanwhile")
        verdict.require(meanwhile.p99_us() <= options.slack * before.p99_us(),
                        f"other clients' p99: {before.p99_us():.0f} us before, {meanwhile.p99_us():.0f} us meanwhile; "
                        f"processor time an answer: {before.cpu_us():.1f} and {meanwhile.cpu_us():.1f} us")
        verdict.require(files_after <= files, f"open files: {files} before, {files_after} after")
    verdict.done()


def alive(made):
    """It answers nothing of itself and is not closed."""
    made.setblocking(False)
    try:
        return bool(made.recv(1))
    except BlockingIOError:
        return True
    except OSError:
        return False


if __name__ == "__main__":
    main()
