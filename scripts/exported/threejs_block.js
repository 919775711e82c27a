// Renders the block of a job in three.js, lit by the exported module, and sends the pictures back.
//
// Environment maps cast no shadows in three.js. So the sky that three.js draws is read back, cut into cells of similar
// flux, and every cell is a DirectionalLight with a shadow map; their pictures are summed. Lamps are the module's own.
// The scene has Y up: torchlight's (x, y, z) is (x, z, -y) here.
import * as THREE from 'three';
import { STRENGTH, addEnvironment, addLamps } from '/export/light_threejs.js';

const SKY = 256; // pixels along a face's edge of the sky as drawn
const OVERSAMPLED = 4; // pixels along a sample's edge
const LIGHTS = 6; // with shadow maps, at once
const MOST = 1 / 500; // of the flux, in one cell, unless it is a pixel
const COARSEST = 16; // pixels along a cell's edge at first

const job = await (await fetch('/job.json')).json();
const renderer = new THREE.WebGLRenderer();
renderer.toneMapping = THREE.NoToneMapping;
renderer.shadowMap.enabled = true;
renderer.shadowMap.type = THREE.BasicShadowMap;

function toScene([x, y, z]) {
  return [x, z, -y];
}

function floatTarget(size) {
  return new THREE.WebGLRenderTarget(size, size, { type: THREE.FloatType });
}

// Returns what a camera sees, red, green, blue, alpha, lowest row first.
function picture(scene, camera, target) {
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const pixels = new Float32Array(4 * target.width * target.height);
  renderer.readRenderTargetPixels(target, 0, 0, target.width, target.height, pixels);
  return pixels;
}

function mesh(vertices, faces, material) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute('position', new THREE.Float32BufferAttribute(vertices.map(toScene).flat(), 3));
  geometry.setIndex(faces.flat());
  geometry.computeVertexNormals();
  return new THREE.Mesh(geometry, material);
}

function plane(material) {
  const h = job.width / 2;
  const made = mesh([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]], [[0, 1, 2], [0, 2, 3]], material);
  made.receiveShadow = true;
  return made;
}

function block() {
  const made = mesh(job.vertices, job.faces, new THREE.MeshBasicMaterial({ color: 0x000000, side: THREE.DoubleSide }));
  made.castShadow = true;
  return made;
}

function above() {
  const h = job.width / 2;
  const camera = new THREE.OrthographicCamera(-h, h, h, -h, 0.1, 20);
  camera.position.set(0, 10, 0);
  camera.up.set(0, 0, -1);
  camera.lookAt(0, 0, 0);
  return camera;
}

// Returns the mean of OVERSAMPLED x OVERSAMPLED pixels, red, green, blue, lowest row first.
function averaged(pixels) {
  const n = job.pixels;
  const wide = n * OVERSAMPLED;
  const mean = new Array(3 * n * n).fill(0);
  for (let i = 0; i < wide * wide; i += 1) {
    const place = Math.floor(Math.floor(i / wide) / OVERSAMPLED) * n + Math.floor((i % wide) / OVERSAMPLED);
    for (let c = 0; c < 3; c += 1) mean[3 * place + c] += pixels[4 * i + c] / OVERSAMPLED ** 2;
  }
  return mean;
}

// Returns the sky over the plane as three.js draws it: direction, solid angle and radiance of every pixel, by face.
function drawnSky(scene) {
  const target = floatTarget(SKY);
  const camera = new THREE.PerspectiveCamera(90, 1, 0.1, 10);
  const views = [[[0, 1, 0], [0, 0, 1]], [[1, 0, 0], [0, 1, 0]], [[-1, 0, 0], [0, 1, 0]], [[0, 0, 1], [0, 1, 0]], [[0, 0, -1], [0, 1, 0]]];
  return views.map(([forward, up]) => {
    camera.up.set(...up);
    camera.lookAt(...forward);
    camera.updateMatrixWorld();
    const pixels = picture(scene, camera, target);
    return Array.from({ length: SKY * SKY }, (_, i) => {
      const x = (2 * (i % SKY) + 1) / SKY - 1;
      const y = (2 * Math.floor(i / SKY) + 1) / SKY - 1;
      const direction = new THREE.Vector3(x, y, -1).transformDirection(camera.matrixWorld);
      const angle = (2 / SKY) ** 2 / (1 + x * x + y * y) ** 1.5;
      const radiance = [pixels[4 * i], pixels[4 * i + 1], pixels[4 * i + 2]];
      return { direction, angle: direction.y > 0 ? angle : 0, radiance };
    });
  });
}

function cell(face, left, bottom, size) {
  const sum = { power: [0, 0, 0], towards: new THREE.Vector3(), flux: 0, left, bottom, size, face };
  for (let row = bottom; row < bottom + size; row += 1) {
    for (let column = left; column < left + size; column += 1) {
      const { direction, angle, radiance } = face[row * SKY + column];
      const weight = angle * (0.2126 * radiance[0] + 0.7152 * radiance[1] + 0.0722 * radiance[2]);
      sum.towards.addScaledVector(direction, weight);
      sum.flux += weight * direction.y;
      radiance.forEach((value, c) => { sum.power[c] += value * angle; });
    }
  }
  sum.towards.normalize();
  return sum;
}

