// SPDX-License-Identifier: GPL-3.0-or-later
// CesiumJS in a headless browser: the daemon's own globe page, and a bare page of another origin.
import assert from 'node:assert/strict';
import {createReadStream} from 'node:fs';
import {createServer} from 'node:http';
import {extname, join, normalize} from 'node:path';
import {after, before, describe, it} from 'node:test';

import {findChromium, launchBrowser, openPage, pixelsOf} from './browser.mjs';
import {buildPyramids, kDatasets, startDaemon} from './daemon.mjs';
import {kPosts} from './posts.mjs';

const chromiumPath = findChromium();
if (!chromiumPath) {
  console.log('skipped: there is no Chromium on PATH (Debian: apt-get install chromium)');
  process.exit(77);
}

const {TEST_CESIUM, TEST_WORK} = process.env;
const kViewport = {width: 320, height: 240};
const kTypes = {'.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.json': 'application/json', '.wasm': 'application/wasm',
                '.png': 'image/png', '.jpg': 'image/jpeg', '.svg': 'image/svg+xml'};
// CesiumJS's geometric error of a level-0 tile; and how many times a tile's error to stand above it, so near at 240 lines that
// its screen-space error stays above 2 px. Several, one after another: see heightAt.
const kRootErrorM = 77067, kErrorsAbove = [60, 30, 15, 45, 80];
const kSettledMs = 300000;
// A globe without relief has one colour and the sky's; terrain in greys has up to 256.
const kFewestColours = 40;

// Serves the bare page and CesiumJS from an origin of its own, so that the daemon is asked across origins.
function startPageServer() {
  const server = createServer((request, response) => {
    const path = normalize(new URL(request.url, 'http://localhost').pathname);
    const file = path.startsWith('/cesium/') ? join(TEST_CESIUM, path.slice('/cesium/'.length)) : join(TEST_WORK, path);
    const stream = createReadStream(file);
    stream.on('open', () => {
      response.writeHead(200, {'Content-Type': kTypes[extname(file)] ?? 'application/octet-stream'});
      stream.pipe(response);
    });
    stream.on('error', () => response.writeHead(404).end());
  });
  return new Promise((resolve) => server.listen(0, '127.0.0.1', () => resolve(server)));
}

// Waits until the view has all its tiles: eight frames on end without a tile on its way.
async function settle(page) {
  await page.evaluate((limitMs) => new Promise((resolve, reject) => {
    const scene = viewer.scene, start = performance.now();
    let quiet = 0;
    const remove = scene.postRender.addEventListener(() => {
      quiet = scene.globe.tilesLoaded ? quiet + 1 : 0;
      if (quiet >= 8) {
        remove();
        resolve();
      } else if (performance.now() - start > limitMs) {
        remove();
        reject(new Error('the tiles did not load in time'));
      } else {
        scene.requestRender();
      }
    });
    scene.requestRender();
  }), kSettledMs);
}

// Looks at a post from close above; returns the globe's height there and the level of the tile that it is taken from.
// globe.getHeight takes the deepest tile with a mesh, and that may be a left-over stand-in of CesiumJS's own making (a fill: four
// corners, a chord below them) for a tile that never had to be loaded. Then drop all tiles and look again from another height.
async function heightAt(page, post, bottomLevel) {
  for (const errors of kErrorsAbove) {
    await page.evaluate(([{lon, lat, height_m}, aboveM]) => {
      viewer.camera.setView({destination: Cesium.Cartesian3.fromDegrees(lon, lat, height_m + aboveM)});
    }, [post, kRootErrorM / 2 ** bottomLevel * errors]);
    await settle(page);
    const found = await page.evaluate(({lon, lat}) => {
      const point = Cesium.Cartographic.fromDegrees(lon, lat), globe = viewer.scene.globe;
      const holds = (tile) => tile && Cesium.Rectangle.contains(tile.rectangle, point);
      let deepest;
      for (let tile = globe._surface._levelZeroTiles.find(holds); tile;
           tile = [tile._southwestChild, tile._southeastChild, tile._northwestChild, tile._northeastChild].find(holds)) {
        if (tile.data?.renderedMesh) deepest = tile;
      }
      return {height_m: globe.getHeight(point), level: deepest.level, isFill: deepest.data.vertexArray === undefined};
    }, post);
    if (!found.isFill) return found;
    await page.evaluate(() => viewer.scene.globe._surface.invalidateAllTiles());
  }
  throw new Error(`at ${post.lon} ${post.lat} CesiumJS kept its stand-in`);
}

const sampled = (page, posts, level) => page.evaluate(async ([list, atLevel]) => {
  const points = list.map(({lon, lat}) => Cesium.Cartographic.fromDegrees(lon, lat));
  const provider = viewer.scene.terrainProvider ?? viewer.terrainProvider;
  await (atLevel === undefined ? Cesium.sampleTerrainMostDetailed(provider, points, true)
                               : Cesium.sampleTerrain(provider, atLevel, points, true));
  return points.map((point) => point.height);
}, [posts, level]);

