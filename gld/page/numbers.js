"use strict";

// Numbers as people read them.

function secondsText(seconds) {
  if (seconds < 0.095) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 99.5) return `${seconds.toPrecision(2)} s`;
  if (seconds < 5940) return `${Math.round(seconds / 60)} min`;
  return `${(seconds / 3600).toFixed(1)} h`;
}

function bytesText(bytes) {
  return bytes < 1e9 ? `${Math.round(bytes / 1e6)} MB` : `${(bytes / 1e9).toFixed(1)} GB`;
}

function decibelsText(decibels) {
  return `${decibels.toFixed(1)} dB`;
}

function shareText(share) {
  return `${Math.round(100 * share)} %`;
}

function countText(count) {
  return count.toLocaleString("en");
}

// Three digits that count, never as a power of ten where that is longer.
function lengthText(length, unit) {
  const text = length >= 1000 ? String(Math.round(length)) : String(Number(length.toPrecision(3)));
  return unit ? `${text} ${unit}` : text;
}
