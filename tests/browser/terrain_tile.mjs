// SPDX-License-Identifier: GPL-3.0-or-later
// One quantized-mesh tile as two foreign decoders see it, and what any tile must fulfil.
import assert from 'node:assert/strict';

import here from '@here/quantized-mesh-decoder';
import {parse} from '@loaders.gl/core';
import {QuantizedMeshLoader} from '@loaders.gl/terrain';

const decodeHere = here.default ?? here;
const kSteps = 32767, kStepDivisors = [32767, 4681, 1057, 217, 151, 31, 7, 1];
const kSemiMajorM = 6378137, kEccentricity2 = 2 / 298.257223563 - 1 / 298.257223563 ** 2;

/// [west, south, east, north] in degrees. TMS rows.
export function tileBounds({level, x, y}) {
  const side = 180 / 2 ** level;
  return [-180 + x * side, -90 + y * side, -180 + (x + 1) * side, -90 + (y + 1) * side];
}

function toEcef(lonDeg, latDeg, heightM) {
  const lon = lonDeg * Math.PI / 180, lat = latDeg * Math.PI / 180;
  const n = kSemiMajorM / Math.sqrt(1 - kEccentricity2 * Math.sin(lat) ** 2);
  return [(n + heightM) * Math.cos(lat) * Math.cos(lon), (n + heightM) * Math.cos(lat) * Math.sin(lon),
          (n * (1 - kEccentricity2) + heightM) * Math.sin(lat)];
}

/// Decodes `bytes` (an ArrayBuffer, left as it is) with both decoders, asserts that they agree, and returns
/// {header, n, u, v, q, height (doubles, metres), triangles, west, south, east, north (vertex indices), normals}.
export async function decodeTile(key, bytes) {
  // Both decode indices in place: each gets its own copy.
  const mesh = decodeHere(bytes.slice(0));
  const bounds = tileBounds(key);
  const other = await parse(bytes.slice(0), QuantizedMeshLoader, {worker: false, 'quantized-mesh': {bounds}});

  const n = mesh.vertexData.length / 3;
  const {minHeight, maxHeight} = mesh.header;
  const tile = {
    key, header: mesh.header, n,
    u: mesh.vertexData.subarray(0, n), v: mesh.vertexData.subarray(n, 2 * n), q: mesh.vertexData.subarray(2 * n),
    height: new Float64Array(n),
    triangles: mesh.triangleIndices, west: mesh.westIndices, south: mesh.southIndices, east: mesh.eastIndices,
    north: mesh.northIndices, normals: mesh.extensions.vertexNormals, extensions: mesh.extensions,
  };
  for (let i = 0; i < n; ++i) tile.height[i] = tile.q[i] / kSteps * (maxHeight - minHeight) + minHeight;

  // loaders.gl gives 32-bit floats: degrees and metres.
  const positions = other.attributes.POSITION.value;
  assert.equal(positions.length, 3 * n, 'both decoders find as many vertices');
  for (let i = 0; i < n; ++i) {
    const lon = tile.u[i] / kSteps * (bounds[2] - bounds[0]) + bounds[0];
    const lat = tile.v[i] / kSteps * (bounds[3] - bounds[1]) + bounds[1];
    if (positions[3 * i] !== Math.fround(lon) || positions[3 * i + 1] !== Math.fround(lat) ||
        positions[3 * i + 2] !== Math.fround(tile.height[i])) {
      assert.fail(`vertex ${i}: loaders.gl has ${positions.subarray(3 * i, 3 * i + 3)}, HERE's decoder ${[lon, lat, tile.height[i]]}`);
    }
  }
  assert.deepEqual(Array.from(other.indices.value), Array.from(tile.triangles), 'both decoders find the same triangles');
  return tile;
}