let daemon, server, browser, pageOrigin;
before(async () => {
  daemon = await startDaemon(buildPyramids(kDatasets), ['--cesium', TEST_CESIUM]);
  server = await startPageServer();
  pageOrigin = `http://127.0.0.1:${server.address().port}`;
  browser = await launchBrowser(chromiumPath);
});
after(async () => {
  await browser?.close();
  server?.close();
  assert.equal(await daemon?.stop(), 0, 'the daemon ends with 0');
});

// Everything that both pages must show. `opened` is what openPage gave, with the page's globe made.
async function checkGlobe(t, name, label, {page, urls, problems}) {
  const meta = await (await fetch(`${daemon.url}/${name}/meta.json`)).json();
  const posts = kPosts[name];
  const bottom = meta.levels[meta.bottom_level];

  // The whole extent first, then each post from close by.
  await page.evaluate((bounds) => viewer.camera.setView({destination: Cesium.Rectangle.fromDegrees(...bounds)}), meta.bounds_deg);
  await settle(page);
  // Without the page's own panel and CesiumJS's logo at the bottom.
  await page.addStyleTag({content: '#panel, .cesium-widget-credits { visibility: hidden; }'});
  const pixels = await pixelsOf(browser, await page.screenshot({path: join(TEST_WORK, `${label}.png`)}));
  assert.ok(pixels.n_colours > kFewestColours, `the screenshot has ${pixels.n_colours} colours`);

  // The sky is most of a frame's work without a graphics card, and has no part in what follows.
  await page.evaluate(() => {
    const {skyAtmosphere, skyBox, sun, moon} = viewer.scene;
    for (const part of [skyAtmosphere, skyBox, sun, moon]) if (part) part.show = false;
  });
  let worst = 0;
  // On a tile's border globe.getHeight's ray meets but edges and tips of triangles, and by chance none. sampleTerrain below serves there.
  const drawnSide = 180 / 2 ** (bottom.level + 2);
  const inside = posts.filter(({lon, lat}) => (lon + 180) % drawnSide !== 0 && (lat + 90) % drawnSide !== 0);
  assert.ok(inside.length >= 10, `only ${inside.length} posts lie off all borders`);
  for (const post of inside) {
    const {height_m, level} = await heightAt(page, post, bottom.level);
    assert.ok(level >= bottom.level, `at ${post.lon} ${post.lat} level ${level} is used, the bottom level is ${bottom.level}`);
    const error = Math.abs(height_m - post.height_m);
    assert.ok(error <= bottom.tolerance_m,
              `at ${post.lon} ${post.lat} the globe is at ${height_m} m, the post at ${post.height_m} m, E_L is ${bottom.tolerance_m} m`);
    worst = Math.max(worst, error);
  }
  t.diagnostic(`${label}: globe.getHeight is off by at most ${worst.toFixed(2)} m of ${bottom.tolerance_m.toFixed(2)} m`);

  for (const level of [undefined, ...meta.levels.map((entry) => entry.level)]) {
    const {tolerance_m} = level === undefined ? bottom : meta.levels[level];
    const heights = await sampled(page, posts, level);
    heights.forEach((height_m, k) => assert.ok(
      Math.abs(height_m - posts[k].height_m) <= tolerance_m,
      `level ${level ?? 'most detailed'}: ${height_m} m sampled at ${posts[k].lon} ${posts[k].lat}, the post is at ${posts[k].height_m} m`));
  }

  assert.deepEqual(problems, []);
  const n_tiles = urls.filter((url) => url.includes('.terrain')).length;
  assert.ok(n_tiles > meta.bottom_level, `${n_tiles} tiles were asked for`);
  t.diagnostic(`${label}: ${urls.length} requests, ${n_tiles} of them tiles, none failed; ${pixels.n_colours} colours`);
  return pixels;
}

for (const name of kDatasets) {
  describe(name, () => {
    const seen = {};
    for (const normals of [true, false]) {
      it(`a bare CesiumTerrainProvider ${normals ? 'with' : 'without'} normals loads it from another origin`, async (t) => {
        const opened = await openPage(browser, kViewport, [daemon.url, pageOrigin]);
        const query = new URLSearchParams({terrain: `${daemon.url}/${name}`, normals, low: 0, high: 4400});
        await opened.page.goto(`${pageOrigin}/bare_globe.html?${query}`);
        await opened.page.evaluate(() => window.ready);
        seen[normals] = await checkGlobe(t, name, `${name}-bare-${normals ? 'normals' : 'plain'}`, opened);
        assert.deepEqual(await opened.page.evaluate(() => window.terrainErrors), []);
        await opened.page.close();
      });
    }

    it('normals shade the relief', () => {
      let n_different = 0;
      for (let y = 0; y < kViewport.height; ++y) {
        for (let x = 0; x < kViewport.width; ++x) n_different += seen[true].at(x, y)[0] !== seen[false].at(x, y)[0];
      }
      assert.ok(n_different > kViewport.width * kViewport.height / 10, `${n_different} pixels differ with and without`);
    });

    it('the page of the daemon shows it', async (t) => {
      const opened = await openPage(browser, kViewport, [daemon.url]);
      await opened.page.goto(`${daemon.url}/${name}/`);
      await opened.page.waitForFunction(() => window.viewer?.scene.globe.material !== undefined, undefined, {timeout: kSettledMs});
      await checkGlobe(t, name, `${name}-page`, opened);
      assert.ok(await opened.page.locator('#error').isHidden(), 'the page shows no error');
      await opened.page.close();
    });
  });
}

