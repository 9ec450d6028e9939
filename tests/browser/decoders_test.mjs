// SPDX-License-Identifier: GPL-3.0-or-later
// Every .terrain tile of the served datasets, read by HERE's and loaders.gl's decoders.
import assert from 'node:assert/strict';
import {after, before, describe, it} from 'node:test';

import {buildPyramids, kDatasets, startDaemon} from './daemon.mjs';
import {kPosts} from './posts.mjs';
import {checkBorder, checkMesh, checkNormals, decodeTile, heightsAt} from './terrain_tile.mjs';

const kAccept = 'application/vnd.quantized-mesh,application/octet-stream;q=0.9,*/*;q=0.01';
const kAcceptNormals = 'application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata,application/octet-stream;q=0.9,*/*;q=0.01';
const kInFlight = 8;
// CesiumJS's formula rounds once more; heights stay below 32 km, doubles hold those to 4e-12 m.
const kLerpM = 1e-11;

async function bytesOf(url, accept) {
  const response = await fetch(url, {headers: {accept}});
  assert.equal(response.status, 200, url);
  assert.equal(response.headers.get('content-type'), 'application/vnd.quantized-mesh', url);
  return response.arrayBuffer();
}

const jsonOf = async (url) => (await fetch(url)).json();

function keysOf(meta) {
  return meta.levels.flatMap(({level, rows}) => rows.flatMap(
    ([y, first, last]) => Array.from({length: last - first + 1}, (_, k) => ({level, x: first + k, y}))));
}

const nameOf = ({level, x, y}) => `${level}/${x}/${y}`;

let daemon;
before(async () => { daemon = await startDaemon(buildPyramids(kDatasets)); });
after(async () => assert.equal(await daemon?.stop(), 0, 'the daemon ends with 0'));

