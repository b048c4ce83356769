"use strict";

// The scene in 3D. Two cameras: `orbit` is what mouse, touch and keys move (three.js's OrbitControls); `eye` is what is drawn. They
// are the same while one looks around. At a view the eye has the view's pose and lens exactly, which an orbit cannot have (it has no
// roll, and a lens of its own); moving away carries the eye over to the orbit.

const kFlightSeconds = 0.9;
const kReleaseSeconds = 0.4;
const kSolidOpacity = 128;  // of 255: a Gaussian that is less opaque hides less than half of what is behind it

class Viewer {
  // Throws a sentence where the browser has no WebGL. `cloud` and `splats` may be null; with both, one of them is shown.
  constructor(holder, views, cloud, splats) {
    this.holder = holder;
    this.views = views;
    this.cloud = cloud;
    this.splats = splats;
    this.located = cloud || splats;  // what says where the scene is: points, in their absence the Gaussians' centres; null without both
    this.canvas = element("canvas", {tabIndex: 0, "aria-label": "The scene in 3D"});
    const attributes = {alpha: true, antialias: true, preserveDrawingBuffer: true};
    const context = this.canvas.getContext("webgl2", attributes) || this.canvas.getContext("webgl", attributes);
    if (!context) throw new Error("This browser shows no 3D (WebGL is switched off or missing), so the cloud is left out; everything else is here.");
    this.renderer = new THREE.WebGLRenderer({canvas: this.canvas, context});
    this.renderer.setClearColor(0x000000, 0);
    this.scene = new THREE.Scene();
    this.overlay = element("img", {className: "overlay", alt: ""});
    this.place = element("div", {className: "place"});
    this.nameTag = element("div", {className: "name-tag"});
    holder.append(this.canvas, this.overlay, this.place, this.nameTag);
    this.listeners = [];
    this.fade = 1;
    this.at = -1;          // the view that the eye is at
    this.held = null;      // a pose that the eye keeps until somebody moves it
    this.release = null;   // {from, start}: on the way from a held pose to the orbit's
    this.flight = null;    // {from, to, start, seconds, then}
    this.playing = null;   // {stops, place}
    this.measureScene();
    this.addObjects();
    this.makeControls();
    this.resize();
    this.overview(false);
    const tick = (now) => {
      this.tick(now);
      requestAnimationFrame(tick);
    };
    requestAnimationFrame(tick);
    new ResizeObserver(() => this.resize()).observe(holder);
    // A browser may take the graphics memory away (sleep, a driver that starts again); three.js fills it again, and nobody has moved.
    this.canvas.addEventListener("webglcontextrestored", () => this.changed());
  }

  // How far things are: of each view, and from the page's 0.
  measureScene() {
    this.poses = this.views.map(poseOf);
    this.radius = 1e-12;
    for (const pose of this.poses) this.radius = Math.max(this.radius, pose.position.length());
    const point = new THREE.Vector3();
    for (let i = 0; this.cloud && i < this.cloud.count; ++i) this.radius = Math.max(this.radius, pointOf(this.cloud, i, point).length());
    // Gaussians as well, since what lies beyond the far plane is not drawn; but the outermost hundredth may have gone astray anywhere, and
    // the near plane moves with the far one.
    if (this.splats && this.splats.count > 0) {
      const lengths = new Float32Array(this.splats.count);
      for (let i = 0; i < lengths.length; ++i) lengths[i] = pointOf(this.splats, i, point).length();
      lengths.sort();
      this.radius = Math.max(this.radius, lengths[lengths.length - 1 - Math.floor(lengths.length / 100)]);
    }
    this.depths = this.views.map((view, i) => {
      const depths = this.located ? depthsInTheMiddle(this.located, view, new THREE.Matrix4().getInverse(this.poses[i].matrix)) : [];
      return depths.length > 0 ? depths[depths.length >> 1] : this.radius;
    });
    const sorted = this.depths.slice().sort((a, b) => a - b);
    this.depth = sorted.length > 0 ? sorted[sorted.length >> 1] : this.radius;
  }

