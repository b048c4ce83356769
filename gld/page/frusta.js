"use strict";

// Cameras as pyramids that carry their pictures.

const kFrustumColours = {source: 0x1763b6, generated: 0xc2570c};

// The corners of a view's picture at this distance before its camera, in three.js's axes: top left, top right, bottom right, bottom
// left.
function frustumCorners(view, distance) {
  const corner = (u, v) => new THREE.Vector3(
    (u - view.cx) / view.fx * distance, -(v - view.cy) / view.fy * distance, -distance);
  return [corner(0, 0), corner(view.width, 0), corner(view.width, view.height), corner(0, view.height)];
}

function makeFrustum(view, distance, onPicture) {
  const group = new THREE.Group();
  const pose = poseOf(view);
  group.position.copy(pose.position);
  group.quaternion.copy(pose.quaternion);
  const corners = frustumCorners(view, distance);
  const eye = new THREE.Vector3();
  const ends = [];
  for (let i = 0; i < 4; ++i) ends.push(eye, corners[i], corners[i], corners[(i + 1) % 4]);
  const lines = new THREE.BufferGeometry().setFromPoints(ends);
  const colour = isSource(view) ? kFrustumColours.source : kFrustumColours.generated;
  group.add(new THREE.LineSegments(lines, new THREE.LineBasicMaterial({color: colour})));

  const face = new THREE.BufferGeometry();
  const order = [0, 3, 2, 0, 2, 1];
  const places = [[0, 1], [1, 1], [1, 0], [0, 0]];
  face.setAttribute("position", new THREE.Float32BufferAttribute(order.flatMap((i) => corners[i].toArray()), 3));
  face.setAttribute("uv", new THREE.Float32BufferAttribute(order.flatMap((i) => places[i]), 2));
  const material = new THREE.MeshBasicMaterial({color: 0xffffff, side: THREE.DoubleSide});
  const picture = new THREE.Mesh(face, material);
  group.add(picture);
  const address = pictureAddress(view.picture);
  if (address === null) {
    material.color.set(colour);
    material.transparent = true;
    material.opacity = 0.15;
    material.depthWrite = false;
  } else {
    const image = new Image();
    image.onload = () => {
      const texture = new THREE.Texture(image);
      texture.minFilter = THREE.LinearFilter;  // sides are no powers of two
      texture.generateMipmaps = false;
      texture.needsUpdate = true;
      material.map = texture;
      material.needsUpdate = true;
      onPicture();
    };
    image.src = address;
  }
  return {group, picture};
}

// How deep frusta are drawn: half as far as a camera is from its nearest neighbour, within what the scene's depth lets one see.
function frustumDepth(views, sceneDepth) {
  const nearest = views.map((view, i) => {
    let least = Infinity;
    views.forEach((other, k) => {
      const distance = poseOf(view).position.distanceTo(poseOf(other).position);
      if (k !== i && distance > 1e-9 * sceneDepth) least = Math.min(least, distance);
    });
    return least;
  }).filter(Number.isFinite).sort((a, b) => a - b);
  const usual = nearest.length > 0 ? nearest[nearest.length >> 1] : Infinity;
  return Math.min(Math.max(0.5 * usual, 0.08 * sceneDepth), 0.14 * sceneDepth);
}