for (const name of kDatasets) {
  describe(name, () => {
    let meta, layer;
    const tiles = new Map();
    const tileUrl = (key) => new URL(layer.tiles[0].replace('{z}', key.level).replace('{x}', key.x).replace('{y}', key.y)
                                       .replace('{version}', layer.version), `${daemon.url}/${name}/`).href;

    before(async () => {
      meta = await jsonOf(`${daemon.url}/${name}/meta.json`);
      layer = await jsonOf(`${daemon.url}/${name}/layer.json`);
      const queue = keysOf(meta);
      await Promise.all(Array.from({length: kInFlight}, async () => {
        for (let key = queue.pop(); key; key = queue.pop()) {
          tiles.set(nameOf(key), await decodeTile(key, await bytesOf(tileUrl(key), kAcceptNormals)));
        }
      }));
    });

    it('layer.json has every field that clients read, and lists the stored tiles, neither more nor fewer', () => {
      assert.equal(layer.format, 'quantized-mesh-1.0');
      assert.equal(layer.scheme, 'tms');
      assert.equal(layer.projection, 'EPSG:4326');
      for (const field of ['tilejson', 'version', 'bounds', 'minzoom', 'maxzoom', 'attribution']) assert.ok(field in layer, field);
      assert.ok(layer.extensions.includes('octvertexnormals'));
      const listed = layer.available.flatMap((rectangles, level) => rectangles.flatMap(({startX, startY, endX, endY}) => {
        const keys = [];
        for (let y = startY; y <= endY; ++y) for (let x = startX; x <= endX; ++x) keys.push(nameOf({level, x, y}));
        return keys;
      }));
      assert.equal(new Set(listed).size, listed.length, 'no tile is listed twice');
      assert.deepEqual(listed.sort(), [...tiles.keys()].sort());
      assert.ok(tiles.has('0/0/0') && tiles.has('0/1/0'), 'both root tiles');
      assert.equal(layer.maxzoom, meta.bottom_level);
    });

    it('every tile is read alike by both decoders and is a mesh of its whole square', (t) => {
      let n_vertices = 0;
      for (const [key, tile] of tiles) {
        n_vertices += tile.n;
        try {
          checkMesh(tile);
        } catch (error) {
          error.message = `tile ${key}: ${error.message}`;
          throw error;
        }
      }
      t.diagnostic(`${tiles.size} tiles, ${n_vertices} vertices`);
    });

    it('a tile without normals is the same mesh, and both ways to ask for normals give the same bytes', async () => {
      for (const [key, tile] of tiles) {
        assert.equal(tile.normals?.length, 2 * tile.n, `tile ${key}: two bytes of normal a vertex`);
        const url = tileUrl(tile.key);
        const plain = await bytesOf(url, kAccept);
        const asked = await bytesOf(url, kAcceptNormals);
        const native = await bytesOf(`${url}${url.includes('?') ? '&' : '?'}extensions=octvertexnormals-metadata`, '*/*');
        assert.deepEqual(new Uint8Array(native), new Uint8Array(asked), `tile ${key}`);
        assert.equal(asked.byteLength, plain.byteLength + 5 + 2 * tile.n, `tile ${key}`);
        assert.deepEqual(new Uint8Array(asked, 0, plain.byteLength), new Uint8Array(plain), `tile ${key}`);
      }
    });

    it('neighbours of one level decode to identical borders: positions, heights, normals', (t) => {
      let n_borders = 0, largest = 0;
      for (const a of tiles.values()) {
        const {level, x, y} = a.key;
        const east = tiles.get(nameOf({level, x: (x + 1) % 2 ** (level + 1), y}));
        const north = tiles.get(nameOf({level, x, y: y + 1}));
        if (east) largest = Math.max(largest, checkBorder(a, a.east, east, east.west, 'v', `${nameOf(a.key)} east`));
        if (north) largest = Math.max(largest, checkBorder(a, a.north, north, north.south, 'u', `${nameOf(a.key)} north`));
        n_borders += !!east + !!north;
      }
      assert.ok(n_borders > tiles.size / 2);
      assert.ok(largest <= kLerpM, `by CesiumJS's formula they differ by ${largest} m`);
      t.diagnostic(`${n_borders} borders; by CesiumJS's formula they differ by at most ${largest} m`);
    });

    it('the four tiles at a corner agree in height and normal, and a pole is one point', () => {
      const corners = new Map();
      for (const tile of tiles.values()) {
        const {level, x, y} = tile.key;
        for (const [list, end, dx, dy] of [['south', 0, 0, 0], ['south', -1, 1, 0], ['north', 0, 0, 1], ['north', -1, 1, 1]]) {
          const row = y + dy, pole = row === 0 || row === 2 ** level;
          const corner = `corner ${level}/${pole ? 0 : (x + dx) % 2 ** (level + 1)}/${row}`;
          const i = Array.from(tile[list]).at(end);
          if (!corners.has(corner)) corners.set(corner, [tile, i]);
          const [first, k] = corners.get(corner);
          assert.equal(tile.height[i], first.height[k], corner);
          checkNormals(tile, i, first, k, corner);
          if (pole) {
            for (const other of tile[list]) {
              assert.equal(tile.height[other], tile.height[i], `${corner}: all of the pole's side`);
              checkNormals(tile, other, tile, i, corner);
            }
          }
        }
      }
    });

    it('at the known posts the decoded surface is within E_L at every level', (t) => {
      const worst = meta.levels.map(() => 0);
      for (const {lon, lat, height_m} of kPosts[name]) {
        let n_found = 0;
        for (const tile of tiles.values()) {
          const {level} = tile.key;
          for (const h of heightsAt(tile, lon, lat) ?? []) {
            worst[level] = Math.max(worst[level], Math.abs(h - height_m));
            ++n_found;
          }
        }
        assert.ok(n_found >= 2 * meta.levels.length, `${lon} ${lat} is in a tile of every level`);
      }
      meta.levels.forEach(({level, tolerance_m}) => assert.ok(
        worst[level] <= tolerance_m, `level ${level}: ${worst[level]} m at a known post, E_L is ${tolerance_m} m`));
      t.diagnostic(`worst by level: ${worst.map((w, level) => `${w.toFixed(2)} of ${meta.levels[level].tolerance_m.toFixed(2)}`).join(', ')} m`);
    });

    it('a tile that is not stored answers 404', async () => {
      const bottom = meta.bottom_level + 1;
      const absent = [{level: bottom, x: 0, y: 0}, {level: bottom, x: 2 ** (bottom + 1) - 1, y: 2 ** bottom - 1}, {level: 0, x: 2, y: 0},
                      {level: 0, x: 0, y: 1}, {level: 29, x: 0, y: 0}];
      for (let level = 0; level <= meta.bottom_level; ++level) {
        const hole = [0, 2 ** level - 1].map((y) => ({level, x: 0, y})).find((key) => !tiles.has(nameOf(key)));
        if (hole) absent.push(hole);
      }
      for (const key of absent) assert.equal((await fetch(`${daemon.url}/${name}/${nameOf(key)}.terrain`)).status, 404, nameOf(key));
    });
  });
}
