"use strict";

// What is under the scene in 3D, and how the scene is touched.

function listenToCanvas(viewer) {
  const {canvas} = viewer;
  let down = null;
  const placeOf = (event) => {
    const box = canvas.getBoundingClientRect();
    return {x: event.clientX - box.left - box.width / 2, y: event.clientY - box.top - box.height / 2, width: box.width, height: box.height};
  };
  const frustumUnder = (event) => {
    const {x, y, width, height} = placeOf(event);
    const ray = new THREE.Raycaster();
    ray.setFromCamera({x: 2 * x / width, y: -2 * y / height}, viewer.eye);
    const open = viewer.frusta.filter((frustum) => frustum.group.visible).map((frustum) => frustum.picture);
    const hits = ray.intersectObjects(open);
    return hits.length > 0 ? viewer.frusta.findIndex((frustum) => frustum.picture === hits[0].object) : -1;
  };
  const setPivotAt = (event) => {
    if (frustumUnder(event) >= 0) return;
    const {x, y, width, height} = placeOf(event);
    const point = viewer.pivotUnder(x, y, width, height);
    if (point !== null) viewer.setPivot(point);
  };
  // The wheel turns the page until the scene was touched.
  viewer.controls.enableZoom = false;
  canvas.addEventListener("focus", () => { viewer.controls.enableZoom = true; });
  canvas.addEventListener("blur", () => { viewer.controls.enableZoom = false; });
  let tapped = {time: -1e9, x: 0, y: 0};
  canvas.addEventListener("pointerdown", (event) => {
    canvas.focus({preventScroll: true});
    viewer.stop();
    down = {x: event.clientX, y: event.clientY};
  });
  canvas.addEventListener("pointerup", (event) => {
    const still = down && Math.hypot(event.clientX - down.x, event.clientY - down.y) < 5;
    down = null;
    if (!still || event.button > 0) return;
    const again = event.timeStamp - tapped.time < 350 && Math.hypot(event.clientX - tapped.x, event.clientY - tapped.y) < 24;
    tapped = {time: again ? -1e9 : event.timeStamp, x: event.clientX, y: event.clientY};
    if (again) {
      setPivotAt(event);
      return;
    }
    const hit = frustumUnder(event);
    if (hit >= 0) viewer.goTo(hit);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (event.buttons || event.pointerType === "touch") return;
    const hit = viewer.settled ? frustumUnder(event) : -1;
    canvas.classList.toggle("over-a-camera", hit >= 0);
    viewer.nameTag.textContent = hit >= 0 ? viewer.views[hit].name : "";
    const box = canvas.getBoundingClientRect();
    viewer.nameTag.style.left = `${event.clientX - box.left}px`;
    viewer.nameTag.style.top = `${event.clientY - box.top}px`;
  });
  canvas.addEventListener("pointerleave", () => { viewer.nameTag.textContent = ""; });
  canvas.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || !pressKey(viewer, event.key)) return;
    event.preventDefault();
  });
}

// Turns the orbit about its pivot, in degrees; nearer: what its distance is multiplied with.
function turnOrbit(viewer, right, up, nearer) {
  const {orbit, controls} = viewer;
  const offset = orbit.position.clone().sub(controls.target);
  const axis = orbit.up.clone().cross(offset).normalize();
  const tilt = offset.angleTo(orbit.up) - up * Math.PI / 180;
  offset.applyAxisAngle(orbit.up, right * Math.PI / 180);
  if (tilt > 0.02 && tilt < Math.PI - 0.02) offset.applyAxisAngle(axis.applyAxisAngle(orbit.up, right * Math.PI / 180), -up * Math.PI / 180);
  orbit.position.copy(controls.target).addScaledVector(offset, nearer);
}

// Returns whether the key means something.
function pressKey(viewer, key) {
  const turns = {ArrowLeft: [-5, 0, 1], ArrowRight: [5, 0, 1], ArrowUp: [0, 5, 1], ArrowDown: [0, -5, 1], "+": [0, 0, 0.9], "=": [0, 0, 0.9], "-": [0, 0, 1 / 0.9]};
  const count = viewer.views.length;
  if (key in turns) {
    viewer.stop();
    turnOrbit(viewer, ...turns[key]);
  } else if (key === "n" || key === "PageDown") {
    viewer.goTo((viewer.at + 1) % count);
  } else if (key === "p" || key === "PageUp") {
    viewer.goTo((Math.max(viewer.at, 0) + count - 1) % count);
  } else if (key === " ") {
    if (viewer.playing) viewer.stop(); else viewer.play();
  } else if (key === "Home" || key === "h") {
    viewer.overview();
  } else {
    return false;
  }
  return true;
}