/// Asserts that the tile is a counter-clockwise triangulation of its whole square, that its four lists are its outline, and
/// that its header bounds it.
export function checkMesh(tile) {
  const {n, u, v, q, triangles} = tile;
  assert.notEqual(n, 65536, 'CesiumJS cannot read a tile of exactly 65,536 vertices');
  assert.equal(triangles.length % 3, 0);
  const directed = new Set();
  const used = new Uint8Array(n);
  let doubleArea = 0;
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = triangles.subarray(t, t + 3);
    assert.ok(a < n && b < n && c < n, 'indices are in range');
    const area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a]);
    if (!(area > 0)) assert.fail(`triangle ${t / 3} has the area ${area / 2} in u and v`);
    doubleArea += area;
    for (const [from, to] of [[a, b], [b, c], [c, a]]) {
      const edge = from * n + to;
      if (directed.has(edge)) assert.fail(`the directed edge ${from}-${to} occurs twice`);
      directed.add(edge);
      used[from] = 1;
    }
  }
  assert.equal(doubleArea, 2 * kSteps * kSteps, 'the triangles cover the square exactly');
  assert.ok(used.every((value) => value === 1), 'every vertex is in a triangle');

  const outline = new Set();
  for (const [name, along, across, at, reversed] of [
    ['west', v, u, 0, true], ['south', u, v, 0, false], ['east', v, u, kSteps, false], ['north', u, v, kSteps, true]]) {
    const list = tile[name];
    assert.ok(list.length >= 2, `${name}: at least the two corners`);
    assert.equal(along[list[0]], 0, `${name} begins at a corner`);
    assert.equal(along[list[list.length - 1]], kSteps, `${name} ends at a corner`);
    for (let k = 0; k < list.length; ++k) {
      assert.equal(across[list[k]], at, `${name}: vertex ${list[k]} lies on it`);
      if (k === 0) continue;
      assert.ok(along[list[k]] > along[list[k - 1]], `${name} ascends`);
      outline.add(reversed ? list[k] * n + list[k - 1] : list[k - 1] * n + list[k]);
    }
    let on = 0;
    for (let i = 0; i < n; ++i) on += across[i] === at;
    assert.equal(on, list.length, `${name} lists every vertex on that side`);
  }
  for (const edge of directed) {
    const back = (edge % n) * n + Math.floor(edge / n);
    const border = !directed.has(back);
    if (border !== outline.has(edge)) assert.fail(`edge ${Math.floor(edge / n)}-${edge % n}: ${border ? 'a hole' : 'inside, but listed'}`);
  }
  checkHeader(tile);
}

function checkHeader(tile) {
  const {header, height, u, v, q, n} = tile;
  const range = header.maxHeight - header.minHeight;
  let low = Infinity, high = -Infinity;
  for (const h of height) {
    low = Math.min(low, h);
    high = Math.max(high, h);
  }
  assert.ok(header.minHeight <= low && high <= header.maxHeight, 'minimum and maximum bound the heights');
  assert.ok(range <= 2 * (high - low), `the range ${range} m stays within twice the true one, ${high - low} m`);
  if (range > 0) {
    // A divisor of 32767 (32767 itself but for nearly flat tiles high up) times a power of two.
    const units = kStepDivisors.find((divisor) => Number.isInteger(Math.log2(range / divisor)));
    assert.ok(units, `the range ${range} m is no divisor of 32767 times a power of two`);
    assert.ok(Number.isInteger(header.minHeight / (range / units)), 'the minimum is a multiple of the unit');
  }
  const [west, south, east, north] = tileBounds(tile.key);
  const center = [header.boundingSphereCenterX, header.boundingSphereCenterY, header.boundingSphereCenterZ];
  const occlusion = [header.horizonOcclusionPointX, header.horizonOcclusionPointY, header.horizonOcclusionPointZ];
  assert.ok([...center, ...occlusion].every(Number.isFinite));
  const semiMinorM = kSemiMajorM * Math.sqrt(1 - kEccentricity2);
  const reach = Math.hypot(...occlusion), toward = occlusion.map((c) => c / reach);
  for (let i = 0; i < n; ++i) {
    const p = toEcef(west + u[i] / kSteps * (east - west), south + v[i] / kSteps * (north - south), height[i]);
    const distance = Math.hypot(p[0] - center[0], p[1] - center[1], p[2] - center[2]);
    if (distance > header.boundingSphereRadius) assert.fail(`vertex ${i} lies ${distance} m from the sphere's center`);
    // The point must be visible wherever the vertex is: with the vertex at the angle alpha from it and
    // cos(beta) = 1 / |vertex| (both on the unit sphere's scale), its own distance is at least 1 / cos(alpha + beta).
    const s = [p[0] / kSemiMajorM, p[1] / kSemiMajorM, p[2] / semiMinorM], length = Math.hypot(...s);
    const alpha = Math.acos(Math.min(1, (s[0] * toward[0] + s[1] * toward[1] + s[2] * toward[2]) / length));
    const angle = alpha + Math.acos(1 / Math.max(1, length));
    const needed = angle < Math.PI / 2 ? 1 / Math.cos(angle) : 1e100;
    // A vertex on the ellipsoid itself has length 1 up to rounding, so beta up to 2e-8.
    if (reach < needed * (1 - 1e-7)) assert.fail(`vertex ${i} can be seen where the occlusion point ${reach} is hidden: ${needed} needed`);
  }
}

