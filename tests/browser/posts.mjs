// SPDX-License-Identifier: GPL-3.0-or-later
// Known heights, from sources that are not tind.

/// Ten posts of tests/data/sangre_de_cristo.tif: its four corners, its highest and its lowest post, and four more.
/// Longitude and latitude in degrees (column and row / 1200), heights in metres. Each height was read once by
///   gdallocationinfo -valonly tests/data/sangre_de_cristo.tif COLUMN ROW
/// with column = (longitude + 106) * 1200, row = (38 - latitude) * 1200.
const kSangreDeCristo = [
  [0, 0, 2292],
  [2400, 0, 1369],
  [0, 1200, 2452],
  [2400, 1200, 1870],
  [617, 508, 4322],   // Blanca Peak
  [2386, 0, 1359],    // the Arkansas, the lowest post
  [1200, 600, 2183],
  [1055, 0, 3363],
  [1477, 733, 2151],
  [300, 900, 2285],
].map(([column, row, height_m]) => ({lon: -106 + column / 1200, lat: 38 - row / 1200, height_m}));

const kGlobeSpacingDeg = 0.5;

/// Whole metres of a made-up planet at a post of the half-degree grid; smooth over longitude 180 and at both poles.
function planetHeight(lon, lat) {
  const a = lon * Math.PI / 180, b = lat * Math.PI / 180;
  return Math.round(1500 + 1200 * Math.sin(2 * b) + 900 * Math.cos(b) ** 2 * Math.sin(3 * a + 1) * Math.cos(5 * b));
}

/// The planet as an Arc/Info ASCII grid: cell centres are the posts, both poles and longitudes -180 to 179.5.
export function planetGrid() {
  const n_cols = 360 / kGlobeSpacingDeg, n_rows = 180 / kGlobeSpacingDeg + 1;
  const lines = [`ncols ${n_cols}`, `nrows ${n_rows}`, 'xllcenter -180', 'yllcenter -90', `cellsize ${kGlobeSpacingDeg}`,
                 'NODATA_value -32768'];
  for (let row = 0; row < n_rows; ++row) {
    const heights = [];
    for (let column = 0; column < n_cols; ++column) {
      heights.push(planetHeight(-180 + column * kGlobeSpacingDeg, 90 - row * kGlobeSpacingDeg));
    }
    lines.push(heights.join(' '));
  }
  return lines.join('\n') + '\n';
}

/// Posts of the planet: five on tile borders (both poles, longitude 180, longitude 0), and ten beside those and elsewhere.
const kPlanet = [[0, 90], [90, -90], [33, 89.5], [-120.5, -89.5], [-180, 0], [-180, 41.5], [179.5, 10], [-179.5, -33], [0, 0],
                 [-105, 37.5], [87, 28], [12.5, -71], [-150.5, 60], [60.5, -20.5], [140, -45.5]]
  .map(([lon, lat]) => ({lon, lat, height_m: planetHeight(lon, lat)}));

export const kPosts = {sangre_de_cristo: kSangreDeCristo, sangre_de_cristo_fine: kSangreDeCristo, planet: kPlanet};
