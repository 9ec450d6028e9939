#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Idle connections cost little memory, and other clients do not notice them.

usage: idle_connections.py PROGRAMS [--connections N] [--requests N] [--max-bytes N] [--slack R]

Each connection has had one answer and then stays open. Memory is what the daemon wrote to itself (Private_Dirty), so the
dataset's pages do not count. Other clients are measured in rounds with and without the idle connections in turn, since the
machine's speed changes; the ratio of the medians decides.
"""
import argparse
import pathlib
import resource
import socket
import struct

from world import TILES, Daemon, Programs, Verdict, Watch, folder, right_answers, settle, write_list

ROUNDS = 8  # with and without, each; even


def connect(port):
    made = socket.create_connection(("127.0.0.1", port), 20)
    made.sendall(f"GET {TILES[0]}.terrain HTTP/1.1\r\nHost: h\r\n\r\n".encode())
    made.recv(65536)
    return made


def reset(made):
    """Closes without leaving a port in TIME-WAIT: tens of thousands of connections come from one address."""
    made.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    made.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=Programs)
    parser.add_argument("--connections", type=int, default=10000)
    parser.add_argument("--requests", type=int, default=100000, help="of other clients, with and without")
    parser.add_argument("--max-bytes", type=int, default=8192, help="of user memory per connection")
    parser.add_argument("--slack", type=float, default=1.5, help="times that other clients' p99 and processor time may grow")
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
            others = options.programs, daemon, addresses, 64, options.requests // ROUNDS
            Watch(*others).run(ROUNDS)  # warms it
            without, meanwhile = Watch(*others), Watch(*others)
            memory, files = daemon.private_bytes(), daemon.n_open_files()
            each, still = [], []
            # Two rounds without, two with, and so on: whatever changes slowly meets both alike.
            without.round()
            for _ in range(ROUNDS // 2):
                idle = [connect(daemon.port) for _ in range(options.connections)]
                each.append((daemon.private_bytes() - memory) / options.connections)
                meanwhile.run(2)
                still.append(sum(1 for made in idle if alive(made)))
                for made in idle:
                    reset(made)
                files_after = settle(daemon.n_open_files, files)
                without.run(2)
            verdict.require_good_end(daemon)
        verdict.require(max(each) <= options.max_bytes, f"{each[0]:.0f} bytes of user memory each, most {max(each):.0f} (at most {options.max_bytes})")
        verdict.require(min(still) == options.connections, f"{min(still)} of {options.connections} stayed open")
        verdict.require_unnoticed(without, meanwhile, options.slack)
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
