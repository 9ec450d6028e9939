#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a large test raster out of a block of .hgt tiles: mirrors it NX times east and NY times north, so that real
terrain goes on without a step.

usage: mirror_hgt.py FOLDER NX NY OUT.bil     writes OUT.bil and OUT.hdr (ESRI BIL, int16, geographic WGS 84)
"""
import array
import pathlib
import re
import sys


def read_tile(path):
    data = array.array("h", path.read_bytes())
    if sys.byteorder == "little":
        data.byteswap()
    side = round(len(data) ** 0.5)
    return [data[r * side:(r + 1) * side] for r in range(side)]


def main():
    folder, nx, ny, out = pathlib.Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), pathlib.Path(sys.argv[4])
    tiles = {}
    for path in sorted(folder.glob("*.hgt")):
        found = re.fullmatch(r"([NS])(\d+)([EW])(\d+)", path.stem)
        south = int(found[2]) * (1 if found[1] == "N" else -1)
        west = int(found[4]) * (1 if found[3] == "E" else -1)
        tiles[south, west] = read_tile(path)
    norths, wests = sorted({s for s, _ in tiles}, reverse=True), sorted({w for _, w in tiles})
    side = len(tiles[norths[0], wests[0]])
    block = []  # north first; tiles share their border posts
    for i, south in enumerate(norths):
        for r in range(1 if i else 0, side):
            row = array.array("h")
            for j, west in enumerate(wests):
                row.extend(tiles[south, west][r][1 if j else 0:])
            block.append(row)
    rows = []
    for row in block:
        wide = array.array("h", row)
        back = row[::-1]
        for k in range(1, nx):
            wide.extend((back if k % 2 else row)[1:])
        rows.append(wide)
    order = list(range(len(rows)))
    for k in range(1, ny):
        order.extend((list(range(len(rows)))[::-1] if k % 2 else list(range(len(rows))))[1:])
    cell = 1 / (side - 1)
    with open(out, "wb") as file:
        for r in order:
            rows[r].tofile(file)
    north = norths[0] + 1
    out.with_suffix(".hdr").write_text(
        f"BYTEORDER {'I' if sys.byteorder == 'little' else 'M'}\nLAYOUT BIL\nNROWS {len(order)}\n"
        f"NCOLS {len(rows[0])}\nNBANDS 1\nNBITS 16\nPIXELTYPE SIGNEDINT\nULXMAP {wests[0]}\nULYMAP {north}\n"
        f"XDIM {cell!r}\nYDIM {cell!r}\nNODATA -32768\n")
    out.with_suffix(".prj").write_text(
        'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],PRIMEM["Greenwich",0],'
        'UNIT["degree",0.0174532925199433]]\n')
    print(f"{out}: {len(rows[0])} x {len(order)} posts")


main()
