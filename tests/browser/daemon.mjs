// SPDX-License-Identifier: GPL-3.0-or-later
// Pyramids and a daemon for the tests of this folder. run_test sets the environment.
import {execFileSync, spawn} from 'node:child_process';
import {once} from 'node:events';
import {writeFileSync} from 'node:fs';
import {join} from 'node:path';
import {createInterface} from 'node:readline';

import {planetGrid} from './posts.mjs';

const {TEST_PROGRAMS, TEST_DATA, TEST_WORK} = process.env;
const kStartMs = 60000;

/// The demo's DEM as ./dev demo builds it and as fine as 20 m; and a planet with both poles and longitude 180 whose
/// level-0 tiles have more than 65,536 vertices each, so 32-bit indices.
export const kDatasets = ['sangre_de_cristo', 'sangre_de_cristo_fine', 'planet'];

/// Builds `names` out of kDatasets and returns the paths of their .tind files.
export function buildPyramids(names) {
  const dem = join(TEST_DATA, 'sangre_de_cristo.tif'), planet = join(TEST_WORK, 'planet.asc');
  if (names.includes('planet')) writeFileSync(planet, planetGrid());
  const inputs = {
    sangre_de_cristo: [dem],
    sangre_de_cristo_fine: [dem, '--finest', '20'],
    planet: [planet, '--tolerance', '200'],
  };
  return names.map((name) => {
    const path = join(TEST_WORK, name + '.tind');
    execFileSync(join(TEST_PROGRAMS, 'tind-build'), [...inputs[name], '-o', path, '--force', '-q'], {stdio: ['ignore', 'ignore', 'inherit']});
    return path;
  });
}

/// A running daemon on a free port of 127.0.0.1: {url, stop()}. stop() returns its exit code after SIGTERM.
export async function startDaemon(pyramids, options = []) {
  const child = spawn(join(TEST_PROGRAMS, 'tind'), [...pyramids, '--listen', '127.0.0.1:0', ...options],
                      {stdio: ['ignore', 'pipe', 'inherit']});
  const lines = createInterface({input: child.stdout});
  const timer = setTimeout(() => child.kill('SIGKILL'), kStartMs);
  const [line] = await Promise.race([once(lines, 'line'), once(child, 'exit').then(([code]) => [`exit code ${code}`])]);
  clearTimeout(timer);
  const match = /^tind: listening on (http:\S+)$/.exec(line);
  if (!match) {
    child.kill('SIGKILL');
    throw new Error(`tind did not start; its first line: ${line}`);
  }
  lines.on('line', () => {});
  return {
    url: match[1].replace(/\/$/, ''),
    async stop() {
      const exit = once(child, 'exit');
      child.kill('SIGTERM');
      return (await exit)[0];
    },
  };
}