  addObjects() {
    if (this.cloud) {
      this.points = makeCloudObject(this.cloud);
      this.scene.add(this.points);
    }
    if (this.splats) {
      this.gaussians = new SplatObject(this.splats, this.views, this.poses);
      this.scene.add(this.gaussians.mesh);
      if (this.points) this.points.visible = false;
    }
    const distance = frustumDepth(this.views, this.depth);
    this.frusta = this.views.map((view) => {
      const frustum = makeFrustum(view, distance, () => this.changed());
      this.scene.add(frustum.group);
      return frustum;
    });
    this.shown = {source: true, generated: true};
    this.pivot = new THREE.AxesHelper(0.04 * this.depth);
    this.pivot.visible = false;
    this.scene.add(this.pivot);
  }

  makeControls() {
    this.eye = new THREE.PerspectiveCamera();
    this.eye.matrixAutoUpdate = true;
    this.orbit = new THREE.PerspectiveCamera(50, 1, 1, 2);
    this.orbit.up.copy(meanUp(this.views));
    const controls = new THREE.OrbitControls(this.orbit, this.canvas);
    controls.enableDamping = true;
    controls.dampingFactor = 0.15;
    controls.enableKeys = false;
    controls.screenSpacePanning = true;
    controls.minDistance = 1e-3 * this.depth;
    controls.maxDistance = 50 * this.radius;
    this.controls = controls;
    listenToCanvas(this);
  }

  // The size of the canvas in pixels of the page.
  get size() {
    return {width: Math.max(1, this.holder.clientWidth), height: Math.max(1, this.holder.clientHeight)};
  }

  get settled() {
    return !this.flight && !this.release && !this.playing;
  }

  onChange(listener) {
    this.listeners.push(listener);
  }

  tell() {
    for (const listener of this.listeners) listener(this);
  }

  changed() {
    this.dirty = true;
  }

  resize() {
    const {width, height} = this.size;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    this.renderer.setSize(width, height, false);
    this.orbit.aspect = width / height;
    this.orbit.updateProjectionMatrix();
    if (this.at >= 0) this.held = this.poseAt(this.at);
    else if (this.held) this.held = {...this.held, lens: freeLens(width, height)};
    this.placeOverlay();
    this.changed();
  }

  poseAt(index) {
    const {width, height} = this.size;
    return {...this.poses[index], lens: lensOf(this.views[index], width, height)};
  }

  poseOfOrbit() {
    const {width, height} = this.size;
    return {position: this.orbit.position.clone(), quaternion: this.orbit.quaternion.clone(), lens: freeLens(width, height)};
  }

  // What is drawn at this time.
  currentPose(now) {
    const eased = (share) => share * share * (3 - 2 * share);
    if (this.flight) {
      const share = Math.min(1, (now - this.flight.start) / (1000 * this.flight.seconds));
      const pose = poseBetween(this.flight.from, this.flight.to, eased(share));
      if (share === 1) this.arrive();
      return pose;
    }
    if (this.playing) return this.poseAlongPath();
    if (this.held) return this.held;
    const orbit = this.poseOfOrbit();
    if (!this.release) return orbit;
    const share = Math.min(1, (now - this.release.start) / (1000 * kReleaseSeconds));
    // The orbit goes on meanwhile: what is left of the difference is added to it.
    const difference = this.release.difference;
    const left = 1 - eased(share);
    orbit.quaternion.multiply(new THREE.Quaternion().slerp(difference, left));
    orbit.lens = lensBetween(orbit.lens, this.release.lens, left);
    if (share === 1) this.release = null;
    return orbit;
  }

  // Lets go of a held pose: the eye follows the orbit from here on. `start` is the orbit's orientation as it was held.
  letGo(now, start) {
    const held = this.held;
    this.release = {start: now, lens: held.lens, difference: start.clone().inverse().multiply(held.quaternion)};
    this.held = null;
    this.at = -1;
    this.showOverlay();
    this.tell();
  }

