#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A realistic list of requests: users whose cameras fly over a dataset's globe.

usage: trace.py LAYER.json NAME [--users N] [--seconds S] [--seed N]

Reads the dataset's layer.json and writes one line per request: milliseconds, user, path; sorted by time. Same arguments,
same bytes.

A user goes to places (some far more popular than others), and pans, zooms in and out, looks around, and jumps to the next
one. Four times a second the tiles for the view are chosen as CesiumJS chooses them: from the root tiles down, a tile is
refined while its level's geometric error (77,067 m at level 0, halved per level) covers more than two pixels at its
distance; children are asked for when their parent is there, coarse and near ones first, at most six at once per user,
each taking a latency. A tile that exists nowhere finer is not refined. What a user has had is in the browser's cache, as
tiles may be kept for ever: it is not asked for again while among the last N_CACHED.
"""
import argparse
import collections
import heapq
import json
import math
import random
import sys

RADIUS_M = 6378137.0
LEVEL_0_ERROR_M = RADIUS_M * 2 * math.pi * 0.25 / (65 * 2)  # CesiumJS: estimated for 65 x 65 posts, two root tiles
MAX_ERROR_PX = 2.0
HEIGHT_PX = 1080
HALF_VIEW = math.radians(30)
ASPECT = 16 / 9
STEP_MS = 250
AT_ONCE = 6
N_CACHED = 4000
N_PLACES = 40
LOWEST_M, HIGHEST_M = 300.0, 1.2e7


class Tiles:
    """Which tiles exist, and where."""

    def __init__(self, layer):
        self.available = [[(r["startX"], r["startY"], r["endX"], r["endY"]) for r in level] for level in layer["available"]]
        self.bounds_deg = layer["bounds"]
        self.known = {}

    def exists(self, tile):
        if tile not in self.known:
            level, x, y = tile
            self.known[tile] = level < len(self.available) and any(
                x0 <= x <= x1 and y0 <= y <= y1 for x0, y0, x1, y1 in self.available[level])
        return self.known[tile]

    def children(self, tile):
        level, x, y = tile
        return [child for child in ((level + 1, 2 * x + i, 2 * y + j) for j in (0, 1) for i in (0, 1)) if self.exists(child)]


def ground_distance_m(tile, lon, lat):
    """From a point to the nearest point of a tile, on a sphere."""
    level, x, y = tile
    side = 180 / 2**level
    west, south = -180 + x * side, -90 + y * side
    middle = west + side / 2
    apart = (lon - middle + 180) % 360 - 180  # the short way round
    d_lon = max(0.0, abs(apart) - side / 2)
    near_lat = min(max(lat, south), south + side)
    a, b, d = math.radians(lat), math.radians(near_lat), math.radians(d_lon)
    h = math.sin((a - b) / 2)**2 + math.cos(a) * math.cos(b) * math.sin(d / 2)**2
    return 2 * RADIUS_M * math.asin(min(1.0, math.sqrt(h)))


def choose(tiles, have, lon, lat, height_m):
    """The tiles that the view lacks, most wanted first."""
    horizon_m = RADIUS_M * math.acos(RADIUS_M / (RADIUS_M + height_m))
    reach_m = min(horizon_m, height_m * math.tan(HALF_VIEW) * ASPECT * 1.6)
    missing, stack = [], [(0, 0, 0), (0, 1, 0)]
    while stack:
        tile = stack.pop()
        away_m = ground_distance_m(tile, lon, lat)
        if away_m > reach_m and tile[0] > 0:
            continue
        distance_m = math.hypot(away_m, height_m)
        if tile not in have:
            missing.append((tile[0], distance_m, tile))
            continue
        error_px = LEVEL_0_ERROR_M / 2**tile[0] * HEIGHT_PX / (distance_m * 2 * math.tan(HALF_VIEW))
        if error_px > MAX_ERROR_PX:
            stack.extend(tiles.children(tile))
    return [tile for _, _, tile in sorted(missing)]


class Camera:
    """Where a user looks from: flights between places, and what people do there."""

    def __init__(self, rng, places, weights):
        self.rng, self.places, self.weights = rng, places, weights
        self.lon, self.lat = rng.choices(places, weights)[0]
        self.height_m = HIGHEST_M
        self.plan = collections.deque()

    def step(self):
        if not self.plan:
            self.plan.extend(self.next_act())
        self.lon, self.lat, self.height_m = self.plan.popleft()

    def flight(self, lon, lat, height_m, n_steps, rise=1.0):
        """Even steps in place and in the logarithm of height; `rise` times higher half-way."""
        start = self.lon, self.lat, math.log(self.height_m)
        top = math.log(rise)
        for k in range(1, n_steps + 1):
            t = k / n_steps
            t = t * t * (3 - 2 * t)
            height = math.exp(start[2] + (math.log(height_m) - start[2]) * t + top * math.sin(math.pi * t))
            yield start[0] + (lon - start[0]) * t, start[1] + (lat - start[1]) * t, min(max(height, LOWEST_M), HIGHEST_M)

    def next_act(self):
        act = self.rng.choices(("rest", "pan", "zoom in", "zoom out", "fly", "jump"), (20, 35, 22, 8, 10, 5))[0]
        if act == "rest":
            return [(self.lon, self.lat, self.height_m)] * self.rng.randint(4, 30)
        if act == "zoom in":
            return self.flight(self.lon, self.lat, max(LOWEST_M, self.height_m / self.rng.uniform(2, 12)), self.rng.randint(4, 16))
        if act == "zoom out":
            return self.flight(self.lon, self.lat, min(HIGHEST_M, self.height_m * self.rng.uniform(2, 8)), self.rng.randint(4, 12))
        if act == "pan":
            screen_deg = math.degrees(2 * self.height_m * math.tan(HALF_VIEW) / RADIUS_M)
            angle, length = self.rng.uniform(0, 2 * math.pi), screen_deg * self.rng.uniform(0.2, 1.5)
            lat = min(max(self.lat + length * math.sin(angle), -85), 85)
            return self.flight(self.lon + length * math.cos(angle) / math.cos(math.radians(lat)), lat, self.height_m, self.rng.randint(4, 24))
        lon, lat = self.rng.choices(self.places, self.weights)[0]
        height_m = math.exp(self.rng.uniform(math.log(800), math.log(60000)))
        if act == "jump":
            return [(lon, lat, height_m)]
        return self.flight(lon, lat, height_m, self.rng.randint(12, 32), self.rng.uniform(1, 20))


def fly(tiles, rng, places, weights, seconds, start_ms):
    """One user: (milliseconds, tile) in order of time; tile None is layer.json."""
    camera, have, on_the_way, out = Camera(rng, places, weights), collections.OrderedDict(), [], [(start_ms, None)]
    for now in range(start_ms + STEP_MS, seconds * 1000, STEP_MS):
        camera.step()
        while on_the_way and on_the_way[0][0] <= now:
            have[heapq.heappop(on_the_way)[1]] = True
        while len(have) > N_CACHED:
            have.popitem(last=False)
        asked = {tile for _, tile in on_the_way}
        for tile in choose(tiles, have, camera.lon, camera.lat, camera.height_m):
            if len(on_the_way) >= AT_ONCE * 4:  # about four rounds of six fit into a step
                break
            if tile not in asked:
                at = now + rng.randrange(STEP_MS)
                out.append((at, tile))
                heapq.heappush(on_the_way, (at + rng.randint(20, 200), tile))
    return out


def make_trace(layer, name, n_users, seconds, seed):
    """Lists of (milliseconds, user, path), sorted."""
    tiles = Tiles(layer)
    rng = random.Random(seed)
    west, south, east, north = tiles.bounds_deg
    places = [(rng.uniform(west, east), rng.uniform(south, north)) for _ in range(N_PLACES)]
    weights = [1 / (k + 1) for k in range(N_PLACES)]  # Zipf
    template, version = layer["tiles"][0], layer.get("version", "")
    out = []
    for user in range(n_users):
        own = random.Random(seed * 1000003 + user)
        for at, tile in fly(tiles, own, places, weights, seconds, own.randrange(seconds * 250)):
            if tile is None:
                out.append((at, user, f"/{name}/layer.json"))
            else:
                level, x, y = (str(number) for number in tile)
                path = template.replace("{z}", level).replace("{x}", x).replace("{y}", y).replace("{version}", version)
                out.append((at, user, f"/{name}/{path}"))
    return sorted(out)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("layer", type=argparse.FileType("r", encoding="utf-8"))
    parser.add_argument("name")
    parser.add_argument("--users", type=int, default=40)
    parser.add_argument("--seconds", type=int, default=300)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for at, user, path in make_trace(json.load(options.layer), options.name, options.users, options.seconds, options.seed):
        sys.stdout.write(f"{at}\t{user}\t{path}\n")


if __name__ == "__main__":
    main()
