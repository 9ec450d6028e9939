#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes a raster of the whole planet with as many posts as one likes, without their bytes: a GDAL virtual raster (a
text file) over a coarse global one, which GDAL resamples as it is read.

Usage: planet_raster.py SOURCE.tif FACTOR OUT.vrt    FACTOR posts along each axis for every one of the source
Eleven on etopo5 (4320 x 2161) gives 47520 x 23771 posts, 1.13 * 10^9 of them.
Needs gdalinfo."""
import json
import os
import subprocess
import sys
from xml.sax.saxutils import escape


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    source, factor, target = sys.argv[1], int(sys.argv[2]), sys.argv[3]
    run = subprocess.run(["gdalinfo", "-json", source], capture_output=True, text=True)
    if run.returncode != 0:
        sys.exit(f"{source}: gdalinfo cannot read it: {run.stderr.strip()}")
    info = json.loads(run.stdout)
    n_cols, n_rows = info["size"]
    west, dx, skew_x, north, skew_y, dy = info["geoTransform"]
    transform = ", ".join(repr(v) for v in (west, dx / factor, skew_x, north, skew_y, dy / factor))
    with open(target, "w") as out:
        out.write(f"""<VRTDataset rasterXSize="{n_cols * factor}" rasterYSize="{n_rows * factor}">
<SRS>EPSG:4326</SRS><GeoTransform>{transform}</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource resampling="bilinear">
<SourceFilename relativeToVRT="0">{escape(os.path.abspath(source))}</SourceFilename><SourceBand>1</SourceBand>
<SrcRect xOff="0" yOff="0" xSize="{n_cols}" ySize="{n_rows}"/>
<DstRect xOff="0" yOff="0" xSize="{n_cols * factor}" ySize="{n_rows * factor}"/>
</SimpleSource></VRTRasterBand></VRTDataset>
""")


if __name__ == "__main__":
    main()