  // Puts the orbit where a pose is, about what the pose looks at.
  orbitFrom(pose, depth) {
    const forward = new THREE.Vector3(0, 0, -1).applyQuaternion(pose.quaternion);
    this.orbit.position.copy(pose.position);
    this.controls.target.copy(pose.position).addScaledVector(forward, depth);
    this.controls.update();
    this.orbit.lookAt(this.controls.target);
  }

  // What the reader set turning stops: an orbit that still swings would carry the eye away from where it arrives.
  stopSwing() {
    this.controls.enableDamping = false;
    this.controls.update();
    this.controls.enableDamping = true;
  }

  flyTo(pose, seconds, then) {
    this.stop();
    this.stopSwing();
    this.release = null;
    this.at = -1;
    this.showOverlay();
    this.flight = {from: this.lastPose || pose, to: pose, start: performance.now(), seconds, then};
    this.held = null;
    this.controls.enabled = false;
    this.tell();
    this.changed();
  }

  arrive() {
    const {to, then} = this.flight;
    this.flight = null;
    this.controls.enabled = true;
    this.held = to;
    then();
    this.tell();
  }

  goTo(index) {
    this.flyTo(this.poseAt(index), kFlightSeconds, () => {
      this.held = this.poseAt(index);
      this.orbitFrom(this.held, this.depths[index]);
      this.at = index;
      this.showOverlay();
    });
  }

  // From behind the cameras.
  overview(fly = true) {
    const eye = new THREE.Vector3(), forward = new THREE.Vector3();
    for (const pose of this.poses) {
      eye.addScaledVector(pose.position, 1 / this.poses.length);
      forward.add(new THREE.Vector3(0, 0, -1).applyQuaternion(pose.quaternion));
    }
    const up = this.orbit.up;
    if (forward.length() < 1e-3 * this.poses.length) forward.set(up.y, up.z, up.x).cross(up);
    forward.normalize();
    let spread = 0;
    for (const pose of this.poses) spread = Math.max(spread, pose.position.distanceTo(eye));
    // Between the cameras and what they look at.
    const seen = middleOfCloud(this.located) || eye.clone().addScaledVector(forward, this.depth);
    const target = eye.clone().lerp(seen, 0.75);
    const position = eye.clone().addScaledVector(forward, -0.95 * this.depth - 1.3 * spread).addScaledVector(up, 0.55 * this.depth);
    const camera = new THREE.PerspectiveCamera();
    camera.up.copy(up);
    camera.position.copy(position);
    camera.lookAt(target);
    const {width, height} = this.size;
    const pose = {position, quaternion: camera.quaternion.clone(), lens: freeLens(width, height)};
    this.flyTo(pose, fly ? kFlightSeconds : 1e-3, () => {
      this.orbit.position.copy(position);
      this.controls.target.copy(target);
      this.controls.update();
      this.held = null;
    });
  }

  // The point under a place on the screen that a reader can mean: none that is hidden, and no Gaussian that one sees through.
  pivotUnder(x, y, width, height) {
    if (!this.located) return null;
    const least = this.points ? this.points.material.uniforms.least_rank.value : 0;
    const counts = this.cloud ? (i) => this.cloud.ranks[i] >= least : (i) => this.splats.colours[4 * i + 3] >= kSolidOpacity;
    return pointUnder(this.located, counts, this.eye, x, y, width, height);
  }

  // About which the eye turns.
  setPivot(point) {
    const from = this.lastPose;
    const camera = new THREE.PerspectiveCamera();
    camera.up.copy(this.orbit.up);
    camera.position.copy(from.position);
    camera.lookAt(point);
    const {width, height} = this.size;
    this.pivot.position.copy(point);
    this.pivot.visible = true;
    this.flyTo({position: from.position.clone(), quaternion: camera.quaternion.clone(), lens: freeLens(width, height)}, 0.45, () => {
      this.orbit.position.copy(from.position);
      this.controls.target.copy(point);
      this.controls.update();
      this.held = null;
    });
  }