function placeText(viewer) {
  if (viewer.playing) return "Along the path of the generated views";
  if (viewer.at < 0) return "";
  const view = viewer.views[viewer.at];
  return `${view.name}: ${isSource(view) ? "a photograph that was given" : "a new view"}`;
}

function makePanel(viewer) {
  const has = (source) => viewer.views.some((view) => isSource(view) === source);
  const kinds = element("span", {className: "group"});
  for (const [kind, text] of [["source", "Photographs"], ["generated", "New views"]]) {
    if (!has(kind === "source")) continue;
    const box = element("input", {type: "checkbox", checked: true, id: `show-${kind}`});
    box.addEventListener("change", () => viewer.show(kind, box.checked));
    kinds.append(element("label", {}, box, element("span", {className: `swatch ${kind}`}), text));
  }
  const play = button("Play the path", "The eye goes through the generated views (space)", () => {
    if (viewer.playing) viewer.stop(); else viewer.play();
  });
  play.id = "play";
  const views = element("span", {className: "group"},
    button("Overview", "From behind all cameras (h)", () => viewer.overview()),
    button("‹", "The view before (p)", () => pressKey(viewer, "p")),
    button("›", "The next view (n)", () => pressKey(viewer, "n")),
    viewer.views.length > 1 ? play : null);
  const fade = slider("Picture over cloud", {min: 0, max: 1, step: 0.01, value: 1, id: "fade"}, shareText, (value) => viewer.setFade(value));
  const panel = element("div", {className: "panel"}, views, kinds, fade);
  if (viewer.cloud && viewer.splats) {
    const box = element("input", {type: "checkbox", checked: true, id: "show-splats"});
    box.addEventListener("change", () => viewer.showSplats(box.checked));
    panel.append(element("label", {title: "Gaussians fitted to all views, in the place of the points"}, box, "Splats"));
  }
  if (viewer.cloud) {
    panel.append(
      slider("Point size", {min: -1.5, max: 2, step: 0.05, value: 0, id: "point-size"}, (value) => `× ${(2 ** value).toFixed(1)}`, (value) => viewer.setPointSize(2 ** value)),
      slider("Least sure points hidden", {min: 0, max: 0.95, step: 0.01, value: 0, id: "confidence"}, shareText, (value) => viewer.setConfidence(value)));
  }
  viewer.onChange(() => {
    viewer.place.textContent = placeText(viewer);
    play.textContent = viewer.playing ? "Stop" : "Play the path";
  });
  return panel;
}

// The section of the scene in 3D. Fills in what the browser can show, with a sentence for what it cannot.
async function showScene(main) {
  const hint = "Drag to turn, with the right button or two fingers to move; click the scene, then the wheel zooms. Click a camera to go there; double-click sets what the view turns about.";
  const place = element("div", {});
  main.append(section("In 3D", hint, place));
  const sentences = [];
  let cloud = null, splats = null;
  if (page.cloud.count > 0 || (page.splats && page.splats.count > 0)) {
    try {
      if (page.cloud.count > 0) cloud = await unpackedCloud(page.cloud);
      if (page.splats && page.splats.count > 0) splats = await unpackedSplats(page.splats);
    } catch (error) {
      sentences.push("This browser cannot unpack the cloud (it has no DecompressionStream), so it is left out; everything else is here.");
    }
  }
  if (page.cloud_note) sentences.push(page.cloud_note);
  const holder = element("div", {className: "viewer"});
  let viewer = null;
  if (cloud !== null || splats !== null || page.views.length > 0) {
    place.append(holder);
    try {
      viewer = new Viewer(holder, page.views, cloud, splats);
      const counted = (of, shown, what) => `${countText(shown)}${of > shown ? ` of ${countText(of)}` : ""} ${what}`;
      const counts = [];
      if (cloud !== null) counts.push(counted(page.cloud.of, cloud.count, "points"));
      if (splats !== null) counts.push(counted(page.splats.of, splats.count, "Gaussians"));
      if (counts.length > 0) holder.append(element("div", {className: "count"}, counts.join(", ")));
      place.append(makePanel(viewer));
    } catch (error) {
      holder.remove();
      sentences.unshift(error.message);
    }
  }
  for (const sentence of sentences) place.append(element("p", {className: "sentence", id: "no-cloud"}, sentence));
  return viewer;
}
