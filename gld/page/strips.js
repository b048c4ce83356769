"use strict";

// All views as strips; a click shows one above.

function noteOf(view) {
  if (view.psnr !== undefined) return decibelsText(view.psnr);
  if (view.expected !== undefined) return `about ${view.expected.toFixed(0)} dB expected`;
  if (view.carried) return "carried";
  return view.kept !== undefined ? `${shareText(view.kept)} photographs` : "";
}

function makeStrips(onSelect) {
  const cards = [];
  const root = element("div", {});
  for (const source of [true, false]) {
    const strip = element("div", {className: "strip"});
    page.views.forEach((view, i) => {
      if (isSource(view) !== source) return;
      const address = pictureAddress(view.picture) || pictureAddress(view.depth);
      if (address === null) return;
      const image = element("img", {src: address, alt: "", loading: "lazy"});
      image.style.aspectRatio = `${view.width} / ${view.height}`;
      const card = element("button", {type: "button", className: "card", title: view.name, "aria-pressed": "false"}, image,
        element("span", {className: "name"}, view.name), element("span", {className: "note"}, noteOf(view)));
      card.addEventListener("click", () => onSelect(i));
      cards[i] = card;
      strip.append(card);
    });
    if (strip.children.length === 0) continue;
    root.append(element("div", {className: "strip-title"}, element("span", {className: `swatch ${source ? "source" : "generated"}`}),
      source ? "Photographs that were given" : "New views"), strip);
  }
  const mark = (index) => cards.forEach((card, i) => card.setAttribute("aria-pressed", String(i === index)));
  return {root, mark};
}

// The section of pictures; `viewer` may be null.
function showPictures(main, viewer) {
  const pictured = page.views.map((view, i) => i).filter((i) => page.views[i].picture !== undefined || page.views[i].depth !== undefined);
  if (pictured.length === 0) {
    main.append(section("Picture by picture", "", element("p", {className: "sentence"}, "This run has no pictures: they were not asked for (--outputs image).")));
    return;
  }
  const goThere = viewer === null ? null : (index) => {
    viewer.holder.scrollIntoView({block: "center"});
    viewer.goTo(index);
  };
  const comparison = new Comparison((index) => strips.mark(index), goThere);
  const strips = makeStrips((index) => comparison.select(index));
  main.append(section("Picture by picture", "Move the slider between the two pictures; choose a view below.", comparison.root, strips.root));
  comparison.select(pictured.find((i) => !isSource(page.views[i])) ?? pictured[0]);
}