  // The generated views in turn, forth and back.
  play() {
    const generated = this.views.map((view, i) => i).filter((i) => !isSource(this.views[i]));
    const stops = generated.length > 1 ? generated : this.views.map((view, i) => i);
    if (stops.length < 2) return;
    this.flyTo(this.poseAt(stops[0]), kFlightSeconds, () => {
      this.playing = {stops, place: 0, step: 1, seconds: stops.length > 12 ? 0.3 : 1.1, before: performance.now()};
      this.held = null;
    });
  }

  poseAlongPath() {
    const {stops, place} = this.playing;
    const first = Math.min(Math.floor(place), stops.length - 2);
    return poseBetween(this.poseAt(stops[first]), this.poseAt(stops[first + 1]), place - first);
  }

  stop() {
    if (!this.playing) return;
    const pose = this.poseAlongPath();
    this.playing = null;
    this.held = pose;
    this.orbitFrom(pose, this.depth);
    this.tell();
  }

  advance(now) {
    const play = this.playing;
    const last = play.stops.length - 1;
    play.place += play.step * Math.min(0.1, (now - play.before) / 1000) / play.seconds;
    play.before = now;
    if (play.place > last) {
      play.place = last;
      play.step = -1;
    } else if (play.place < 0) {
      play.place = 0;
      play.step = 1;
    }
    this.tell();
  }

  tick(now) {
    const before = this.orbit.quaternion.clone();
    const moved = this.controls.update();
    if (this.held && moved && this.controls.enabled) this.letGo(now, before);
    if (this.playing) this.advance(now);
    const pose = this.currentPose(now);
    if (moved || this.flight || this.release || this.playing || this.dirty || pose !== this.lastPose && this.held) this.draw(pose);
    this.lastPose = pose;
  }

  draw(pose) {
    this.dirty = false;
    const {width, height} = this.size;
    this.eye.position.copy(pose.position);
    this.eye.quaternion.copy(pose.quaternion);
    const far = pose.position.length() + 1.5 * this.radius;
    setProjection(this.eye, pose.lens, width, height, 2e-5 * far, far);
    this.eye.updateMatrixWorld(true);
    if (this.points) {
      this.points.material.uniforms.focal.value = Math.sqrt(pose.lens.fx * pose.lens.fy) * this.renderer.getPixelRatio();
    }
    if (this.gaussians && this.gaussians.mesh.visible) {
      this.gaussians.prepare(this.eye, pose.lens, width, height, this.renderer.getPixelRatio());
    }
    this.frusta.forEach((frustum, i) => {
      const source = isSource(this.views[i]);
      const kind = source ? "source" : "generated";
      const away = pose.position.distanceTo(this.poses[i].position);
      // A camera's own picture would hide the cloud from it, as those of its neighbours do.
      frustum.group.visible = this.shown[kind] && this.at < 0 && away > 0.03 * this.depth && !(this.playing && !source);
    });
    this.pivot.visible = this.pivot.visible && !this.held;
    this.renderer.render(this.scene, this.eye);
  }

  placeOverlay() {
    if (this.at < 0) return;
    const {width, height} = this.size;
    const place = pictureRectangle(this.views[this.at], width, height);
    for (const side of ["left", "top", "width", "height"]) this.overlay.style[side] = `${place[side]}px`;
  }

  // The picture of the view that the eye is at, over the cloud.
  showOverlay() {
    const address = this.at >= 0 ? pictureAddress(this.views[this.at].picture) : null;
    if (address !== null && this.overlay.getAttribute("src") !== address) this.overlay.src = address;
    this.placeOverlay();
    this.overlay.style.opacity = address === null ? 0 : this.fade;
  }

  setFade(fade) {
    this.fade = fade;
    this.showOverlay();
  }

  show(kind, on) {
    this.shown[kind] = on;
    this.changed();
  }

  // Points or Gaussians, where there are both.
  showSplats(on) {
    this.gaussians.mesh.visible = on;
    this.points.visible = !on;
    this.changed();
  }

  setPointSize(size) {
    if (this.points) this.points.material.uniforms.size.value = size;
    this.changed();
  }

  // share: of the points, the least sure ones that are left out.
  setConfidence(share) {
    if (this.points) this.points.material.uniforms.least_rank.value = 255 * share;
    this.changed();
  }
}
