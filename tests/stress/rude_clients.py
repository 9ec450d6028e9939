#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clients that half-close, trickle, stop reading and reset: right answers for those who listen, and nothing leaks.

usage: rude_clients.py PROGRAMS [--rounds N]

A round is a hundred connections of each kind. After each tenth of the rounds descriptors and memory are looked at: they
must come back to where they were, and memory must not go on growing.
"""
import argparse
import pathlib
import random
import socket
import struct

from world import GZIP, TILES, Daemon, Programs, Verdict, fnv1a, folder, right_answers, settle
from wire import Connection, WireError

ROUND = 100
GROWTH_BYTES = 3 << 20


def request(target, fields=""):
    return f"GET {target} HTTP/1.1\r\nHost: h\r\n{GZIP}{fields}\r\n".encode()


def is_right(answer, right):
    return answer.status == 200 and (answer.field("ETag"), len(answer.body), fnv1a(answer.body)) in [one[1:] for one in right]


def half_close(port, rng, right):
    target = rng.choice(list(right))
    with Connection(port) as connection:
        connection.send(request(target))
        connection.end_sending()
        return is_right(connection.receive(), right[target]) and connection.closes()


def byte_by_byte(port, rng, right):
    target = rng.choice(list(right))
    with Connection(port) as connection:
        connection.send(request(target), byte_by_byte=True)
        return is_right(connection.receive(), right[target])


def stops_reading(port, rng, right):
    with Connection(port, receive_buffer_bytes=2048) as connection:
        for _ in range(20):
            connection.send(request(rng.choice(list(right))))
        connection.socket.recv(rng.randint(1, 2000))
    return True


def resets(port, rng, right):
    with Connection(port) as connection:
        connection.send(request(rng.choice(list(right))) * rng.randint(1, 5))
        if rng.random() < 0.5:
            connection.socket.recv(100)
        connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    return True


def leaves_early(port, rng, right):
    data = request(rng.choice(list(right)))
    with Connection(port) as connection:
        connection.send(data[:rng.randrange(len(data))])
    return True


def pipelines(port, rng, right):
    targets = rng.choices(list(right), k=30)
    with Connection(port) as connection:
        connection.send(b"".join(request(target) for target in targets))
        connection.end_sending()
        return all([is_right(connection.receive(), right[target]) for target in targets]) and connection.closes()


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=Programs)
    parser.add_argument("--rounds", type=int, default=20)
    options = parser.parse_args()
    kinds = (half_close, byte_by_byte, stops_reading, resets, leaves_early, pipelines)
    verdict = Verdict(f"{options.rounds * ROUND} rude clients of each of {len(kinds)} kinds")
    rng = random.Random(5)
    with folder() as work:
        work = pathlib.Path(work)
        options.programs.make(work / "world.tind", 200)
        right = right_answers(options.programs, {"a": work / "world.tind"}, [tile + suffix for tile in TILES[:4] for suffix in (".terrain", ".parts")])
        wrong = {kind.__name__: 0 for kind in kinds}
        with Daemon(options.programs.tind, [work / "world.tind"]) as daemon:
            def one_round(n):
                for kind in kinds:
                    for _ in range(n):
                        try:
                            wrong[kind.__name__] += not kind(daemon.port, rng, right)
                        except (WireError, OSError) as error:
                            wrong[kind.__name__] += 1
                            if sum(wrong.values()) < 5:
                                verdict.say(f"{kind.__name__}: {error}")
            one_round(ROUND)  # what is made once is made now
            files, memory = settle(daemon.n_open_files, 0, 3), []
            for k in range(options.rounds):
                one_round(ROUND)
                if options.rounds < 10 or k % (options.rounds // 10) == 0:
                    memory.append(daemon.private_bytes())
            files_after = settle(daemon.n_open_files, files)
            verdict.require(not any(wrong.values()), f"wrong answers: {wrong}")
            verdict.require(files_after <= files, f"open files: {files} before, {files_after} after")
            growth = memory[-1] - memory[len(memory) // 2]
            verdict.require(growth < GROWTH_BYTES, f"memory grew by {growth} bytes in the second half; KB: {[each // 1024 for each in memory]}")
            verdict.require_good_end(daemon)
    verdict.done()


if __name__ == "__main__":
    main()
