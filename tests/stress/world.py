# SPDX-License-Identifier: GPL-3.0-or-later
"""What the stress tests share: pyramids, right answers, other clients, and the verdict."""
import json
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "kit"))

from programs import Daemon  # noqa: E402
from wire import ask  # noqa: E402

TILES = [f"/world/{level}/{x}/{y}" for level, nx, ny in ((0, 2, 1), (1, 4, 2)) for y in range(ny) for x in range(nx)]
TARGETS = [tile + suffix for tile in TILES for suffix in (".terrain", ".vn", ".parts")] + \
    ["/world/body/1/1/1", "/world/body/1/2/0", "/world/edge/1/h/1/1", "/world/edge/1/v/2/1", "/world/corner/1/1/1", "/world/codes/1/1/1"]
GZIP = "Accept-Encoding: gzip\r\n"


class Programs:
    """The folder of tind, make_world, stress_load and tind-build."""

    def __init__(self, folder):
        self.tind, self.make_world, self.load = (pathlib.Path(folder) / name for name in ("tind", "make_world", "stress_load"))

    def make(self, path, n_side):
        subprocess.run([self.make_world, path, str(n_side)], check=True)


def fnv1a(data):
    value = 0xcbf29ce484222325
    for byte in data:
        value = (value ^ byte) * 0x100000001b3 & 0xffffffffffffffff
    return value


def right_answers(programs, versions, targets=TARGETS):
    """What each version's own daemon answers: target -> [(version, tag, length, hash)]. `versions`: name -> file."""
    right = {target: [] for target in targets}
    for name, path in versions.items():
        with Daemon(programs.tind, [path]) as daemon:
            for target in targets:
                answer = ask(daemon.port, target, GZIP)
                if answer.status != 200:
                    raise RuntimeError(f"{target}: {answer.status}")
                right[target].append((name, answer.field("ETag"), len(answer.body), fnv1a(answer.body)))
    return right


def write_list(path, right):
    lines = ["\t".join([target] + [f"{version}:{tag}:{length}:{value:x}" for version, tag, length, value in answers]) for target, answers in right.items()]
    path.write_text("\n".join(lines) + "\n")
    return path


class Others:
    """Clients who only want tiles: stress_load in the background, or to its end."""

    def __init__(self, programs, port, addresses, connections, requests, progress=0):
        self.process = subprocess.Popen([programs.load, str(port), addresses, str(connections), str(requests), str(progress)], stdout=subprocess.PIPE, text=True)

    def figures(self, on_progress=None):
        last = None
        for line in self.process.stdout:
            if line.startswith("at "):
                if on_progress:
                    on_progress(int(line[3:]))
            else:
                last = json.loads(line)
        if self.process.wait() != 0 or last is None:
            raise RuntimeError("stress_load failed")
        return last


class Watch:
    """Runs other clients in rounds of `requests`; the median of the rounds' p99 is what they notice."""

    def __init__(self, programs, daemon, addresses, connections, requests):
        self.daemon = daemon
        self.arguments = programs, daemon.port, addresses, connections, max(1, requests)
        self.rounds, self.spent_s = [], 0.0

    def round(self):
        before = self.daemon.cpu_s()
        self.rounds.append(Others(*self.arguments).figures())
        self.spent_s += self.daemon.cpu_s() - before

    def run(self, n_rounds):
        for _ in range(n_rounds):
            self.round()
        return self

    def p99_us(self):
        return statistics.median(one["p99_us"] for one in self.rounds)

    def cpu_us(self):
        """The daemon's processor time per answer: it tells more than a p99 where other work keeps the machine busy."""
        return self.spent_s / self.n_answers() * 1e6

    def n_answers(self):
        return sum(one["answers"] for one in self.rounds)

    def all_right(self):
        return all(one["wrong"] == one["mixed"] == one["broken"] == 0 for one in self.rounds)


class Verdict:
    """Collects what was found; `done` prints it and ends the program."""

    def __init__(self, title):
        self.title, self.failed = title, []
        print(f"== {title}", flush=True)

    def say(self, text):
        print(text, flush=True)

    def require(self, holds, text):
        print(("ok: " if holds else "FAILED: ") + text, flush=True)
        if not holds:
            self.failed.append(text)

    def require_unnoticed(self, without, meanwhile, slack):
        """Other clients' rounds with and without the attack: right answers, and medians that differ by `slack` at most."""
        self.require(without.all_right() and meanwhile.all_right(), f"other clients: {meanwhile.n_answers()} right answers meanwhile")
        for what, look in (("p99", Watch.p99_us), ("processor time an answer", Watch.cpu_us)):
            ratio = look(meanwhile) / look(without)
            self.require(ratio <= slack, f"other clients' {what}: {look(without):.1f} us without, {look(meanwhile):.1f} us meanwhile, "
                         f"ratio {ratio:.2f} (at most {slack:g}; {len(without.rounds)} and {len(meanwhile.rounds)} rounds)")

    def require_good_end(self, daemon):
        """SIGTERM ends the daemon with status 0; a sanitizer that found something says otherwise."""
        status = daemon.stop() if daemon.process.poll() is None else daemon.process.returncode
        self.require(status == 0, f"the daemon ends with status {status}" + ("" if status == 0 else ": " + " / ".join(daemon.lines[-20:])))

    def done(self):
        sys.exit(1 if self.failed else 0)


def settle(look, wanted, patience_s=15.0):
    """Waits until look() <= wanted; gives the last value."""
    deadline = time.monotonic() + patience_s
    while (value := look()) > wanted and time.monotonic() < deadline:
        time.sleep(0.1)
    return value


def folder():
    return tempfile.TemporaryDirectory(prefix="tind-stress-")
