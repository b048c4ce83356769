"use strict";

// The generated views one after the other, as a picture that turns: forth and back.

function showTurning(main) {
  const addresses = page.views.filter((view) => !isSource(view) && view.picture !== undefined).map((view) => pictureAddress(view.picture));
  if (addresses.length < 2) return;
  const image = element("img", {src: addresses[0], alt: "The generated views in turn", id: "turning"});
  const view = page.views.find((one) => !isSource(one) && one.picture !== undefined);
  image.style.aspectRatio = `${view.width} / ${view.height}`;
  let at = 0, step = 1, timer = null;
  const next = () => {
    if (at + step < 0 || at + step >= addresses.length) step = -step;
    at += step;
    image.src = addresses[at];
  };
  const switched = button("", "", () => run(timer === null));
  const run = (on) => {
    clearInterval(timer);
    timer = on ? setInterval(next, addresses.length > 12 ? 90 : 450) : null;
    switched.textContent = on ? "Stop" : "Turn";
  };
  run(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
  main.append(section("The new views in turn", "", element("div", {className: "turning"}, image, switched)));
}
