#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A dataset is replaced again and again under load: every answer is wholly of one version, none fails, old maps go.

usage: swaps.py PROGRAMS [--requests N] [--swaps N]

Two pyramids of one area differ in every tile. One is renamed over the other, in the first half of the swaps as a file, in
the second half as a symbolic link. Every answer's tag, length and hash are compared with what a daemon of that version alone
answers.
"""
import argparse
import os
import pathlib
import re
import shutil
import threading
import time

from world import GZIP, TARGETS, Daemon, Others, Programs, Verdict, ask, folder, right_answers, settle, write_list

CONNECTIONS = 64
CHUNK = 50000
PROGRESS = 500
NOTICED_S = 15


class Swapper(threading.Thread):
    """Replaces the dataset, waits until the daemon answers with the new one, and so on; a swap each `spacing` answers."""

    def __init__(self, work, port, tags, n_swaps, spacing, as_link):
        super().__init__(daemon=True)
        self.work, self.port, self.tags, self.n_swaps, self.spacing, self.as_link = work, port, tags, n_swaps, spacing, as_link
        self.n_answers = 0  # that the other clients have had
        self.done, self.unnoticed, self.longest_s = 0, 0, 0.0

    def run(self):
        names = sorted(self.tags)
        for k in range(self.n_swaps):
            while self.n_answers < k * self.spacing:
                time.sleep(0.002)
            version = names[(k + 1) % 2]
            fresh = self.work / "fresh.tind"
            if self.as_link:
                fresh.symlink_to(self.work / f"{version}.tind")
            else:
                shutil.copyfile(self.work / f"{version}.tind", fresh)
            os.replace(fresh, self.work / "world.tind")
            began = time.monotonic()
            while ask(self.port, TARGETS[0], GZIP).field("ETag") != self.tags[version]:
                if time.monotonic() - began > NOTICED_S:
                    self.unnoticed += 1
                    break
                time.sleep(0.005)
            self.longest_s = max(self.longest_s, time.monotonic() - began)
            self.done += 1


def maps_of(daemon):
    """How many different store files are mapped."""
    return len({re.split(r" +", line)[4] for line in daemon.mapped(r"\.tind( \(deleted\))?$")})


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=Programs)
    parser.add_argument("--requests", type=int, default=1000000)
    parser.add_argument("--swaps", type=int, default=100)
    options = parser.parse_args()
    verdict = Verdict(f"{options.requests} requests, {options.swaps} swaps")
    totals, n_swaps, most_maps = {"answers": 0, "wrong": 0, "mixed": 0, "broken": 0}, 0, 0
    of_version = {}
    with folder() as work:
        work = pathlib.Path(work)
        for version, n_side in (("a", 60), ("b", 61)):
            options.programs.make(work / f"{version}.tind", n_side)
        # Under the name that it will have: an address's answer may tell it.
        (work / "own").mkdir()
        versions = {}
        for version in ("a", "b"):
            (work / "own" / version).mkdir()
            versions[version] = work / "own" / version / "world.tind"
            shutil.copyfile(work / f"{version}.tind", versions[version])
        right = right_answers(options.programs, versions)
        verdict.require(all(a[1] != b[1] and a[3] != b[3] for t, (a, b) in right.items() if "corner" not in t), "the versions differ everywhere")
        addresses = write_list(work / "list.txt", right)
        tags = {answers[0]: answers[1] for answers in right[TARGETS[0]]}
        for as_link in (False, True):
            (work / "world.tind").unlink(missing_ok=True)
            if as_link:
                (work / "world.tind").symlink_to(work / "a.tind")
            else:
                shutil.copyfile(work / "a.tind", work / "world.tind")
            with Daemon(options.programs.tind, [work / "world.tind"]) as daemon:
                swapper = Swapper(work, daemon.port, tags, options.swaps // 2, options.requests // options.swaps, as_link)
                swapper.start()
                answers = 0
                while answers < options.requests // 2 or swapper.is_alive():
                    got = Others(options.programs, daemon.port, addresses, CONNECTIONS, min(CHUNK, options.requests // 2), PROGRESS).figures(
                        lambda n, before=answers: setattr(swapper, "n_answers", before + n))
                    answers += got["answers"]
                    swapper.n_answers = answers
                    for key in totals:
                        totals[key] += got[key]
                    for version, n in got["versions"].items():
                        of_version[version] = of_version.get(version, 0) + n
                    most_maps = max(most_maps, maps_of(daemon))
                    if got["broken"]:
                        break
                swapper.join(2 * NOTICED_S)
                n_swaps += swapper.done - swapper.unnoticed
                verdict.say(f"{'links' if as_link else 'files'}: {swapper.done} swaps, seen within {swapper.longest_s:.2f} s, {answers} answers")
                left = settle(lambda: maps_of(daemon), 1)
                verdict.require(left == 1, f"{left} file is mapped in the end (at most {most_maps} meanwhile)")
                verdict.require_good_end(daemon)
    verdict.require(totals["answers"] >= options.requests, f"{totals['answers']} answers")
    verdict.require(n_swaps == options.swaps // 2 * 2, f"{n_swaps} swaps that the daemon followed under load")
    verdict.require(totals["broken"] == 0, f"{totals['broken']} failed")
    verdict.require(totals["wrong"] == 0 and totals["mixed"] == 0, f"{totals['wrong']} wrong, {totals['mixed']} of mixed versions")
    verdict.require(len(of_version) == 2, f"answers of each version: {of_version}")
    verdict.done()


if __name__ == "__main__":
    main()
