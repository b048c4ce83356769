"use strict";

// What the program put into the page: docs/PAGE.md lists it.

const page = JSON.parse(document.getElementById("data").textContent);

// The address of a picture by its number; null without one.
function pictureAddress(number) {
  return number === undefined ? null : page.pictures[number];
}

function isSource(view) {
  return view.role === "source";
}

function bytesOfBase64(text) {
  const characters = atob(text);
  const bytes = new Uint8Array(characters.length);
  for (let i = 0; i < characters.length; ++i) bytes[i] = characters.charCodeAt(i);
  return bytes;
}

// The bytes behind base64 of zlib's format. Throws where the browser has no DecompressionStream.
async function inflated(text) {
  const stream = new Blob([bytesOfBase64(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
