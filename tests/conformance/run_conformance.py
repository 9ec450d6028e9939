#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs the HTTP conformance list against the daemon, and beside it against nginx with the same resources as files.

usage: run_conformance.py TIND MAKE_WORLD [--only WORD] [--require-nginx]

TIND is the daemon, MAKE_WORLD the program that writes its pyramid. Prints a line per case and both scores; exits with 1
when the daemon fails one. nginx's failures change nothing; where nginx is not installed, that is printed.
"""
import argparse
import collections
import email.utils
import pathlib
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "kit"))

import cases_framing  # noqa: E402
import cases_semantics  # noqa: E402
from case import OTHER, TILE  # noqa: E402
from programs import Daemon, Nginx, find_nginx  # noqa: E402
from wire import Connection, WireError, ask, parse_head  # noqa: E402

LATE_S = 2       # what a request's head may take
PATIENCE_S = 6
NGINX_SERVER = f"""
    client_header_timeout {LATE_S}s;
    client_body_timeout {LATE_S}s;
    types {{ application/vnd.quantized-mesh terrain; text/html html; }}
    gzip_static on;
    gzip_vary on;
    etag on;
    add_header Cache-Control "public, max-age=60";
"""
World = collections.namedtuple("World", "port plain etag modified date identity")


def look_at(port):
    """What the cases need to know of a server's resources."""
    plain = ask(port, TILE)
    seconds = [email.utils.parsedate_to_datetime(value).timestamp() if value else None
               for value in (plain.field("Last-Modified"), plain.field("Date"))]
    if plain.status != 200 or not plain.field("ETag"):
        raise WireError(f"{TILE}: status {plain.status}, ETag {plain.field('ETag')}")
    return World(port, plain, plain.field("ETag"), seconds[0] or 0, seconds[1], {target: ask(port, target).body for target in (TILE, OTHER)})


def export(port, folder):
    """The daemon's resources as files, for nginx."""
    for target in (TILE, OTHER, "/"):
        path = folder / ((target[1:] or "index.html"))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(ask(port, target).body)
        coded = ask(port, target, "Accept-Encoding: gzip\r\n")
        if coded.field("Content-Encoding") == "gzip":
            path.with_name(path.name + ".gz").write_bytes(coded.body)


def complaint(case, world, wanted):
    """None, or what is wrong with the server's answers."""
    data = case.send(world) if callable(case.send) else case.send
    with Connection(world.port, patience_s=PATIENCE_S) as connection:
        connection.send(data, case.byte_by_byte)
        if case.half_close:
            connection.end_sending()
        answers = []
        for k, allowed in enumerate(wanted):
            method = case.methods[k] if k < len(case.methods) else "GET"
            answers.append(connection.receive(method))
            if answers[-1].status not in allowed:
                return f"answer {k + 1} is {answers[-1].status}, not {' or '.join(str(status) for status in sorted(allowed))}"
        if not wanted:
            try:
                last = connection.receive()
                if not 400 <= last.status < 500:
                    return f"answered {last.status}"
            except WireError as error:
                if "closed without" not in str(error):
                    raise
        wrong = case.check(answers, world) if case.check else None
        if wrong:
            return wrong
        if case.closes is True and not connection.closes():
            return "the connection stays open, or more comes"
        if case.closes is False:
            connection.send(f"HEAD {TILE} HTTP/1.1\r\nHost: h\r\nConnection: close\r\n\r\n".encode())
            if connection.receive("HEAD").status != 200:
                return "the connection does not go on"
    return None


def judge(case, world, wanted):
    try:
        return complaint(case, world, wanted)
    except (WireError, OSError, ValueError) as error:
        return str(error)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("tind", type=pathlib.Path)
    parser.add_argument("make_world", type=pathlib.Path)
    parser.add_argument("--only", help="cases whose name contains this word")
    parser.add_argument("--require-nginx", action="store_true")
    options = parser.parse_args()
    cases = [case for case in cases_framing.CASES + cases_semantics.CASES if (options.only or "") in case.name]
    names = [case.name for case in cases]
    if len(set(names)) != len(names):
        sys.exit(f"two cases have one name: {[name for name, n in collections.Counter(names).items() if n > 1]}")
    failures, scores = [], collections.Counter()
    with tempfile.TemporaryDirectory(prefix="tind-conformance-") as folder:
        folder = pathlib.Path(folder)
        folder.chmod(0o755)  # nginx's workers are another user
        subprocess.run([options.make_world, folder / "world.tind"], check=True)
        with Daemon(options.tind, [folder / "world.tind", "--request-timeout-s", str(LATE_S)]) as daemon:
            world, nginx, nginx_world = look_at(daemon.port), None, None
            if find_nginx():
                export(daemon.port, folder / "files")
                nginx = Nginx(folder / "files", folder / "nginx", NGINX_SERVER)
                nginx_world = look_at(nginx.port)
            elif options.require_nginx:
                sys.exit("nginx is not installed")
            for case in cases:
                wrong = judge(case, world, case.answers if case.tind is None else case.tind)
                scores["tind", wrong is None] += 1
                if wrong:
                    failures.append((case, wrong))
                text = "FAILED" if wrong else "ok    "
                beside = "      "
                if nginx and case.nginx:
                    theirs = judge(case, nginx_world, case.answers)
                    scores["nginx", theirs is None] += 1
                    beside = "ok    " if theirs is None else "failed"
                print(f"{text} nginx {beside} {case.rfc:18} {case.name}" + (f": {wrong}" if wrong else ""), flush=True)
            status = daemon.stop() if daemon.process.poll() is None else daemon.process.returncode
            if status != 0:
                failures.append((None, f"ended with status {status}: " + " / ".join(daemon.lines[-20:])))
            if nginx:
                nginx.__exit__()
    passed, all_cases = scores["tind", True], len(cases)
    print(f"tind: {passed} of {all_cases}")
    if nginx_world:
        n = scores["nginx", True] + scores["nginx", False]
        print(f"nginx: {scores['nginx', True]} of the {n} that make sense for files")
    else:
        print("nginx: not installed, so not compared")
    for case, wrong in failures:
        print(f"FAILED: {case.rfc + ' ' + case.name if case else 'tind'}: {wrong}")
    sys.exit(1 if failures or not cases else 0)


if __name__ == "__main__":
    main()
