#!/usr/bin/env bash
# A picture of the page of a run of gld sample as a browser shows it: the verdict, the scene in 3D, the slider.
# Needs Debian's chromium, without a network and with WebGL in software, and Python 3 with Pillow and NumPy.
#   scripts/page_picture.sh RUN PICTURE.webp    RUN: a run folder of gld sample (its report.html)
set -euo pipefail
if [ $# -ne 2 ] || [ ! -f "$1/report.html" ]; then
  echo "page_picture: expected a run folder with report.html and the picture to write, found '$*'." >&2
  exit 1
fi
if ! command -v chromium >/dev/null || ! python3 -c 'import numpy, PIL' 2>/dev/null; then
  echo "page_picture: expected chromium and Python 3 with Pillow and NumPy, found them not; apt install chromium python3-pil python3-numpy." >&2
  exit 1
fi
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# Chromium's sandbox does not start as root. Time is the page's own: 20 s of it, in which the cloud is drawn and comes to rest.
flags=(--headless --disable-dev-shm-usage --use-angle=swiftshader --enable-unsafe-swiftshader --hide-scrollbars --window-size=1100,3000
  --virtual-time-budget=20000 --user-data-dir="$work/profile" --screenshot="$work/page.png")
if [ "$(id -u)" -eq 0 ]; then flags+=(--no-sandbox); fi
if ! timeout 300 chromium "${flags[@]}" "file://$(realpath "$1/report.html")" >"$work/log" 2>&1 || [ ! -s "$work/page.png" ]; then
  cat "$work/log" >&2
  echo "page_picture: expected a screenshot of $1/report.html, found none." >&2
  exit 1
fi

python3 - "$work/page.png" "$2" <<'PYTHON'
import os
import sys

import numpy
from PIL import Image

LEAST_HEIGHT, LEAST_GAP, MARGIN, MOST_BYTES = 400, 8, 24, 150000

page = Image.open(sys.argv[1]).convert("RGB")
pixels = numpy.asarray(page)
# Rows that hold something, in blocks: the scene in 3D and the slider are the two that are high. The picture ends below the second.
rows = (pixels != pixels[0, 0]).any(axis=(1, 2))
blocks, begin = [], None
for row in range(len(rows)):
    if rows[row]:
        begin, end = (row if begin is None else begin), row + 1
    elif begin is not None and not rows[row:row + LEAST_GAP].any():
        blocks.append((begin, end))
        begin = None
high = [block for block in blocks if block[1] - block[0] >= LEAST_HEIGHT]
if len(high) < 2:
    sys.exit(f"page_picture: expected the scene in 3D and the slider in the page, found blocks of rows {blocks}; is WebGL there?")
picture = page.crop((0, 0, page.width, high[1][1] + MARGIN))
quality = 90
while True:
    picture.save(sys.argv[2], quality=quality, method=6)
    size = os.stat(sys.argv[2]).st_size
    if size <= MOST_BYTES:
        break
    quality -= 5
    if quality < 50:
        sys.exit(f"page_picture: expected at most {MOST_BYTES} bytes, found {size} at quality {quality + 5}.")
print(f"page_picture: {sys.argv[2]}: {picture.width}x{picture.height}, {size} bytes, quality {quality}")
PYTHON
