#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The daemon against nginx with the same bytes as files: processor time per request, throughput and latency.

usage: bench_serve.py PROGRAMS [DATASET] [--pairs N] [--seconds S] [--connections N,N] [--cases WORD,...] [--work FOLDER] [--json FILE]

PROGRAMS is the folder of tind and tind-build. Server and client (wrk, one thread) each have a core of their own. Each case is
measured in pairs, nginx and tind in turn and the first of a pair changing, so that a machine that slows down slows both;
every ratio is nginx/tind of one pair (above 1: the daemon is better; for requests/s tind/nginx), and the median over the
pairs counts. Processor time is user and system time of the server's processes from /proc. Before anything is measured every
address is asked of both and the bodies are compared.
"""
import argparse
import ctypes
import json
import os
import pathlib
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parents[1] / "kit"), str(HERE)]

from programs import Daemon, Nginx, find_nginx  # noqa: E402
from serve_export import KINDS, Export, ask_many, make_dataset  # noqa: E402
from trace import make_trace  # noqa: E402

SERVER_CORE, CLIENT_CORE = 0, 1
PIPELINE = 8
MOST_PIPELINED = 64  # connections; more fill the sockets' buffers and measure those
SAMPLE = 500
TRACE_USERS, TRACE_S, TRACE_SEED = 60, 600, 1
WARM_MOST_S = 60
TRACE_MOST_S = 600  # for one replay, on however busy a machine
# What a site with such files would add to every answer; per kind a server of its own, so that nginx looks up no location.
NGINX_SERVER = """
    types {{}}
    default_type {type};
    etag on;
    {coding}
    add_header Vary "{vary}";
    add_header Cache-Control "public, max-age=31536000, immutable";
    add_header Access-Control-Allow-Origin "*";
