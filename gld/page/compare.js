"use strict";

// One view at a time, beside what it can be compared with.

// What a view's picture can be compared with: {key, name, address}.
function counterparts(view) {
  const list = [];
  const add = (key, name, number) => {
    if (number !== undefined) list.push({key, name, address: pictureAddress(number)});
  };
  add("truth", "truth", view.truth);
  const nearest = view.nearest === undefined ? null : page.views[view.nearest];
  if (nearest !== null) add("nearest", "nearest photograph", nearest.picture);
  add("depth", "depth", view.depth);
  return list;
}

function factsOf(view) {
  const facts = [["Kind", isSource(view) ? "photograph, given" : view.carried ? "carried, nothing generated" : "generated"]];
  if (view.psnr !== undefined) facts.push(["PSNR", decibelsText(view.psnr)]);
  if (view.psnr === undefined && view.expected !== undefined) facts.push(["PSNR expected", `about ${view.expected.toFixed(0)} dB`]);
  if (view.ssim !== undefined) facts.push(["SSIM", view.ssim.toFixed(3)]);
  if (view.kept !== undefined) facts.push(["From photographs", shareText(view.kept)]);
  if (view.nearest !== undefined) facts.push(["Nearest photograph", page.views[view.nearest].name]);
  facts.push(["Size", `${view.width} × ${view.height}`], ["File", view.file]);
  return facts;
}

function depthLegend() {
  const {nearest, farthest, unit, colours} = page.depth;
  const bar = element("div", {className: "bar"});
  bar.style.background = `linear-gradient(to right, ${colours.join(", ")})`;
  const middle = Math.sqrt(nearest * farthest);
  return element("div", {className: "legend"}, bar,
    element("div", {className: "ends"}, ...[nearest, middle, farthest].map((depth) => element("span", {}, lengthText(depth, unit)))),
    element("div", {}, unit ? "Depth; grey is not known" : "Depth in the scene's unit; grey is not known"));
}

class Comparison {
  // onSelect is called with the number of the view that is shown; goThere with that of one to be seen in 3D (null: there is no 3D).
  constructor(onSelect, goThere) {
    this.onSelect = onSelect;
    this.goThere = goThere;
    this.right = element("img", {alt: ""});
    this.left = element("img", {alt: ""});
    this.input = element("input", {type: "range", min: 0, max: 100, step: 0.1, value: 50, id: "compare", "aria-label": "How much of the left picture is shown"});
    this.divider = element("div", {className: "divider"});
    this.leftName = element("span", {className: "side left"});
    this.rightName = element("span", {className: "side right"});
    this.stage = element("div", {className: "stage", id: "stage"}, this.right, this.left, this.input, this.divider, this.leftName, this.rightName);
    this.beside = element("div", {className: "beside"});
    this.root = element("div", {className: "comparison"}, this.stage, this.beside);
    this.input.addEventListener("input", () => this.move());
    this.choice = null;
  }

  move() {
    const share = Number(this.input.value);
    this.left.style.clipPath = `inset(0 ${100 - share}% 0 0)`;
    this.divider.style.left = `${share}%`;
  }

  select(index) {
    this.view = page.views[index];
    const view = this.view;
    this.stage.style.aspectRatio = `${view.width} / ${view.height}`;
    // No higher than a screen.
    this.stage.style.maxWidth = `calc(78vh * ${view.width / view.height})`;
    this.left.src = pictureAddress(view.picture) || pictureAddress(view.depth) || "";
    this.leftName.textContent = pictureAddress(view.picture) === null ? "depth" : isSource(view) ? "photograph" : "new view";
    const others = pictureAddress(view.picture) === null ? [] : counterparts(view);
    const chosen = others.find((other) => other.key === this.choice) || others[0];
    this.stage.classList.toggle("alone", chosen === undefined);
    const buttons = element("div", {className: "group"});
    for (const other of others) {
      const made = button(other.name, "", () => {
        this.choice = other.key;
        this.showRight(other, buttons);
      });
      made.dataset.key = other.key;
      buttons.append(made);
    }
    this.beside.replaceChildren(element("h3", {}, view.name), buttons, this.factList(view));
    if (this.goThere !== null) this.beside.append(button("Go to this camera in 3D", "", () => this.goThere(index)));
    if (page.depth && view.depth !== undefined) this.beside.append(depthLegend());
    if (chosen !== undefined) {
      this.input.value = this.input.value || 50;
      this.showRight(chosen, buttons);
      this.move();
    } else {
      this.left.style.clipPath = "none";
    }
    this.onSelect(index);
  }

  factList(view) {
    const list = element("dl", {});
    for (const [name, text] of factsOf(view)) list.append(element("dt", {}, name), element("dd", {}, text));
    return list;
  }

  showRight(other, buttons) {
    this.right.src = other.address;
    this.rightName.textContent = other.name;
    for (const one of buttons.children) one.setAttribute("aria-pressed", String(one.dataset.key === other.key));
  }
}
