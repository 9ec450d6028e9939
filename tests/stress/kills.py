#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""kill -9 of the daemon, and of a builder that writes beside it, at random moments: the store stays whole.

usage: kills.py PROGRAMS DEM [--kills N] [--seed N]

The daemon is killed while it answers; the file's bytes must not have changed, and the next daemon must answer rightly. Then
tind-build replaces and updates the dataset that a daemon is serving and is killed while it does; after each kill
the daemon answers as before, and the store on disk is whole (tind --check).
"""
import argparse
import hashlib
import json
import pathlib
import random
import signal
import subprocess
import time

from world import Daemon, Others, Programs, Verdict, ask, folder, right_answers, write_list


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def check(programs, path):
    """What the doctor says: None when the store is whole."""
    done = subprocess.run([programs.tind, "--check", path], capture_output=True, text=True)
    return None if done.returncode == 0 else done.stdout + done.stderr


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("programs", type=Programs)
    parser.add_argument("dem", type=pathlib.Path)
    parser.add_argument("--kills", type=int, default=160, help="of each kind")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    verdict = Verdict(f"{options.kills} kills of the daemon, {options.kills} of a builder")
    rng = random.Random(options.seed)
    builder = options.programs.tind.with_name("tind-build")
    with folder() as work:
        work = pathlib.Path(work)
        world = work / "world.tind"
        build = [builder, options.dem, "-o", world, "-q", "--force", "--no-drainage", "--threads", "1"]
        began = time.monotonic()
        subprocess.run(build, check=True)
        took_s = time.monotonic() - began
        first = digest(world)
        with Daemon(options.programs.tind, [world]) as daemon:
            layer = ask(daemon.port, "/world/layer.json").body
        targets = [f"/world/{level}/{rectangles[0]['startX']}/{rectangles[0]['startY']}{suffix}" for level, rectangles in enumerate(json.loads(layer)["available"])
                   if rectangles for suffix in (".terrain", ".parts")]
        right = right_answers(options.programs, {"a": world}, targets)
        addresses = write_list(work / "list.txt", right)

        changed = wrong = 0
        for _ in range(options.kills):
            with Daemon(options.programs.tind, [world]) as daemon:
                others = Others(options.programs, daemon.port, addresses, 8, 10**9)
                time.sleep(rng.uniform(0, 0.1))
                daemon.stop(signal.SIGKILL)
                wrong += others.figures()["wrong"]
            changed += digest(world) != first
        verdict.require(changed == 0, f"the file changed {changed} times")
        verdict.require(wrong == 0, f"{wrong} wrong answers before the kills")
        verdict.require(check(options.programs, world) is None, f"the store is whole after {options.kills} kills of the daemon")

        broken, killed, tries, disturbed = [], 0, 0, 0
        with Daemon(options.programs.tind, [world]) as daemon:
            while killed < options.kills and tries < 5 * options.kills:
                tries += 1
                command = build if tries % 3 else build + ["--tolerance", str(rng.randint(20, 60))]
                process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
                time.sleep(rng.uniform(0, took_s))
                process.kill()
                if process.wait() == -signal.SIGKILL:
                    killed += 1
                else:
                    took_s *= 0.9  # the machine is faster than it was: this one had ended
                said = check(options.programs, world)
                if said:
                    broken.append(said)
                disturbed += any(ask(daemon.port, target).status != 200 for target in targets[:2])
            disturbed += daemon.process.poll() is not None
        verdict.require(killed == options.kills, f"{killed} of {tries} builders were killed before they ended")
        verdict.require(not broken, f"{len(broken)} stores broken" + "".join(broken[:3]))
        verdict.require(disturbed == 0, f"the daemon failed {disturbed} times")
        subprocess.run(build, check=True)
        verdict.require(digest(world) == first, "the build in the end gives the bytes of the first")
    verdict.done()


if __name__ == "__main__":
    main()
