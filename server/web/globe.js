// SPDX-License-Identifier: GPL-3.0-or-later
// The dataset of this address on a CesiumJS globe. Everything comes from this daemon; no other host is asked.
'use strict';

const element = (id) => document.getElementById(id);

function showError(text) {
  element('error').textContent = text;
  element('error').hidden = false;
}

// Heights to colours, low to high.
const RAMP = [[0.0, '#4c7a4f'], [0.25, '#a9b665'], [0.5, '#d9c07c'], [0.75, '#a67c52'], [0.92, '#d8d3cd'], [1.0, '#ffffff']];

function rampImage() {
  const canvas = document.createElement('canvas');
  canvas.width = 256;
  canvas.height = 1;
  const context = canvas.getContext('2d');
  const gradient = context.createLinearGradient(0, 0, 256, 0);
  for (const [at, colour] of RAMP) gradient.addColorStop(at, colour);
  context.fillStyle = gradient;
  context.fillRect(0, 0, 256, 1);
  return canvas;
}

function terrainMaterial(low, high, withContours) {
  const materials = {
    ramp: {type: 'ElevationRamp', uniforms: {image: rampImage(), minimumHeight: low, maximumHeight: high}},
  };
  if (withContours) {
    materials.contours = {
      type: 'ElevationContour',
      uniforms: {color: Cesium.Color.BLACK.withAlpha(0.5), spacing: contourSpacing(high - low), width: 1.0},
    };
  }
  const components = withContours ?
      {diffuse: 'contours.alpha > 0.0 ? contours.diffuse : ramp.diffuse', alpha: '1.0'} :
      {diffuse: 'ramp.diffuse', alpha: '1.0'};
  return new Cesium.Material({fabric: {materials, components}});
}

function contourSpacing(range) {
  const target = range / 20;
  const power = 10 ** Math.floor(Math.log10(Math.max(target, 1e-3)));
  return power * (target > 5 * power ? 10 : target > 2 * power ? 5 : 2);
}

// The heights that the coloured ramp spans: the lowest and highest of a few posts inside the data.
async function sampleRange(terrain, level, rectangle) {
  const posts = [];
  for (let j = 1; j < 12; ++j) {
    for (let i = 1; i < 12; ++i) {
      posts.push(new Cesium.Cartographic(rectangle.west + (rectangle.east - rectangle.west) * i / 12,
                                         rectangle.south + (rectangle.north - rectangle.south) * j / 12));
    }
  }
  await Cesium.sampleTerrain(terrain, level, posts);
  const heights = posts.map((post) => post.height).filter(Number.isFinite);
  if (heights.length === 0) return [0, 1000];
  const low = Math.min(...heights), high = Math.max(...heights);
  return high > low ? [low, high] : [low - 1, high + 1];
}