it('heights can be seen: by the grey of the bare page the highest post is brighter than the lowest', async () => {
  const opened = await openPage(browser, kViewport, [daemon.url, pageOrigin]);
  const query = new URLSearchParams({terrain: `${daemon.url}/sangre_de_cristo`, normals: false, low: 1000, high: 4400});
  await opened.page.goto(`${pageOrigin}/bare_globe.html?${query}`);
  await opened.page.evaluate(() => window.ready);
  const posts = [...kPosts.sangre_de_cristo].sort((a, b) => a.height_m - b.height_m);
  const greys = [];
  for (const post of [posts[0], posts[posts.length - 1]]) {
    await heightAt(opened.page, post, 10);
    const pixels = await pixelsOf(browser, await opened.page.screenshot());
    greys.push(pixels.at(kViewport.width / 2, kViewport.height / 2)[0]);
  }
  assert.ok(greys[0] > 0 && greys[1] > greys[0] + 100, `grey ${greys[0]} at ${posts[0].height_m} m, ${greys[1]} at ${posts[9].height_m} m`);
  assert.deepEqual(opened.problems, []);
  await opened.page.close();
});

it('four tiles of one level meet without a gap: nothing shines through where CesiumJS draws no skirts', async (t) => {
  const opened = await openPage(browser, kViewport, [daemon.url, pageOrigin]);
  const query = new URLSearchParams({terrain: `${daemon.url}/sangre_de_cristo`, normals: false, low: 1000, high: 4400});
  await opened.page.goto(`${pageOrigin}/bare_globe.html?${query}`);
  await opened.page.evaluate(() => window.ready);
  // Beside Blanca Peak, above the corner that tiles 9/211..212/362..363 share, from where level 9 is fine enough.
  const levels = await opened.page.evaluate(() => {
    viewer.scene.globe.showSkirts = false;
    viewer.scene.backgroundColor = Cesium.Color.MAGENTA;
    viewer.camera.setView({destination: Cesium.Cartesian3.fromDegrees(-180 + 212 * 180 / 512, -90 + 363 * 180 / 512, 34000)});
  }).then(() => settle(opened.page)).then(() => opened.page.evaluate(
    () => viewer.scene.globe._surface._tilesToRender.map((tile) => `${tile.level}/${tile.x}`)));
  assert.ok(levels.length >= 4 && levels.every((tile) => tile.startsWith('9/')), `drawn: ${levels}`);
  const countMagenta = async () => {
    const pixels = await pixelsOf(browser, await opened.page.screenshot());
    let n = 0;
    for (let y = 0; y < kViewport.height; ++y) {
      for (let x = 0; x < kViewport.width; ++x) {
        const [red, green, blue] = pixels.at(x, y);
        n += red > green + 40 && blue > green + 40;
      }
    }
    return n;
  };
  assert.equal(await countMagenta(), 0, 'pixels of the background');
  await opened.page.evaluate(() => { viewer.scene.globe.show = false; });
  await settle(opened.page);
  const n_hidden = await countMagenta();
  assert.ok(n_hidden > kViewport.width * kViewport.height / 2, `only ${n_hidden} pixels of the background without the globe`);
  t.diagnostic(`${levels.length} tiles of level 9 drawn, no pixel of the background among them`);
  assert.deepEqual(opened.problems, []);
  await opened.page.close();
});

it('the list of datasets opens and links to every globe', async () => {
  const opened = await openPage(browser, {width: 1000, height: 800}, [daemon.url]);
  await opened.page.goto(`${daemon.url}/`);
  const hrefs = await opened.page.locator('a').evaluateAll((links) => links.map((link) => link.href));
  for (const name of kDatasets) assert.ok(hrefs.includes(`${daemon.url}/${name}/`), name);
  for (const href of new Set(hrefs)) assert.equal((await fetch(href)).status, 200, href);
  await opened.page.screenshot({path: join(TEST_WORK, 'index.png'), fullPage: true});
  assert.deepEqual(opened.problems, []);
  await opened.page.close();
});
