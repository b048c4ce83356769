"use strict";

// The point cloud: taken out of the page (infer/page/page_cloud.h says how it is put in), and drawn as discs that are as large
// as the points are apart.

async function unpackedCloud(packed) {
  const bytes = await inflated(packed.bytes);
  const count = packed.count;
  const cloud = {
    count,
    low: packed.low,
    step: packed.step,
    shortest: packed.footprint,
    positions: new Uint16Array(3 * count),
    colours: new Uint8Array(3 * count),
    footprints: new Uint8Array(count),
    ranks: new Uint8Array(count),
  };
  let at = 0;
  for (let axis = 0; axis < 3; ++axis) at = takeDifferences16(bytes, at, count, cloud.positions, axis);
  for (let channel = 0; channel < 3; ++channel) at = takeDifferences8(bytes, at, count, cloud.colours, 3, channel);
  at = takeDifferences8(bytes, at, count, cloud.footprints, 1, 0);
  takeDifferences8(bytes, at, count, cloud.ranks, 1, 0);
  return cloud;
}

// Writes where point i of a cloud, or the centre of Gaussian i of splats, is in the page's world into `point`.
function pointOf(cloud, i, point) {
  return point.set(
    cloud.low[0] + cloud.step[0] * cloud.positions[3 * i],
    cloud.low[1] + cloud.step[1] * cloud.positions[3 * i + 1],
    cloud.low[2] + cloud.step[2] * cloud.positions[3 * i + 2]);
}

const kCloudVertices = `
  attribute vec3 colour;
  attribute float footprint;
  attribute float rank;
  uniform float shortest;   // the smallest footprint
  uniform float focal;      // of the camera, in pixels of the screen
  uniform float size;       // what the reader asks for
  uniform float least_rank;
  varying vec3 seen;
  varying float pixels;
  void main() {
    vec4 in_camera = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * in_camera;
    float length_of_one = shortest * exp2(footprint / 16.0);
    pixels = clamp(1.3 * size * focal * length_of_one / max(-in_camera.z, 1e-9), 1.5, 60.0);
    gl_PointSize = pixels;
    if (rank < least_rank) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    seen = colour;
  }`;

const kCloudFragments = `
  varying vec3 seen;
  varying float pixels;
  void main() {
    vec2 off = gl_PointCoord - 0.5;
    if (pixels > 6.0 && dot(off, off) > 0.32) discard;
    gl_FragColor = vec4(seen, 1.0);
  }`;

// The cloud as three.js draws it.
function makeCloudObject(cloud) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(cloud.positions, 3));
  geometry.setAttribute("colour", new THREE.BufferAttribute(cloud.colours, 3, true));
  geometry.setAttribute("footprint", new THREE.BufferAttribute(cloud.footprints, 1));
  geometry.setAttribute("rank", new THREE.BufferAttribute(cloud.ranks, 1));
  const material = new THREE.ShaderMaterial({
    vertexShader: kCloudVertices,
    fragmentShader: kCloudFragments,
    uniforms: {shortest: {value: cloud.shortest}, focal: {value: 1}, size: {value: 1}, least_rank: {value: 0}},
  });
  const points = new THREE.Points(geometry, material);
  points.position.fromArray(cloud.low);
  points.scale.fromArray(cloud.step);
  points.frustumCulled = false;
  return points;
}

// The middle of a cloud's points or of the Gaussians' centres: of each coordinate the median, so that few far ones do not move it; null
// without any.
function middleOfCloud(cloud) {
  if (cloud === null || cloud.count === 0) return null;
  const stride = Math.max(1, Math.floor(cloud.count / 20000));
  const middle = [0, 1, 2].map((axis) => {
    const values = [];
    for (let i = 0; i < cloud.count; i += stride) values.push(cloud.positions[3 * i + axis]);
    values.sort((a, b) => a - b);
    return cloud.low[axis] + cloud.step[axis] * values[values.length >> 1];
  });
  return new THREE.Vector3(...middle);
}

// The distances along a camera's axis of some points (or centres of Gaussians) in the middle of its picture, sorted.
function depthsInTheMiddle(cloud, view, camera_from_world) {
  const depths = [];
  const point = new THREE.Vector3();
  const stride = Math.max(1, Math.floor(cloud.count / 20000));
  for (let i = 0; i < cloud.count; i += stride) {
    pointOf(cloud, i, point).applyMatrix4(camera_from_world);
    const depth = -point.z;
    if (!(depth > 0)) continue;
    const across = Math.abs((view.fx * point.x / depth + view.cx) / view.width - 0.5);
    const down = Math.abs((-view.fy * point.y / depth + view.cy) / view.height - 0.5);
    if (across < 0.25 && down < 0.25) depths.push(depth);
  }
  return depths.sort((a, b) => a - b);
}

// The point (or the Gaussian's centre) under a place on the screen (in pixels from the middle of the screen, y down) that is nearest to
// the eye, of those whose number `counts`; null without one.
function pointUnder(cloud, counts, eye, x, y, width, height) {
  const screen_from_world = new THREE.Matrix4().multiplyMatrices(eye.projectionMatrix, eye.matrixWorldInverse);
  const point = new THREE.Vector3();
  const reach = 12;
  let best = null, best_distance = Infinity;
  for (let i = 0; i < cloud.count; ++i) {
    if (!counts(i)) continue;
    pointOf(cloud, i, point);
    const distance = point.distanceTo(eye.position);
    if (distance >= best_distance) continue;
    point.applyMatrix4(screen_from_world);
    if (point.z < -1 || point.z > 1) continue;
    if (Math.hypot(point.x * width / 2 - x, -point.y * height / 2 - y) > reach) continue;
    best_distance = distance;
    best = i;
  }
  return best === null ? null : pointOf(cloud, best, point).clone();
}
