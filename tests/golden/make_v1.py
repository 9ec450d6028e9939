#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the golden files of format version 1 beside itself, from docs/format.md alone: none of tind's code is used.

The values are those of tests/storage/golden_test.cpp. Run it only when a new format version gets its own folder."""
import json
import pathlib
import struct

OUT = pathlib.Path(__file__).parent / "v1"


def uvarint(value):
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def svarint(value):
    return uvarint(value * 2 if value >= 0 else -value * 2 - 1)


def chain(values):
    out, before = b"", 0
    for value in values:
        out += svarint(value - before)
        before = value
    return out


def runs_of(vts):
    out = b""
    for triangle, n_edges, border, interval, runs in vts:
        out += uvarint(triangle) + bytes([n_edges | border << 2]) + uvarint(interval)
        out += b"".join(uvarint(r) for r in runs)
    return out


corner = b"C" + svarint(-1234)

# Three inner vertices; the start corner entered at level 1, the end corner at 3.
edge_vertices = [(5, 700, 3), (30000, -2, 1), (65535, 100000, 3)]  # t, z, entry
edge = b"E" + uvarint(3) + bytes([1, 3]) + bytes(e for _, _, e in edge_vertices)
before = 0
for t, _, _ in edge_vertices:
    edge += uvarint(t - before)
    before = t
edge += chain(z for _, z, _ in edge_vertices)

# Tile 3/9/2: one vertex inside the south side, two inside; two finer levels.
SIDE = 65536
n_side = [1, 0, 0, 0]
interior = [(300, 200, -40), (1000, 60000, 800)]  # x, y, z in Morton order
triangles = [(0, 1, 5), (0, 5, 4), (1, 2, 5), (2, 3, 6), (2, 6, 5), (3, 4, 6), (4, 5, 6)]
vts = [(0, 1, 0, 0, [2, 3]), (2, 1, 0, 1, [0, 300]), (3, 1, 1, 0, [0, 0]), (5, 1, 2, 0, [1, 1]),
       (1, 1, 3, 0, [0, 7])]
MAX_ERROR, RMSE, N_POSTS = 24.5, 3.25, 44100
body = b"B" + bytes([1]) + svarint(-1234) + svarint(100000) + uvarint(N_POSTS) + struct.pack("<ff", MAX_ERROR, RMSE)
body += b"".join(uvarint(n) for n in n_side) + uvarint(len(interior)) + uvarint(len(triangles))
body += bytes([2]) + uvarint(len(vts))
for axis in range(3):
    body += chain(v[axis] for v in interior)
body += chain(i for t in triangles for i in t) + runs_of(vts)

ring = [(0, 0, -1234), (30000, 0, -2), (SIDE, 0, 10), (SIDE, SIDE, 20), (0, SIDE, 100000)]
vertices = ring + interior
vn = b"TVN1" + bytes([3, 3, 4, 1]) + struct.pack("<II", 9, 2) + struct.pack("<fff", 32.0, MAX_ERROR, RMSE)
vn += struct.pack("<ii", -1234, 100000) + struct.pack("<4I", *n_side)
vn += struct.pack("<III", len(interior), len(triangles), len(vts))
vn += bytes([2, 0, 0, 0]) + struct.pack("<Q", N_POSTS)
assert len(vn) == 76
vn += bytes([0, 3, 2]) + bytes([2, 1]) + bytes([1, 0]) + bytes([0, 0])
for axis in range(3):
    vn += chain(v[axis] for v in vertices)
vn += chain(i for t in triangles for i in t) + runs_of(vts)

# The body as one zstd frame: single segment, content size in one byte, one raw block (RFC 8878).
assert len(body) < 256
frame = bytes.fromhex("28b52ffd") + bytes([0x20, len(body)]) + ((len(body) << 3) | 1).to_bytes(3, "little") + body

manifest = {
    "format": "tind", "format_version": 1, "generator": "tind-build 0.0", "attribution": "nobody \u00e9",
    "ellipsoid": {"name": "WGS 84", "semi_major_m": 6378137.0, "inverse_flattening": 298.257223563},
    "vertical_datum": "EGM96", "horizontal_crs": "EPSG:4326", "root_count_x": 2, "mode": "non-standard",
    "lattice_level": 3, "height_exponent": 4, "bottom_level": 0, "base_height_m": -2.5, "falloff_posts": 64,
    "disagreement_m": 0.5, "bounds_deg": [-106.0, 37.0, -104.0, 38.0], "spacing_deg": [0.25, 0.125],
    "sources": [{"name": "a.tif", "sha256": "00ff", "n_cols": 9, "n_rows": 7}],
    "posts": {"source": 63, "filled": 2, "falloff": 1000}, "options": {"falloff_posts": 64},
    "content_hash": "0123456789abcdef",
    "levels": [{
        "level": 0, "tolerance_m": 32.5, "spacing_m": 40.25, "height_step_m": 0.5, "n_tiles": 2, "n_real": 0,
        "n_partial": 1, "n_filler": 1, "n_vertices": 11, "n_border_vertices": 7, "n_seed_vertices": 3, "n_triangles": 12,
        "n_posts": 63,
        "max_error_m": 24.5, "rmse_m": 3.25, "bytes": 321, "rows": [[0, 0, 0, 1], [0, 1, 1, 0]]}],
}

OUT.mkdir(exist_ok=True)
(OUT / "corner.bin").write_bytes(corner)
(OUT / "edge.bin").write_bytes(edge)
(OUT / "body.bin").write_bytes(body)
(OUT / "body.zst").write_bytes(frame)
(OUT / "tile.vn").write_bytes(vn)


def write_manifest(name, value):
    (OUT / name).write_text(json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False), "utf-8")


# Of the first builders: without what came with projected sources, points and lines.
write_manifest("manifest_first.json", manifest)
manifest["heights"] = "orthometric"
manifest["vertical_operation"] = "vgridshift grids=egm96_15.gtx"
manifest["source_kind"] = "warped"
manifest["resampling"] = "cubic"
manifest["sources"][0] |= {"n_points": 17, "crs": "WGS 84 / UTM zone 11N (EPSG:32611)",
                              "operation": "proj=utm zone=11"}
manifest["lines"] = {"streams": 5, "shores": 2, "given": 1, "vertices": 321}
write_manifest("manifest.json", manifest)
