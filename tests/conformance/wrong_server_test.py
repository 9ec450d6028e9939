#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The conformance list against servers that are wrong on purpose: each must fail the cases that it is wrong about."""
import collections
import pathlib
import socket
import sys
import threading

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent / "kit"), str(HERE)]

import cases_framing  # noqa: E402
import cases_semantics  # noqa: E402
import run_conformance  # noqa: E402

run_conformance.PATIENCE_S = 1
BODY = b"x" * 1000
HEAD = b"HTTP/1.1 200 OK\r\nETag: \"tag\"\r\nContent-Length: 1000\r\n\r\n"
Wrong = collections.namedtuple("Wrong", "what answer fails")


def first_answer(data):
    """One good answer, whatever is asked, and then nothing."""
    return HEAD + BODY


WRONG = [
    Wrong("takes everything", first_answer, {"no Host", "two Hosts", "major version 2", "CL: 5, 6", "NUL in a field", "If-None-Match", "POST", "If-Match, another tag",
                                             "Date is now", "fields of 100 KB", "problem details of 404", "pipelining keeps the order"}),
    Wrong("refuses everything", lambda data: b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n",
          {"GET", "HEAD has no body", "absolute-form", "byte by byte", "connections stay open", "chunked body", "half-close after the request", "OPTIONS *", "empty Host"}),
    Wrong("breaks lines with LF", lambda data: HEAD.replace(b"\r\n", b"\n") + BODY, {"GET", "no Host", "Content-Type", "a range"}),
    Wrong("sends half a body", lambda data: HEAD + BODY[:500], {"GET", "a range", "no Accept-Encoding"}),
    Wrong("sends bodies after HEAD and 304", lambda data: (HEAD if b"If-None-Match" not in data else HEAD.replace(b"200 OK", b"304 Not Modified")) + BODY,
          {"HEAD has no body", "HEAD and 304 in a pipeline", "HEAD has GET's fields"}),
    Wrong("answers what was smuggled", lambda data: (HEAD + BODY) * data.count(b"HTTP/1.1\r\n"), {"CL and TE", "TE: xchunked", "CL: +5", "nothing is answered after close"}),
]


def serve(listener, answer):
    while True:
        try:
            connection, _ = listener.accept()
        except OSError:
            return
        with connection:
            connection.settimeout(0.05)
            data = b""
            try:
                while chunk := connection.recv(65536):
                    data += chunk
            except OSError:
                pass
            try:
                connection.sendall(answer(data))
            except OSError:
                pass


def main():
    failures = 0
    cases = {case.name: case for case in cases_framing.CASES + cases_semantics.CASES}
    for wrong in WRONG:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            threading.Thread(target=serve, args=(listener, wrong.answer), daemon=True).start()
            plain = run_conformance.parse_head(HEAD[:-4])
            plain.body = BODY
            world = run_conformance.World(listener.getsockname()[1], plain, '"tag"', 1e9, 1e9, {run_conformance.TILE: BODY, run_conformance.OTHER: BODY[::-1]})
            for name in sorted(wrong.fails):
                if run_conformance.judge(cases[name], world, cases[name].tind or cases[name].answers) is None:
                    print(f"FAILED: a server that {wrong.what} passes \"{name}\"")
                    failures += 1
            listener.shutdown(socket.SHUT_RDWR)
    print(f"{sum(len(wrong.fails) for wrong in WRONG)} wrong answers, {failures} not found")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