function quarters({ face, left, bottom, size }) {
  const half = size / 2;
  return [[0, 0], [half, 0], [0, half], [half, half]].map(([x, y]) => cell(face, left + x, bottom + y, half));
}

// Returns cells of the sky, none with much more than its share of the flux.
function cells(sky) {
  let waiting = [];
  for (const face of sky) {
    for (let y = 0; y < SKY; y += COARSEST) {
      for (let x = 0; x < SKY; x += COARSEST) waiting.push(cell(face, x, y, COARSEST));
    }
  }
  const total = waiting.reduce((sum, it) => sum + it.flux, 0);
  const done = [];
  while (waiting.length > 0) {
    const next = [];
    for (const it of waiting) {
      if (it.size > 1 && it.flux > MOST * total) next.push(...quarters(it));
      else if (it.flux > 0) done.push(it);
    }
    waiting = next;
  }
  return done;
}

function skyLight() {
  const light = new THREE.DirectionalLight();
  const reach = 3;
  light.castShadow = true;
  light.shadow.mapSize.set(1024, 1024);
  Object.assign(light.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, far: 12 });
  return light;
}

// Returns the plane, with the block's shadow, under the sky that three.js draws.
function underSky(sky, hasBlock) {
  const scene = new THREE.Scene();
  scene.add(plane(new THREE.MeshLambertMaterial({ color: 0xffffff })));
  if (hasBlock) scene.add(block());
  const lights = Array.from({ length: LIGHTS }, skyLight);
  scene.add(...lights);
  const target = floatTarget(job.pixels * OVERSAMPLED);
  const sum = new Float32Array(4 * target.width * target.height);
  const all = cells(sky);
  for (let start = 0; start < all.length; start += LIGHTS) {
    lights.forEach((light, i) => {
      const it = all[start + i];
      light.intensity = it === undefined ? 0 : 1;
      if (it === undefined) return;
      light.color.setRGB(...it.power);
      light.position.copy(it.towards).multiplyScalar(6);
    });
    const pixels = picture(scene, above(), target);
    for (let i = 0; i < sum.length; i += 1) sum[i] += pixels[i];
  }
  return { pixels: averaged(sum), cells: all.length };
}

// Returns the plane under the module's own lamps.
function underLamps(wanted, hasBlock) {
  const scene = new THREE.Scene();
  scene.add(plane(new THREE.MeshLambertMaterial({ color: 0xffffff })));
  if (hasBlock) scene.add(block());
  addLamps(scene, 'Y', 3).forEach((light, i) => {
    light.shadow.mapSize.set(2048, 2048);
    if (wanted !== null && !wanted.includes(i + 1)) scene.remove(light);
  });
  return averaged(picture(scene, above(), floatTarget(job.pixels * OVERSAMPLED)));
}

// Returns the empty plane under three.js' own environment lighting, which casts no shadow.
function underEnvironment(texture) {
  const scene = new THREE.Scene();
  scene.environment = texture;
  scene.environmentIntensity = STRENGTH;
  scene.add(plane(new THREE.MeshPhysicalMaterial({ color: 0xffffff, roughness: 1, specularIntensity: 0 })));
  return averaged(picture(scene, above(), floatTarget(job.pixels * OVERSAMPLED)));
}

// Returns the largest difference between the sky of a scene with Y up and that of one that keeps Z up, turned.
async function differenceOfUp(sky) {
  const scene = new THREE.Scene();
  await addEnvironment(scene, 'Z');
  const camera = new THREE.PerspectiveCamera(90, 1, 0.1, 10);
  camera.up.set(0, -1, 0); // looks at the zenith as the first view of `drawnSky` does
  camera.lookAt(0, 0, 1);
  const pixels = picture(scene, camera, floatTarget(SKY));
  const brightest = sky[0].reduce((most, it) => Math.max(most, ...it.radiance), 0);
  const differences = sky[0].map((it, i) => Math.max(...it.radiance.map((value, c) => Math.abs(value - pixels[4 * i + c]))));
  differences.sort((a, b) => a - b);
  return { most: differences.at(-1) / brightest, median: differences[differences.length / 2] / brightest };
}

async function send(result) {
  await fetch('/result', { method: 'POST', body: JSON.stringify(result) });
}

try {
  const scene = new THREE.Scene();
  const texture = await addEnvironment(scene);
  const sky = drawnSky(scene);
  const shots = job.shots.map((shot) => {
    if (!shot.picture) return { out: shot.out, pixels: underLamps(shot.lamps, shot.block) };
    const lit = underSky(sky, shot.block);
    underLamps(shot.lamps, shot.block).forEach((value, i) => { lit.pixels[i] += value; });
    return { out: shot.out, ...lit };
  });
  const irradiance = [0, 1, 2].map((c) => sky.flat().reduce((sum, it) => sum + it.radiance[c] * it.angle * it.direction.y, 0));
  const up = await differenceOfUp(sky);
  await send({ version: THREE.REVISION, shots, sky_irradiance: irradiance, own: underEnvironment(texture), up });
} catch (error) {
  await send({ error: `${error}\n${error.stack}` });
}