/// Asserts that two borders are one: `first` and `second` are the lists of the same line from its two tiles. Positions are
/// compared as they stand, heights as the decoders make them, normals byte for byte.
export function checkBorder(a, first, b, second, along, what) {
  assert.equal(first.length, second.length, `${what}: as many vertices on both sides`);
  let largest = 0;
  for (let k = 0; k < first.length; ++k) {
    const i = first[k], j = second[k];
    if (a[along][i] !== b[along][j]) assert.fail(`${what}: position ${a[along][i]} on one side, ${b[along][j]} on the other`);
    if (a.height[i] !== b.height[j]) assert.fail(`${what}: height ${a.height[i]} on one side, ${b.height[j]} on the other`);
    largest = Math.max(largest, Math.abs(lerpHeight(a, i) - lerpHeight(b, j)));
    checkNormals(a, i, b, j, what);
  }
  return largest;
}

/// CesiumJS's and cesium-native's own formula.
function lerpHeight(tile, i) {
  const t = tile.q[i] / kSteps;
  return (1 - t) * tile.header.minHeight + t * tile.header.maxHeight;
}

export function checkNormals(a, i, b, j, what) {
  if (a.normals[2 * i] !== b.normals[2 * j] || a.normals[2 * i + 1] !== b.normals[2 * j + 1]) {
    assert.fail(`${what}: normal ${a.normals.subarray(2 * i, 2 * i + 2)} on one side, ${b.normals.subarray(2 * j, 2 * j + 2)} on the other`);
  }
}

/// The surface's height at a position, linear in longitude and latitude within each triangle; the lowest and highest where
/// triangles meet. undefined outside.
export function heightsAt(tile, lon, lat) {
  const [west, south, east, north] = tileBounds(tile.key);
  const pu = (lon - west) / (east - west) * kSteps, pv = (lat - south) / (north - south) * kSteps;
  const {u, v, height, triangles} = tile;
  let found;
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = triangles.subarray(t, t + 3);
    const area = (u[b] - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (v[b] - v[a]);
    const wb = ((pu - u[a]) * (v[c] - v[a]) - (u[c] - u[a]) * (pv - v[a])) / area;
    const wc = ((u[b] - u[a]) * (pv - v[a]) - (pu - u[a]) * (v[b] - v[a])) / area;
    if (wb < -1e-9 || wc < -1e-9 || wb + wc > 1 + 1e-9) continue;
    const h = (1 - wb - wc) * height[a] + wb * height[b] + wc * height[c];
    found = found ? [Math.min(found[0], h), Math.max(found[1], h)] : [h, h];
  }
  return found;
}
