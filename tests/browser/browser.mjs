// SPDX-License-Identifier: GPL-3.0-or-later
// A headless Chromium that keeps a record of all that goes wrong in it.
import {accessSync, constants} from 'node:fs';
import {delimiter, join} from 'node:path';

import {chromium} from 'playwright-core';

const kNames = ['chromium', 'chromium-browser', 'google-chrome'];
// WebGL 2 on the processor, nothing asked of any other host, no service in the background.
const kFlags = ['--no-sandbox', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update',
                '--disable-sync', '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader',
                '--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1'];

/// The path of a Chromium on PATH, or undefined.
export function findChromium() {
  for (const folder of (process.env.PATH ?? '').split(delimiter)) {
    for (const name of kNames) {
      try {
        accessSync(join(folder, name), constants.X_OK);
        return join(folder, name);
      } catch {
        // Not here.
      }
    }
  }
  return undefined;
}

export function launchBrowser(executablePath) {
  return chromium.launch({executablePath, headless: true, args: kFlags});
}

/// A page and what it did: `urls` asked for, and `problems`: failed requests, answers of 400 and above, errors on its
/// console, exceptions, and requests to any other origin than `origins`.
export async function openPage(browser, viewport, origins) {
  const page = await browser.newPage({viewport});
  const urls = [], problems = [];
  page.on('request', (request) => {
    const url = new URL(request.url());
    if (!url.protocol.startsWith('http')) return;
    urls.push(request.url());
    if (!origins.includes(url.origin)) problems.push(`another host is asked: ${request.url()}`);
  });
  page.on('requestfailed', (request) => problems.push(`failed: ${request.url()}: ${request.failure()?.errorText}`));
  page.on('response', (response) => {
    if (response.status() >= 400) problems.push(`status ${response.status()}: ${response.url()}`);
  });
  page.on('console', (message) => {
    if (message.type() === 'error') problems.push(`console: ${message.text()}`);
  });
  page.on('pageerror', (error) => problems.push(`exception: ${error.message}`));
  return {page, urls, problems};
}

/// The colours of a screenshot's pixels as [red, green, blue] by position: at(x, y), and the number of distinct ones.
export async function pixelsOf(browser, png) {
  const page = await browser.newPage();
  const {width, data} = await page.evaluate(async (base64) => {
    const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes], {type: 'image/png'}));
    const context = new OffscreenCanvas(image.width, image.height).getContext('2d');
    context.drawImage(image, 0, 0);
    return {width: image.width, data: Array.from(context.getImageData(0, 0, image.width, image.height).data)};
  }, png.toString('base64'));
  await page.close();
  const at = (x, y) => data.slice(4 * (Math.round(y) * width + Math.round(x)), 4 * (Math.round(y) * width + Math.round(x)) + 3);
  const colours = new Set();
  for (let i = 0; i < data.length; i += 4) colours.add((data[i] << 16) | (data[i + 1] << 8) | data[i + 2]);
  return {at, n_colours: colours.size};
}
