"use strict";

// Cameras as the run has them (OpenCV's: x right, y down, z forward; K in pixels) for three.js (y up, z backward).

// {position, quaternion} of three.js for a view.
function poseOf(view) {
  const m = view.world_from_camera;  // 3 rows of 4
  const matrix = new THREE.Matrix4().set(
    m[0], -m[1], -m[2], m[3],
    m[4], -m[5], -m[6], m[7],
    m[8], -m[9], -m[10], m[11],
    0, 0, 0, 1);
  return {
    position: new THREE.Vector3(m[3], m[7], m[11]),
    quaternion: new THREE.Quaternion().setFromRotationMatrix(matrix),
    matrix,
  };
}

// The direction that is up in a view's picture, in the world.
function upOf(view) {
  const m = view.world_from_camera;
  return new THREE.Vector3(-m[1], -m[5], -m[9]);
}

function meanUp(views) {
  const up = new THREE.Vector3();
  for (const view of views) up.add(upOf(view));
  if (up.length() < 1e-6 && views.length > 0) up.copy(upOf(views[0]));
  return up.length() > 0 ? up.normalize() : up.set(0, -1, 0);
}

// Where a view's picture lies on a screen of width x height when the eye is at its camera: {left, top, width, height}.
function pictureRectangle(view, width, height) {
  const margin = 0.94;
  const scale = margin * Math.min(width / view.width, height / view.height);
  return {
    left: (width - scale * view.width) / 2,
    top: (height - scale * view.height) / 2,
    width: scale * view.width,
    height: scale * view.height,
  };
}

// A lens is K in pixels of the screen: {fx, fy, cx, cy}. That of a view puts its picture into its rectangle, so that what lies
// around the picture is seen too.
function lensOf(view, width, height) {
  const place = pictureRectangle(view, width, height);
  const scale = place.width / view.width;
  return {fx: scale * view.fx, fy: scale * view.fy, cx: place.left + scale * view.cx, cy: place.top + scale * view.cy};
}

// For looking around: square pixels, the axis in the middle of the screen.
function freeLens(width, height) {
  const focal = 0.5 * Math.max(height, 0.75 * width) / Math.tan(25 * Math.PI / 180);
  return {fx: focal, fy: focal, cx: width / 2, cy: height / 2};
}

function lensBetween(a, b, share) {
  const focal = (from, to) => from * Math.pow(to / from, share);
  const middle = (from, to) => from + (to - from) * share;
  return {fx: focal(a.fx, b.fx), fy: focal(a.fy, b.fy), cx: middle(a.cx, b.cx), cy: middle(a.cy, b.cy)};
}

function poseBetween(a, b, share) {
  return {
    position: a.position.clone().lerp(b.position, share),
    quaternion: a.quaternion.clone().slerp(b.quaternion, share),
    lens: lensBetween(a.lens, b.lens, share),
  };
}

// OpenGL's projection of a lens: column fx X / -Z + cx and row -fy Y / -Z + cy of the screen become its clip coordinates.
function setProjection(camera, lens, width, height, near, far) {
  camera.projectionMatrix.set(
    2 * lens.fx / width, 0, 1 - 2 * lens.cx / width, 0,
    0, 2 * lens.fy / height, 2 * lens.cy / height - 1, 0,
    0, 0, (near + far) / (near - far), 2 * near * far / (near - far),
    0, 0, -1, 0);
  camera.projectionMatrixInverse.getInverse(camera.projectionMatrix);
}