"""
NGINX_OF = {
    "terrain": {"type": "application/vnd.quantized-mesh", "coding": "add_header Content-Encoding gzip;", "vary": "Accept, Accept-Encoding"},
    "vn": {"type": "application/vnd.tind.vn", "coding": "add_header Content-Encoding zstd;", "vary": "Accept-Encoding"},
    "parts": {"type": "application/vnd.tind.parts", "coding": "", "vary": "Accept-Encoding"},
}


class Case:
    def __init__(self, name, kind, status=200, pipeline=1):
        self.name, self.kind, self.status, self.pipeline = name, kind, status, pipeline


CASES = [Case("quantized-mesh, gzip", "terrain"), Case(".vn, zstd", "vn"), Case(".parts", "parts"), Case("304", "terrain", 304), Case("404", "terrain", 404),
         Case(f"quantized-mesh, pipelining {PIPELINE}", "terrain", 200, PIPELINE)]


def wrk(port, addresses, connections, seconds, pipeline, coding, limit=0):
    command = ["taskset", "-c", str(CLIENT_CORE), "wrk", "-t1", f"-c{connections}", f"-d{seconds}s", "--timeout", "10s", "-s", HERE / "requests.lua",
               f"http://127.0.0.1:{port}", "--", addresses, str(pipeline), str(limit)] + ([f"Accept-Encoding: {coding}"] if coding else [])
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return json.loads(printed.splitlines()[-1])


def run(server, case, addresses, connections, seconds, limit=0):
    """One measurement. Stops the program where answers are not what they should be."""
    before = server.cpu_s()
    got = wrk(server.port, addresses, connections, seconds, case.pipeline, KINDS[case.kind][1], limit)
    if not got["requests"]:
        sys.exit(f"bench_serve: {case.name}: no answer in {seconds} s")
    got["cpu_us"] = (server.cpu_s() - before) / got["requests"] * 1e6
    got["rate"] = got["requests"] / got["duration_s"]
    wrong = abs(got["requests"] - got["status_errors"]) if case.status == 404 else got["status_errors"]
    if got["failed"] or wrong:
        sys.exit(f"bench_serve: {case.name}: {got['failed']} requests failed, {wrong} with a wrong status")
    return got


def check_same(export, daemon, nginx, kind):
    """Every address, from both: status and body."""
    fields = f"Accept-Encoding: {KINDS[kind][1]}\r\n" if KINDS[kind][1] else ""
    addresses = export.addresses(kind)
    for k in range(0, len(addresses), SAMPLE):
        ours, theirs = (ask_many(server.port, addresses[k:k + SAMPLE], fields) for server in (daemon, nginx))
        for address, a, b in zip(addresses[k:], ours, theirs):
            if (a.status, a.body, a.field("Content-Type")) != (200, b.body, b.field("Content-Type")) or b.status != 200:
                sys.exit(f"bench_serve: {address} is not the same from both")


def level_of(address):
    return int(address.split("/")[2])


def lists_of(case, export, daemon, folder):
    """The files with the addresses to ask of nginx and of tind."""
    addresses = export.addresses(case.kind)
    if case.status == 404:
        # The same addresses with another row: no tile, no file.
        addresses = [re.sub(r"/([0-9]+)\.", lambda row: f"/{int(row[1]) ^ 1 << level_of(address)}.", address) for address in addresses]
        known = set(export.files[case.kind])
        addresses = [a for a in addresses if a.split("?")[0] not in known]
    both = []
    for server in ("nginx", "tind"):
        lines = addresses
        if case.status == 304:
            tag = (lambda path: export.nginx_tag(case.kind, path)) if server == "nginx" else (lambda path: export.files[case.kind][path][1])
            lines = [f"{address}\t{tag(address.split('?')[0])}" for address in addresses]
        path = folder / f"{server}.txt"
        path.write_text("\n".join(lines) + "\n")
        both.append(path)
    return both


FIGURES = {"cpu_us": 1, "rate": -1, "p50_us": 1, "p99_us": 1, "p999_us": 1}


def ratios(pairs):
    """Medians over the pairs of each figure's ratio, above 1 where the daemon is better; and both medians. wrk gives no
    percentile (0) of so few answers that there is none; a ratio with it is left out."""
    out = {}
    for figure, sign in FIGURES.items():
        each = [(n[figure] / t[figure]) ** sign for n, t in pairs if n[figure] and t[figure]] or [float("nan")]
        out[figure] = {"ratio": statistics.median(each), "least": min(each), "most": max(each), "nginx": statistics.median(n[figure] for n, _ in pairs),
                       "tind": statistics.median(t[figure] for _, t in pairs)}
    return out


def show(name, connections, figures):
    cells = [f"{figures['cpu_us']['nginx']:.1f} / {figures['cpu_us']['tind']:.1f}", f"**{figures['cpu_us']['ratio']:.2f}** ({figures['cpu_us']['least']:.2f}..{figures['cpu_us']['most']:.2f})",
             f"{figures['rate']['nginx'] / 1000:.1f} / {figures['rate']['tind'] / 1000:.1f}"] + [f"{figures[key]['ratio']:.2f}" for key in ("rate", "p50_us", "p99_us", "p999_us")]
    print(f"| {name} | {connections} | {' | '.join(cells)} |", flush=True)


def measure(case, export, daemon, nginx, connections, options, folder):
    lists = lists_of(case, export, daemon, folder)
    pairs = []
    for server, addresses in zip((nginx, daemon), lists):
        run(server, case, addresses, connections, WARM_MOST_S, len(addresses.read_text().splitlines()))  # once through, to warm caches on both sides
    for k in range(options.pairs):
        order = [(nginx, lists[0]), (daemon, lists[1])]
        got = [run(server, case, addresses, connections, options.seconds) for server, addresses in (order if k % 2 == 0 else order[::-1])]
        pairs.append(tuple(got if k % 2 == 0 else got[::-1]))
    return pairs


def forget(*roots):
    """Drops the pages of files from the kernel's cache."""
    libc = ctypes.CDLL(None, use_errno=True)
    dont_need = 4
    for root in roots:
        for path in ([root] if root.is_file() else root.rglob("*")):
            if path.is_file():
                with open(path, "rb") as file:
                    os.fsync(file.fileno())
                    libc.posix_fadvise(file.fileno(), ctypes.c_long(0), ctypes.c_long(0), dont_need)


