# SPDX-License-Identifier: GPL-3.0-or-later
"""The dataset of the serving benchmark, its tiles as files for nginx, and lists of addresses."""
import concurrent.futures
import json
import pathlib
import random
import shutil
import subprocess
import sys

from programs import Daemon
from wire import Connection

HERE = pathlib.Path(__file__).resolve().parent
# kind -> (suffix, Accept-Encoding)
KINDS = {"terrain": (".terrain", "gzip"), "vn": (".vn", "zstd"), "parts": (".parts", None)}


def make_dataset(programs, work):
    """Real terrain, mirrored six times each way: 6,942 tiles of about 8 KB. Some minutes the first time."""
    made = work / "serve.tind"
    if made.exists():
        return made
    tiles = HERE.parents[3] / "shared/data/raster/sierra-2x2"
    if not tiles.is_dir():
        sys.exit(f"bench_serve: {tiles} is not there; give a dataset of your own: ./dev bench serve NAME.tind")
    raster = work / "sierra_6x6.bil"
    print("bench_serve: building the dataset", file=sys.stderr)
    subprocess.run([sys.executable, HERE.parent / "mirror_hgt.py", tiles, "6", "6", raster], check=True)
    subprocess.run([programs / "tind-build", raster, "-o", made, "-q", "--no-drainage", "--tolerance", "60"], check=True)
    for path in (raster, raster.with_suffix(".hdr"), raster.with_suffix(".prj")):
        path.unlink(missing_ok=True)
    return made


def ask_many(port, targets, fields):
    """All answers, in order, over one connection."""
    answers = []
    with Connection(port) as connection:
        for target in targets:
            connection.send(f"GET {target} HTTP/1.1\r\nHost: h\r\n{fields}\r\n".encode())
            answers.append(connection.receive())
    return answers


def tiles_of(layer):
    return [(level, x, y) for level, rectangles in enumerate(layer["available"]) for r in rectangles
            for y in range(r["startY"], r["endY"] + 1) for x in range(r["startX"], r["endX"] + 1)]


class Export:
    """Per kind a folder of files with the very bytes that the daemon sends, coded as it codes them. `layer`: layer.json;
    `version`: the dataset's; `files[kind]`: path below the folder -> (bytes, the daemon's tag)."""

    def __init__(self, port, name, work):
        self.layer_bytes = ask_many(port, [f"/{name}/layer.json"], "")[0].body
        self.layer = json.loads(self.layer_bytes)
        self.name, self.root = name, work / "serve_files"
        self.query = self.layer["tiles"][0].partition("?")[2]
        tiles = tiles_of(self.layer)
        self.files = {}
        shutil.rmtree(self.root, ignore_errors=True)
        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            for kind, (suffix, coding) in KINDS.items():
                paths = [f"/{name}/{level}/{x}/{y}{suffix}" for level, x, y in tiles]
                fields = f"Accept-Encoding: {coding}\r\n" if coding else ""
                chunks = [paths[k:k + 500] for k in range(0, len(paths), 500)]
                answers = [answer for part in pool.map(lambda chunk: ask_many(port, [f"{path}?{self.query}" for path in chunk], fields), chunks)
                           for answer in part]
                self.files[kind] = {}
                for path, answer in zip(paths, answers):
                    if answer.status != 200 or answer.field("Content-Encoding") not in (coding, None):
                        sys.exit(f"bench_serve: {path}: {answer.status}, Content-Encoding {answer.field('Content-Encoding')}")
                    file = self.root / kind / path[1:]
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.write_bytes(answer.body)
                    self.files[kind][path] = (len(answer.body), answer.field("ETag"))
                (self.root / kind / name / "layer.json").write_bytes(self.layer_bytes)

    def addresses(self, kind, seed=1):
        """All tiles in an order that is the same for everybody, but like no order on the disk."""
        paths = sorted(self.files[kind])
        random.Random(seed).shuffle(paths)
        return [f"{path}?{self.query}" for path in paths]

    def nginx_tag(self, kind, path):
        """nginx's entity tag of a file: time and size in hexadecimal."""
        stat = (self.root / kind / path[1:]).stat()
        return f'"{int(stat.st_mtime):x}-{stat.st_size:x}"'
