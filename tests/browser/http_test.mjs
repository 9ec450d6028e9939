// SPDX-License-Identifier: GPL-3.0-or-later
// What a plain HTTP client sees: negotiation, validators, HEAD. Node's own client and the zstd program decode.
import assert from 'node:assert/strict';
import {spawnSync} from 'node:child_process';
import {Agent, get, request} from 'node:http';
import {after, before, it} from 'node:test';
import {gunzipSync} from 'node:zlib';

import {buildPyramids, startDaemon} from './daemon.mjs';

let daemon, tile, vn, meta;
before(async () => {
  daemon = await startDaemon(buildPyramids(['sangre_de_cristo']), ['--cesium', process.env.TEST_CESIUM]);
  const root = `${daemon.url}/sangre_de_cristo`;
  meta = `${root}/meta.json`;
  const levels = JSON.parse((await ask(meta)).body).levels;
  const [y, x] = levels.at(-1).rows.find((row) => row[3] === 2);
  tile = `${root}/${levels.length - 1}/${x}/${y}.terrain`;
  vn = `${root}/${levels.length - 1}/${x}/${y}.vn`;
});
after(async () => assert.equal(await daemon?.stop(), 0, 'the daemon ends with 0'));

// One request, nothing decoded: {status, headers, body}. `path`: to be sent as it stands, instead of the address's own.
function ask(url, headers = {}, method = 'GET', path = undefined) {
  return new Promise((resolve, reject) => {
    request(url, {method, headers, ...(path && {path})}, (response) => {
      const chunks = [];
      response.on('data', (chunk) => chunks.push(chunk));
      response.on('end', () => resolve({status: response.statusCode, headers: response.headers, body: Buffer.concat(chunks)}));
    }).on('error', reject).end();
  });
}

const decoders = {
  gzip: (body) => gunzipSync(body),
  zstd: (body) => {
    const {status, stdout} = spawnSync('zstd', ['-dc'], {input: body, maxBuffer: 1 << 28});
    assert.equal(status, 0, 'zstd decodes it');
    return stdout;
  },
};
const hasZstd = spawnSync('zstd', ['--version']).status === 0;

for (const coding of ['gzip', 'zstd']) {
  const skip = coding === 'zstd' && !hasZstd ? 'there is no zstd program (Debian: apt-get install zstd)' : false;
  it(`${coding} is used when asked for, says so, and decodes to the plain bytes`, {skip}, async () => {
    for (const url of [tile, vn, meta]) {
      const plain = await ask(url);
      const packed = await ask(url, {'accept-encoding': coding});
      assert.equal(plain.headers['content-encoding'], undefined);
      assert.equal(packed.headers['content-encoding'], coding, url);
      assert.match(packed.headers.vary, /accept-encoding/i);
      assert.equal(Number(packed.headers['content-length']), packed.body.length);
      assert.ok(packed.body.length < plain.body.length, `${packed.body.length} of ${plain.body.length} bytes`);
      assert.ok(decoders[coding](packed.body).equals(plain.body));
      assert.notEqual(packed.headers.etag, plain.headers.etag, 'other bytes, another tag');
    }
  });
}

it('a coding that is refused or unknown is not used', async () => {
  for (const field of ['identity', 'br, deflate', 'gzip;q=0, zstd;q=0', '']) {
    const answer = await ask(tile, {'accept-encoding': field});
    assert.equal(answer.status, 200);
    assert.equal(answer.headers['content-encoding'], undefined, field);
  }
});

it('normals come when Accept or the query asks for them, and only then', async () => {
  const plain = await ask(tile, {accept: 'application/vnd.quantized-mesh'});
  assert.match(plain.headers.vary, /accept(,|$)/i);
  const n = plain.body.readUInt32LE(88);
  for (const [url, accept] of [[tile, 'application/vnd.quantized-mesh;extensions=octvertexnormals'],
                               [tile, 'application/vnd.quantized-mesh;extensions=octvertexnormals-watermask-metadata,*/*;q=0.01'],
                               [`${tile}?extensions=octvertexnormals`, '*/*'], [`${tile}?extensions=metadata-octvertexnormals`, '*/*']]) {
    const answer = await ask(url, {accept});
    assert.equal(answer.body.length, plain.body.length + 5 + 2 * n, `${url} ${accept}`);
    assert.notEqual(answer.headers.etag, plain.headers.etag);
  }
  for (const [url, accept] of [[tile, '*/*'], [`${tile}?extensions=watermask-metadata`, '*/*'],
                               [tile, 'application/vnd.quantized-mesh;extensions=watermask']]) {
    assert.ok((await ask(url, {accept})).body.equals(plain.body), `${url} ${accept}`);
  }
});