def replay(export, dataset, options, start_daemon, start_nginx, folder):
    """The trace, as fast as it goes: cold (new processes, nothing of the files in memory) and, after that, warm."""
    trace = make_trace(export.layer, export.name, TRACE_USERS, TRACE_S, TRACE_SEED)
    addresses = folder / "trace.txt"
    addresses.write_text("".join(f"{path}\n" for _, _, path in trace if not path.endswith("layer.json")))
    n = sum(1 for _, _, path in trace if not path.endswith("layer.json"))
    case, pairs = Case("trace", "terrain"), {"cold": [], "warm": []}
    for k in range(options.pairs):
        got = {}
        for start in ((start_nginx, start_daemon) if k % 2 == 0 else (start_daemon, start_nginx)):
            forget(dataset, export.root / "terrain")
            with start() as server:
                got[start] = [run(server, case, addresses, 64, TRACE_MOST_S, n) for _ in range(2)]
        for state, heat in enumerate(("cold", "warm")):
            pairs[heat].append((got[start_nginx][state], got[start_daemon][state]))
    for heat in pairs:
        show(f"trace, {heat} ({n} requests, {len(set(path for _, _, path in trace))} addresses)", 64, ratios(pairs[heat]))
    return {f"trace, {heat}": {"64": {"pairs": pairs[heat], "ratios": ratios(pairs[heat])}} for heat in pairs}


def machine():
    names = [line.split(":", 1)[1].strip() for line in open("/proc/cpuinfo", encoding="utf-8") if line.startswith("model name")]

    def version(command):
        done = subprocess.run(command, capture_output=True, text=True)
        return (done.stdout + done.stderr).splitlines()[0]
    return {"processor": names[0] if names else platform.processor(), "cores": os.cpu_count(), "kernel": platform.release(), "load": os.getloadavg()[0],
            "nginx": version([find_nginx(), "-v"]), "wrk": version(["wrk", "-v"])}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("dataset", type=pathlib.Path, nargs="?")
    parser.add_argument("--pairs", type=int, default=5, help="of measurements per case (default: 5)")
    parser.add_argument("--seconds", type=int, default=3, help="of each measurement (default: 3)")
    parser.add_argument("--connections", default="64,1024")
    parser.add_argument("--cases", help="only the cases whose name contains one of these words, separated by commas")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("build/bench"))
    parser.add_argument("--json", type=pathlib.Path, help="default: serve.json in the work folder")
    options = parser.parse_args()
    if not find_nginx() or not shutil.which("wrk"):
        sys.exit("bench_serve: needs nginx and wrk (Debian: nginx-light, wrk)")
    if (os.cpu_count() or 1) < 2:
        sys.exit("bench_serve: needs two cores")
    words = options.cases.split(",") if options.cases else [""]
    options.work.mkdir(parents=True, exist_ok=True)
    dataset = options.dataset or make_dataset(options.programs, options.work)

    def start_daemon():
        return Daemon(options.programs / "tind", [dataset, "--threads", "1"], SERVER_CORE)

    with tempfile.TemporaryDirectory(prefix="tind-bench-") as folder, start_daemon() as daemon:
        folder = pathlib.Path(folder)
        export = Export(daemon.port, dataset.stem, options.work)
        report = {"machine": machine(), "tiles": len(export.files["terrain"]), "pairs": options.pairs, "seconds": options.seconds,
                  "median_bytes": {kind: statistics.median(size for size, _ in export.files[kind].values()) for kind in KINDS}, "cases": {}}
        print(f"{dataset.name}: {report['tiles']} tiles, median bytes {report['median_bytes']}; {report['machine']}", file=sys.stderr)
        print("| case | connections | CPU us a request, nginx / tind | ratio (least..most) | 1000 requests/s, nginx / tind | requests/s | p50 | p99 | p99.9 |\n"
              "|---|---|---|---|---|---|---|---|---|", flush=True)

        def start_nginx(kind="terrain"):
            return Nginx(export.root / kind, options.work / "serve_nginx", NGINX_SERVER.format(**NGINX_OF[kind]), SERVER_CORE)
        for kind in KINDS:
            cases = [case for case in CASES if case.kind == kind and any(word in case.name for word in words)]
            if not cases:
                continue
            with start_nginx(kind) as nginx:
                check_same(export, daemon, nginx, kind)
                for case in cases:
                    for connections in (int(word) for word in options.connections.split(",")):
                        if case.pipeline > 1 and connections > MOST_PIPELINED:
                            continue
                        pairs = measure(case, export, daemon, nginx, connections, options, folder)
                        report["cases"].setdefault(case.name, {})[connections] = {"pairs": pairs, "ratios": ratios(pairs)}
                        show(case.name, connections, ratios(pairs))
        if any(word in "trace" for word in words):
            report["cases"].update(replay(export, dataset, options, start_daemon, start_nginx, folder))
        if not report["cases"]:
            parser.error("no such case")
    path = options.json or options.work / "serve.json"
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(f"written: {path}", file=sys.stderr)


if __name__ == "__main__":
    main()