async function main() {
  const parts = location.pathname.split('/').filter((part) => part !== '');
  const name = decodeURIComponent(parts[parts.length - 1]);
  element('name').textContent = name;
  document.title = name + ' - tind';

  const meta = await (await fetch('meta.json')).json();
  const terrain = await Cesium.CesiumTerrainProvider.fromUrl('./', {requestVertexNormals: true});
  const viewer = new Cesium.Viewer('globe', {
    terrainProvider: terrain, baseLayer: false, baseLayerPicker: false, geocoder: false, homeButton: false,
    sceneModePicker: false, navigationHelpButton: false, animation: false, timeline: false, fullscreenButton: false,
    infoBox: false, selectionIndicator: false, requestRenderMode: true, maximumRenderTimeChange: Infinity,
  });
  const scene = viewer.scene, globe = scene.globe;
  window.viewer = viewer;  // for tests and the browser's console
  terrain.errorEvent.addEventListener((error) => showError(error.message));

  const rectangle = Cesium.Rectangle.fromDegrees(...meta.bounds_deg);
  const middle = Math.max(0, Math.min(meta.bottom_level, meta.levels.length - 1) - 3);
  const [low, high] = await sampleRange(terrain, middle, rectangle);
  element('low').textContent = Math.round(low) + ' m';
  element('high').textContent = Math.round(high) + ' m';
  element('ramp').style.background =
      'linear-gradient(to right, ' + RAMP.map(([at, colour]) => colour + ' ' + 100 * at + '%').join(', ') + ')';

  globe.baseColor = Cesium.Color.fromCssColorString('#8fa7b3');
  globe.material = terrainMaterial(low, high, false);
  globe.depthTestAgainstTerrain = true;
  // Light from the upper left of the view, so that relief shows wherever the sun is.
  globe.enableLighting = true;
  globe.dynamicAtmosphereLighting = false;
  scene.fog.enabled = false;
  globe.showGroundAtmosphere = false;
  const light = new Cesium.DirectionalLight({direction: new Cesium.Cartesian3(1, 0, 0), intensity: 2.0});
  scene.light = light;
  scene.preRender.addEventListener(() => {
    const up = Cesium.Cartesian3.normalize(viewer.camera.positionWC, new Cesium.Cartesian3());
    const side = Cesium.Cartesian3.subtract(viewer.camera.upWC, viewer.camera.rightWC, new Cesium.Cartesian3());
    const from = Cesium.Cartesian3.add(up, Cesium.Cartesian3.multiplyByScalar(side, 0.8, side), side);
    Cesium.Cartesian3.negate(Cesium.Cartesian3.normalize(from, from), light.direction);
  });

  // Frames are drawn on request only; the last tiles to arrive want one too.
  globe.tileLoadProgressEvent.addEventListener(() => scene.requestRender());

  const home = () => viewer.camera.flyTo({destination: rectangle, duration: 0});
  home();
  element('home').onclick = (event) => {
    event.preventDefault();
    home();
    scene.requestRender();
  };

  element('wireframe').onchange = (event) => {
    globe._surface.tileProvider._debug.wireframe = event.target.checked;
    scene.requestRender();
  };
  let tileLayer;
  element('tiles').onchange = (event) => {
    if (event.target.checked) {
      tileLayer = viewer.imageryLayers.addImageryProvider(new Cesium.TileCoordinatesImageryProvider({
        tilingScheme: terrain.tilingScheme, color: Cesium.Color.fromCssColorString('#5a1010'),
      }));
      globe.material = undefined;
    } else if (tileLayer) {
      viewer.imageryLayers.remove(tileLayer);
      globe.material = terrainMaterial(low, high, element('contours').checked);
    }
    scene.requestRender();
  };
  element('contours').onchange = (event) => {
    if (!element('tiles').checked) globe.material = terrainMaterial(low, high, event.target.checked);
    scene.requestRender();
  };
  const bind = (id, apply) => {
    const update = () => {
      const value = Number(element(id).value);
      element(id + '-value').textContent = value;
      apply(value);
      scene.requestRender();
    };
    element(id).oninput = update;
    update();
  };
  bind('detail', (value) => { globe.maximumScreenSpaceError = value; });
  bind('exaggeration', (value) => { scene.verticalExaggeration = value; });

  const handler = new Cesium.ScreenSpaceEventHandler(scene.canvas);
  handler.setInputAction((movement) => {
    const ray = viewer.camera.getPickRay(movement.endPosition);
    const position = ray && globe.pick(ray, scene);
    if (!position) {
      element('cursor').textContent = '';
      return;
    }
    const point = Cesium.Cartographic.fromCartesian(position);
    const height = globe.getHeight(point);
    element('cursor').textContent =
        Cesium.Math.toDegrees(point.longitude).toFixed(5) + ' east, ' +
        Cesium.Math.toDegrees(point.latitude).toFixed(5) + ' north\n' +
        (height === undefined ? '' : height.toFixed(1) + ' m');
  }, Cesium.ScreenSpaceEventType.MOUSE_MOVE);
}

main().catch((error) => showError(String(error)));
