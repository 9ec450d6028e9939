#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Slow requests are cut at their deadline and slow readers by the least rate; others notice nothing, nothing is held.

usage: slow_clients.py PROGRAMS [--slow N] [--requests N] [--deadline S]

Slow writers send a byte now and then and never end their request (slowloris). Slow readers ask for many tiles at once and
take a few bytes a second; meanwhile the dataset is replaced, and must be let go of.
"""
import argparse
import os
import pathlib
import select
import socket
import threading
import time

from world import TILES, Daemon, Programs, Verdict, Watch, folder, right_answers, settle, write_list

LATE_S = 3.0  # after its deadline, on a loaded machine
PIPELINED = 40
ROUNDS = 10


def trickle(port, n, deadline_s):
    """n slow requests. Gives for each the seconds until the daemon answered 408 or closed; None: it never did."""
    poller, began, ends, codes = select.epoll(), {}, {}, {}
    made = {}
    for _ in range(n):
        one = socket.create_connection(("127.0.0.1", port), 20)
        one.setblocking(False)
        one.sendall(b"GET / HTTP/1.1\r\n")
        made[one.fileno()], began[one.fileno()] = one, time.monotonic()
        poller.register(one, select.EPOLLIN)
    stop = time.monotonic() + deadline_s + 4 * LATE_S
    next_byte = time.monotonic()
    while len(ends) < n and time.monotonic() < stop:
        for fd, _ in poller.poll(0.05):
            try:
                data = made[fd].recv(4096)
            except OSError:
                data = b""
            if data and fd not in codes:
                codes[fd] = data[9:12].decode()
            if not data:
                ends[fd] = time.monotonic() - began[fd]
                poller.unregister(fd)
                made[fd].close()
        if time.monotonic() > next_byte:
            next_byte += 0.5
            for fd, one in made.items():
                if fd not in ends:
                    try:
                        one.send(b"X")
                    except OSError:
                        pass
    for fd, one in made.items():
        one.close()
    return [ends.get(fd) for fd in made], [codes.get(fd) for fd in made]


def sip(port, n, stop):
    """n slow readers: each asks for tiles and takes 64 bytes a second. Gives the sockets and, later, when each was cut."""
    request = b"".join(f"GET {TILES[k % len(TILES)]}.terrain HTTP/1.1\r\nHost: h\r\n\r\n".encode() for k in range(PIPELINED))
    readers, cut = [], {}
    for _ in range(n):
        one = socket.socket()
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        one.connect(("127.0.0.1", port))
        one.sendall(request)
        one.setblocking(False)
        readers.append(one)
    began = time.monotonic()

    def loop():
        while not stop.is_set() and len(cut) < n:
            for k, one in enumerate(readers):
                if k in cut:
                    continue
                events = select.poll()  # what it has not taken yet can still be read after it was cut
                events.register(one, select.POLLRDHUP)
                if events.poll(0):
                    cut[k] = time.monotonic() - began
                    continue
                try:
                    one.recv(64)
                except OSError:
                    pass
            stop.wait(1.0)
    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    return readers, cut


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=Programs)
    parser.add_argument("--slow", type=int, default=800)
    parser.add_argument("--readers", type=int, default=100)
    parser.add_argument("--requests", type=int, default=100000, help="of other clients, before and after; meanwhile as many as fit")
    parser.add_argument("--deadline", type=int, default=5, help="request_timeout_s")
    parser.add_argument("--slack", type=float, default=2.0, help="times that other clients' p99 and processor time may grow; a loaded machine needs more")
    options = parser.parse_args()
    verdict = Verdict(f"{options.slow} slow requests, {options.readers} slow readers")
    with folder() as work:
        work = pathlib.Path(work)
        options.programs.make(work / "world.tind", 2000)  # tiles that no socket's buffer takes
        right = right_answers(options.programs, {"a": work / "world.tind"}, [tile + ".terrain" for tile in TILES])
        addresses = write_list(work / "list.txt", right)
        arguments = [work / "world.tind", "--request-timeout-s", str(options.deadline)]
        with Daemon(options.programs.tind, arguments) as daemon:
            others = options.programs, daemon, addresses, 16, options.requests // ROUNDS
            Watch(*others).run(ROUNDS)  # warms it
            without, meanwhile = Watch(*others).run(ROUNDS), Watch(*others)
            files, cuts = daemon.n_open_files(), []
            thread = threading.Thread(target=lambda: cuts.extend(trickle(daemon.port, options.slow, options.deadline)))
            thread.start()
            while thread.is_alive():
                meanwhile.round()
            without.run(ROUNDS)  # before and after, on a machine whose speed changes
            ends, codes = cuts
            in_time = [end for end in ends if end is not None and options.deadline - 0.5 <= end <= options.deadline + LATE_S]
            spread = sorted(end for end in ends if end is not None)
            verdict.require(len(in_time) == options.slow, f"{len(in_time)} of {options.slow} slow requests cut at {options.deadline} s"
                            + (f" ({spread[0]:.1f} to {spread[-1]:.1f} s)" if spread else ""))
            verdict.require(all(code == "408" for code in codes), f"{codes.count('408')} were told 408")
            verdict.require_unnoticed(without, meanwhile, options.slack)

            stop = threading.Event()
            readers, cut = sip(daemon.port, options.readers, stop)
            time.sleep(1)
            old = os.stat(work / "world.tind").st_ino
            options.programs.make(work / "new.tind", 1999)
            os.replace(work / "new.tind", work / "world.tind")
            maps = settle(lambda: len(daemon.mapped(rf" {old} ")), 0, 10)
            verdict.require(maps == 0, "the replaced dataset is let go of while slow readers wait" if maps == 0 else f"{maps} maps of the replaced dataset stay")
            settle(lambda: options.readers - len(cut), 0, 6 * options.deadline + 10)
            stop.set()
            verdict.require(len(cut) == options.readers, f"{len(cut)} of {options.readers} slow readers cut" + (f" within {max(cut.values()):.1f} s" if cut else ""))
            for one in readers:
                one.close()
            files_after = settle(daemon.n_open_files, files)
            verdict.require(files_after <= files, f"open files: {files} before, {files_after} after")
            verdict.require_good_end(daemon)
    verdict.done()


if __name__ == "__main__":
    main()
