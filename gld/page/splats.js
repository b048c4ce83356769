"use strict";

// 3D Gaussians: taken out of the page (infer/page/page_splats.h says how they are put in), sorted from the far to the near, and
// drawn as quadrilaterals around the ellipses that they are on the screen, one over the other.

async function unpackedSplats(packed) {
  const bytes = await inflated(packed.bytes);
  const count = packed.count;
  const positions = new Uint16Array(3 * count);
  const rest = new Uint8Array(11 * count);  // logarithms of axes, rotation, colour, opacity
  let at = 0;
  for (let axis = 0; axis < 3; ++axis) at = takeDifferences16(bytes, at, count, positions, axis);
  for (let i = 0; i < 11; ++i) at = takeDifferences8(bytes, at, count, rest, 11, i);
  const splats = {
    count,
    low: packed.low,
    step: packed.step,
    positions,  // the centres as a cloud has its points (cloud.js), for what asks either of them where the scene is
    centres: new Float32Array(3 * count),
    covariances: new Float32Array(6 * count),
    colours: new Uint8Array(4 * count),
  };
  const centre = new THREE.Vector3(), q = new THREE.Quaternion(), rotation = new THREE.Matrix4();
  for (let i = 0; i < count; ++i) {
    pointOf(splats, i, centre).toArray(splats.centres, 3 * i);
    const of = (k) => rest[11 * i + k];
    q.set(of(4) - 128, of(5) - 128, of(6) - 128, of(3) - 128).normalize();
    const e = rotation.makeRotationFromQuaternion(q).elements;  // column by column
    const squares = [0, 1, 2].map((axis) => Math.exp(2 * (packed.scale_low + packed.scale_step * of(axis))));
    const entry = (row, column) => {
      let sum = 0;
      for (let axis = 0; axis < 3; ++axis) sum += squares[axis] * e[4 * axis + row] * e[4 * axis + column];
      return sum;
    };
    splats.covariances.set([entry(0, 0), entry(0, 1), entry(0, 2), entry(1, 1), entry(1, 2), entry(2, 2)], 6 * i);
    for (let k = 0; k < 4; ++k) splats.colours[4 * i + k] = of(7 + k);
  }
  return splats;
}

const kBlur = 0.3;  // of a pixel's square, that every Gaussian on a screen has beside its own covariance (docs/SPLATS.md)

// What the blur of the pictures that Gaussians were fitted to is long in the world, at each of them: on a finer screen they would
// leave gaps without it. From the view that is nearest in pixels; 0 where none has it before it.
function blurLengths(splats, views, poses) {
  const lengths = new Float32Array(splats.count).fill(Infinity);
  poses.forEach((pose, k) => {
    const e = new THREE.Matrix4().getInverse(pose.matrix).elements;
    const pixel = Math.sqrt(kBlur) / Math.sqrt(views[k].fx * views[k].fy);
    for (let i = 0; i < splats.count; ++i) {
      const [x, y, z] = [splats.centres[3 * i], splats.centres[3 * i + 1], splats.centres[3 * i + 2]];
      const depth = -(e[2] * x + e[6] * y + e[10] * z + e[14]);
      if (depth > 0) lengths[i] = Math.min(lengths[i], depth * pixel);
    }
  });
  return lengths.map((length) => Number.isFinite(length) ? length : 0);
}

// The covariance on the screen is M S M^T with M the two rows of the lens's derivative times the turn into the camera, and the blur
// along both axes. Pixels count from the middle, up.
const kSplatVertices = `
  attribute vec3 centre;
  attribute vec3 covariance_above;  // xx xy xz
  attribute vec3 covariance_below;  // yy yz zz
  attribute vec4 colour;
  attribute float blur_length;
  uniform vec2 focal;   // in pixels of the screen
  uniform vec2 screen;  // its size in them
  varying vec4 seen;
  varying vec2 off;     // from the middle, in pixels
  varying vec3 inverse_covariance;
  void main() {
    vec4 in_camera = modelViewMatrix * vec4(centre, 1.0);
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    float depth = -in_camera.z;
    vec4 middle = projectionMatrix * in_camera;
    if (depth <= 0.0 || middle.z < -middle.w) return;
    // No wider than 30 % beyond the screen: the derivative is of no use there.
    vec2 most = 1.3 * screen / (2.0 * focal) + abs(vec2(projectionMatrix[2][0], projectionMatrix[2][1])) * screen / (2.0 * focal);
    vec2 slope = clamp(in_camera.xy / depth, -most, most);
    mat3 turn = mat3(modelViewMatrix);
    vec3 row_x = focal.x / depth * (vec3(turn[0][0], turn[1][0], turn[2][0]) + slope.x * vec3(turn[0][2], turn[1][2], turn[2][2]));
    vec3 row_y = focal.y / depth * (vec3(turn[0][1], turn[1][1], turn[2][1]) + slope.y * vec3(turn[0][2], turn[1][2], turn[2][2]));
    mat3 covariance = mat3(
      covariance_above.x, covariance_above.y, covariance_above.z,
      covariance_above.y, covariance_below.x, covariance_below.y,
      covariance_above.z, covariance_below.y, covariance_below.z);
    float of_pictures = sqrt(focal.x * focal.y) * blur_length / depth;
    float blur = max(${kBlur}, of_pictures * of_pictures);
    float xx = dot(row_x, covariance * row_x) + blur;
    float xy = dot(row_x, covariance * row_y);
    float yy = dot(row_y, covariance * row_y) + blur;
    float determinant = xx * yy - xy * xy;
    if (determinant <= 0.0 || colour.a < 1.0 / 255.0) return;
    inverse_covariance = vec3(yy, -xy, xx) / determinant;
    // Where it is seen at all: opacity times the bell is above 1/255.
    float reach = sqrt(2.0 * log(255.0 * colour.a));
    off = position.xy * reach * sqrt(vec2(xx, yy));
    gl_Position = vec4(middle.xyz / middle.w, 1.0);
    gl_Position.xy += 2.0 * off / screen;
    seen = colour;
  }`;

