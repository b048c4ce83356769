"use strict";

// Numbers of many things as planes of bytes (infer/page/packed_planes.h says how they are put in). Each function returns where the
// next plane begins.

// Differences of 16 bits with their sign in the lowest bit, low bytes first, back to values.
function takeDifferences16(bytes, start, count, values, axis) {
  let value = 0;
  for (let i = 0; i < count; ++i) {
    const folded = bytes[start + i] | (bytes[start + count + i] << 8);
    value = (value + (folded & 1 ? -((folded + 1) >> 1) : folded >> 1)) & 65535;
    values[3 * i + axis] = value;
  }
  return start + 2 * count;
}

function takeDifferences8(bytes, start, count, values, stride, offset) {
  let value = 0;
  for (let i = 0; i < count; ++i) {
    value = (value + bytes[start + i]) & 255;
    values[stride * i + offset] = value;
  }
  return start + count;
}
