#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Building a whole pyramid against the reference, one plain greedy mesh of the same posts to the same tolerance.

usage: bench_build.py PROGRAMS [INPUT] [--tolerance M] [--runs N] [--work FOLDER] [--json FILE] [--cases NAME,...]

PROGRAMS is the folder of tind-build and bench_greedy_baseline. Without INPUT the 4801 x 4801 posts of the issue are made
from ../shared/data/raster/sierra-2x2, mirrored twice each way. All cases run once, then all again, and so on, so that a
machine that slows down slows all of them; medians count. A case of one core is held to one, with all that its process
does beside the work (reading ahead, writing), as a machine of one core would; a case of two cores is held to two. Processor seconds are user and system time (getrusage), the
reference's without reading the raster; memory is the largest resident set, mapped files included.
"""
import argparse
import filecmp
import json
import os
import pathlib
import platform
import statistics
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
REFERENCE = "(a) one greedy mesh, plain CGAL"
TUNED = "(a') the same, own predicates"


def run(command, n_cores):
    """Runs to the end on so many cores. Gives what it printed, and its processor seconds, wall seconds and peak memory in bytes."""
    start = time.monotonic()
    cores = sorted(os.sched_getaffinity(0))[:n_cores]
    process = subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE,
                               preexec_fn=lambda: os.sched_setaffinity(0, cores))
    printed = process.stdout.read()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        sys.exit(f"bench_build: {' '.join(str(word) for word in command)} ended with status {process.returncode}")
    return printed, {"cpu_s": usage.ru_utime + usage.ru_stime, "wall_s": time.monotonic() - start,
                     "peak_bytes": usage.ru_maxrss * 1024}


def make_input(work):
    made = work / "sierra_mirrored.bil"
    if not made.exists():
        tiles = HERE.parents[2] / "shared/data/raster/sierra-2x2"
        if not tiles.is_dir():
            sys.exit(f"bench_build: {tiles} is not there; give a raster of your own: ./dev bench build INPUT")
        subprocess.run([sys.executable, HERE / "mirror_hgt.py", tiles, "2", "2", made], check=True)
    return made


def processor():
    for line in open("/proc/cpuinfo", encoding="utf-8"):
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor()


def make_cases(programs, raster, tolerance, work):
    """Name -> (command, cores, file it writes or None)."""
    reference = programs / "bench_greedy_baseline"
    cases = {REFERENCE: ([reference, raster, tolerance], 1, None),
             TUNED: ([reference, "--own-predicates", raster, tolerance], 1, None)}
    for drainage in (False, True):
        for n_cores in (1, 2):
            name = f"pyramid, {'with' if drainage else 'no'} drainage, {n_cores} core{'s' if n_cores > 1 else ''}"
            out = work / f"bench_{'drainage' if drainage else 'plain'}_{n_cores}.tind"
            command = [programs / "tind-build", raster, "-o", out, "--force", "-q", "--tolerance", tolerance,
                       "--threads", n_cores] + ([] if drainage else ["--no-drainage"])
            cases[name] = (command, n_cores, out)
    return cases


def measure(cases, n_runs):
    runs = {name: [] for name in cases}
    for turn in range(n_runs):
        for name, (command, n_cores, out) in cases.items():
            printed, figures = run(command, n_cores)
            if name in (REFERENCE, TUNED):
                figures.update(json.loads(printed))
                figures["process_cpu_s"] = figures["cpu_s"]
                figures["cpu_s"] = figures["meshing_cpu_s"]
            if out:
                figures["file_bytes"] = out.stat().st_size
            runs[name].append(figures)
            print(f"run {turn + 1}: {name}: {figures['cpu_s']:.2f} s of processor, {figures['wall_s']:.2f} s, "
                  f"{figures['peak_bytes'] / 2**20:.0f} MB", file=sys.stderr)
    return runs


def check_same_bytes(cases):
    for kind in ("no", "with"):
        files = [out for name, (_, _, out) in cases.items() if f", {kind} drainage" in name]
        if len(files) == 2 and not filecmp.cmp(*files, shallow=False):
            sys.exit(f"bench_build: {files[0]} and {files[1]} differ: the bytes depend on the number of threads")


def summary(runs):
    """Medians, and ratios to the reference and to one core."""
    medians = {name: {key: statistics.median(figures[key] for figures in all_runs) for key in all_runs[0]}
               for name, all_runs in runs.items()}
    for name, figures in medians.items():
        cpu = [one["cpu_s"] for one in runs[name]]
        figures["cpu_s_least"], figures["cpu_s_most"] = min(cpu), max(cpu)
        for key, reference in (("cpu_to_reference", REFERENCE), ("cpu_to_tuned", TUNED)):
            if reference in medians:
                figures[key] = figures["cpu_s"] / medians[reference]["cpu_s"]
        one_core = name.replace("2 cores", "1 core")
        if one_core != name and one_core in medians:
            figures["speedup"] = medians[one_core]["wall_s"] / figures["wall_s"]
    return medians


def print_table(medians):
    print(f"| {'':36} | CPU s (least..most) |   to (a) | to (a') | wall s | speed-up | peak MB | file MB |")
    print(f"|{'-' * 38}|{'-' * 21}|{'-' * 10}|{'-' * 9}|{'-' * 8}|{'-' * 10}|{'-' * 9}|{'-' * 9}|")
    for name, m in medians.items():
        def show(key, form, scale=1.0):
            return format(m[key] / scale, form) if key in m else ""
        spread = f"{m['cpu_s']:.1f} ({m['cpu_s_least']:.1f}..{m['cpu_s_most']:.1f})"
        print(f"| {name:36} | {spread:>19} | {show('cpu_to_reference', '.2f'):>8} | {show('cpu_to_tuned', '.2f'):>7} | {m['wall_s']:6.1f} | "
              f"{show('speedup', '.2f'):>8} | {m['peak_bytes'] / 2**20:7.0f} | {show('file_bytes', '.1f', 2**20):>7} |")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("input", type=pathlib.Path, nargs="?")
    parser.add_argument("--tolerance", default="10", help="E_bottom and the reference's tolerance, metres (default: 10)")
    parser.add_argument("--runs", type=int, default=3, help="of each case (default: 3)")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("build/bench"))
    parser.add_argument("--json", type=pathlib.Path, help="default: build.json in the work folder")
    parser.add_argument("--cases", help="only the cases whose name contains one of these words, separated by commas")
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    raster = options.input or make_input(options.work)
    cases = make_cases(options.programs, raster, options.tolerance, options.work)
    if options.cases:
        cases = {name: case for name, case in cases.items() if any(word in name for word in options.cases.split(","))}
    if not cases or options.runs < 1:
        parser.error("nothing to run")
    runs = measure(cases, options.runs)
    check_same_bytes(cases)
    medians = summary(runs)
    print_table(medians)
    report = {"processor": processor(), "cores": os.cpu_count(), "input": raster.name,
              "tolerance_m": float(options.tolerance), "runs": runs, "medians": medians}
    path = options.json or options.work / "build.json"
    path.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    print(f"written: {path}", file=sys.stderr)


if __name__ == "__main__":
    main()