const kSplatFragments = `
  varying vec4 seen;
  varying vec2 off;
  varying vec3 inverse_covariance;
  void main() {
    float distance = inverse_covariance.x * off.x * off.x + 2.0 * inverse_covariance.y * off.x * off.y + inverse_covariance.z * off.y * off.y;
    float alpha = min(0.99, seen.a * exp(-0.5 * distance));
    if (alpha < 1.0 / 255.0) discard;
    gl_FragColor = vec4(seen.rgb * alpha, alpha);
  }`;

class SplatObject {
  constructor(splats, views, poses) {
    this.splats = splats;
    this.blurs = blurLengths(splats, views, poses);
    const geometry = new THREE.InstancedBufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array([-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, 1, 0]), 3));
    geometry.setIndex([0, 1, 2, 0, 2, 3]);
    const instanced = (name, values, each, normalised) => {
      const attribute = new THREE.InstancedBufferAttribute(values, each, normalised);
      geometry.setAttribute(name, attribute);
      return attribute;
    };
    const n = splats.count;
    this.attributes = {
      centre: instanced("centre", new Float32Array(3 * n), 3, false),
      above: instanced("covariance_above", new Float32Array(3 * n), 3, false),
      below: instanced("covariance_below", new Float32Array(3 * n), 3, false),
      colour: instanced("colour", new Uint8Array(4 * n), 4, true),
      blur: instanced("blur_length", new Float32Array(n), 1, false),
    };
    geometry.maxInstancedCount = geometry.instanceCount = n;  // older and newer three.js
    const material = new THREE.ShaderMaterial({
      vertexShader: kSplatVertices,
      fragmentShader: kSplatFragments,
      uniforms: {focal: {value: new THREE.Vector2(1, 1)}, screen: {value: new THREE.Vector2(1, 1)}},
      transparent: true,
      depthWrite: false,
      blending: THREE.CustomBlending,
      blendSrc: THREE.OneFactor,
      blendDst: THREE.OneMinusSrcAlphaFactor,
      blendSrcAlpha: THREE.OneFactor,
      blendDstAlpha: THREE.OneMinusSrcAlphaFactor,
    });
    this.mesh = new THREE.Mesh(geometry, material);
    this.mesh.frustumCulled = false;
    this.order = new Uint32Array(n);
    this.keys = new Uint16Array(n);
    this.sortedFor = null;
  }

  // For an eye with this lens, in pixels of the screen.
  prepare(eye, lens, width, height, ratio) {
    const uniforms = this.mesh.material.uniforms;
    uniforms.focal.value.set(lens.fx * ratio, lens.fy * ratio);
    uniforms.screen.value.set(width * ratio, height * ratio);
    this.sort(eye);
  }

  // From the far to the near, by 16 bits of the depth.
  sort(eye) {
    const e = eye.matrixWorldInverse.elements;
    const row = [e[2], e[6], e[10]];
    if (this.sortedFor !== null && row.every((value, i) => Math.abs(value - this.sortedFor[i]) < 1e-4)) return;  // a moved eye keeps the order
    this.sortedFor = row;
    const {count, centres, covariances, colours} = this.splats;
    let low = Infinity, high = -Infinity;
    const depths = new Float32Array(count);
    for (let i = 0; i < count; ++i) {
      const z = row[0] * centres[3 * i] + row[1] * centres[3 * i + 1] + row[2] * centres[3 * i + 2];
      depths[i] = z;
      if (z < low) low = z;
      if (z > high) high = z;
    }
    const scale = high > low ? 65535 / (high - low) : 0;
    const starts = new Uint32Array(65537);
    for (let i = 0; i < count; ++i) {
      this.keys[i] = (depths[i] - low) * scale;
      ++starts[this.keys[i] + 1];
    }
    for (let key = 0; key < 65536; ++key) starts[key + 1] += starts[key];
    for (let i = 0; i < count; ++i) this.order[starts[this.keys[i]]++] = i;
    const {centre, above, below, colour, blur} = this.attributes;
    for (let place = 0; place < count; ++place) {
      const i = this.order[place];
      blur.array[place] = this.blurs[i];
      for (let k = 0; k < 3; ++k) {
        centre.array[3 * place + k] = centres[3 * i + k];
        above.array[3 * place + k] = covariances[6 * i + k];
        below.array[3 * place + k] = covariances[6 * i + 3 + k];
      }
      for (let k = 0; k < 4; ++k) colour.array[4 * place + k] = colours[4 * i + k];
    }
    for (const attribute of Object.values(this.attributes)) attribute.needsUpdate = true;
  }
}
