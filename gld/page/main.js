"use strict";

// Puts the page together. `gldPage` is for whoever looks at it from a console or a test.

window.gldPage = {ready: false, viewer: null};

async function showPage() {
  const main = document.getElementById("main");
  if (page.kind === "sample") {
    gldPage.viewer = await showScene(main);
    showPictures(main, gldPage.viewer);
    showTurning(main);
    showMaking(main);
  } else {
    showResults(main);
    showMaking(main);
  }
  gldPage.ready = true;
}

showPage();