it('an entity tag that still holds answers 304 without a body, another one 200', async () => {
  for (const coding of ['identity', 'gzip']) {
    const first = await ask(tile, {'accept-encoding': coding});
    assert.match(first.headers.etag, /^(W\/)?".+"$/);
    for (const match of [first.headers.etag, `"other", ${first.headers.etag}`, '*']) {
      const again = await ask(tile, {'accept-encoding': coding, 'if-none-match': match});
      assert.equal(again.status, 304, match);
      assert.equal(again.body.length, 0);
      assert.equal(again.headers.etag, first.headers.etag);
      assert.equal(again.headers['cache-control'], first.headers['cache-control']);
    }
    assert.equal((await ask(tile, {'accept-encoding': coding, 'if-none-match': '"other"'})).status, 200);
  }
});

it('HEAD has the fields of GET and no body', async () => {
  for (const path of ['/', '/datasets', '/health', '/ready', '/sangre_de_cristo/', '/sangre_de_cristo/meta.json', '/sangre_de_cristo/layer.json',
                      '/sangre_de_cristo/0/0/0.parts', '/sangre_de_cristo/body/0/0/0', '/sangre_de_cristo/9/9/9.terrain', '/none',
                      new URL(tile).pathname, new URL(vn).pathname]) {
    for (const coding of ['identity', 'gzip']) {
      const fields = {'accept-encoding': coding};
      const [whole, head] = [await ask(daemon.url + path, fields), await ask(daemon.url + path, fields, 'HEAD')];
      for (const {headers} of [whole, head]) delete headers.date;
      assert.equal(head.status, whole.status, path);
      assert.deepEqual(head.headers, whole.headers, path);
      assert.equal(head.body.length, 0, path);
      assert.equal(Number(whole.headers['content-length']), whole.body.length, path);
    }
  }
});

it('any page may read every answer, and a browser may ask first', async () => {
  for (const path of ['/datasets', '/sangre_de_cristo/layer.json', '/none', new URL(tile).pathname]) {
    assert.equal((await ask(daemon.url + path, {origin: 'http://elsewhere.example'})).headers['access-control-allow-origin'], '*', path);
  }
  const asked = await ask(tile, {origin: 'http://elsewhere.example', 'access-control-request-method': 'GET'}, 'OPTIONS');
  assert.ok(asked.status === 200 || asked.status === 204);
  assert.equal(asked.headers['access-control-allow-origin'], '*');
});

it('what is not there answers 404, what may not be done 405', async () => {
  for (const path of ['/none/', '/none/layer.json', '/sangre_de_cristo/layer', '/sangre_de_cristo/0/2/0.terrain', '/sangre_de_cristo/0/0/0.png',
                      '/sangre_de_cristo/11/0/0.vn', '/cesium/None.js']) {
    assert.equal((await ask(daemon.url + path)).status, 404, path);
  }
  assert.equal((await ask(`${daemon.url}/cesium/Cesium.js`)).status, 200);
  for (const path of ['/cesium/../package.json', '/cesium/%2e%2e/%2e%2e/package.json', '/cesium/..%2f..%2fpackage.json', '/cesium//etc/passwd']) {
    assert.ok([400, 404].includes((await ask(daemon.url, {}, 'GET', path)).status), path);
  }
  for (const method of ['POST', 'PUT', 'DELETE']) {
    const refused = await ask(tile, {'content-length': '0'}, method);
    assert.equal(refused.status, 405, method);
    assert.match(refused.headers.allow, /GET/);
  }
});

it('a version in the address makes an answer last; layer.json gives that address', async () => {
  const layer = JSON.parse((await ask(`${daemon.url}/sangre_de_cristo/layer.json`)).body);
  const answer = await ask(new URL(layer.tiles[0].replace('{z}/{x}/{y}', '0/0/0'), `${daemon.url}/sangre_de_cristo/`).href);
  assert.equal(answer.status, 200);
  assert.match(answer.headers['cache-control'], /immutable/);
  assert.doesNotMatch((await ask(tile)).headers['cache-control'], /immutable/);
});

it('one connection serves many requests', async () => {
  const agent = new Agent({keepAlive: true, maxSockets: 1});
  const ports = new Set();
  for (let k = 0; k < 20; ++k) {
    await new Promise((resolve, reject) => get(tile, {agent}, (response) => {
      ports.add(response.socket.localPort);
      response.resume().on('end', resolve);
    }).on('error', reject));
  }
  agent.destroy();
  assert.equal(ports.size, 1);
});
