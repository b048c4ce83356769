#!/usr/bin/env bash
# Makes the pictures that README.md and docs/ show, in docs/pictures; plots of measurements are made by their runs in docs/measured.
# Needs the built program, Python 3 with Pillow and NumPy, Debian's chromium, and the folder of shared data for the photographs of the
# Lund door. The picture of a run's page can be made alone: scripts/page_picture.sh.
#   scripts/pictures.sh [SHARED]    by default ../shared
set -euo pipefail
cd "$(dirname "$0")/.."
shared=${1:-../shared}
gld=build/release/cli/gld
model=configs/tiny
pictures=docs/pictures
work=runs/pictures

door=$shared/scenes/colmap_lund_door
if [ ! -d "$door" ]; then
  echo "pictures: expected the scene colmap_lund_door in $shared/scenes, found none; say where the shared data is." >&2
  exit 1
fi
if ! python3 -c 'import numpy, PIL' 2>/dev/null; then
  echo "pictures: expected Python 3 with Pillow and NumPy, found them not; apt install python3-pil python3-numpy." >&2
  exit 1
fi
if ! command -v chromium >/dev/null; then
  echo "pictures: expected chromium, found it not; scripts/setup.sh --testing installs it." >&2
  exit 1
fi
mkdir -p "$work" "$pictures"

# The room of scripts/demo.sh: the first of its seed. Two views between each two photographs, four together, as the model was trained.
"$gld" synth --seed 910000 --scene-count 1 --frames 12 --width 448 --height 448 --out "$work/scene" --overwrite
room=$(find "$work/scene" -name cameras.json -printf '%h\n' | sort | head -1)
"$gld" sample --model "$model" --scene "$room" --sources 0,3 --targets 1,2 --size photographs --overwrite --out "$work/room_1"
"$gld" sample --model "$model" --scene "$room" --sources 3,6 --targets 4,5 --size photographs --overwrite --out "$work/room_2"
scripts/page_picture.sh "$work/room_1" "$pictures/page.webp"

# Photographs of a real place: the setting lund_door_4 of docs/measured/photographs, at the photographs' size.
"$gld" sample --model "$model" --scene "$door" --sources 2,4,6,8 --targets 3,5,7 --size photographs --overwrite \
  --out "$work/door"

# Where it fails (the paper's appendix D.3): a shadow that has moved between the two photographs of the room, a ball that has, and
# cameras that leave both photographs.
python3 - "$room" "$work" <<'PYTHON'
import pathlib
import shutil
import sys

import numpy
from PIL import Image

room, work = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])


def changed(name, changes):
    folder = work / f"scene_{name}"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(room, folder)
    for frame, change in changes.items():
        file = folder / "images" / f"frame_{frame:05d}.png"
        pixels = change(numpy.asarray(Image.open(file).convert("RGB")).astype(float))
        Image.fromarray(pixels.clip(0, 255).astype("uint8")).save(file)


def grid(pixels):
    height, width = pixels.shape[:2]
    return (numpy.arange(width)[None, :] + 0.5) / width, (numpy.arange(height)[:, None] + 0.5) / height


def shadow(pixels):
    x, y = grid(pixels)
    return pixels * (1 - 0.55 / (1 + numpy.exp(-(x + 0.4 * y - 0.75) / 0.03)))[..., None]


def ball(centre_x, centre_y, radius):
    def drawn(pixels):
        x, y = grid(pixels)
        x, y = (x - centre_x) / radius, (y - centre_y) / radius
        distance = x * x + y * y
        inside = ((1 - numpy.sqrt(distance)) * radius * pixels.shape[1] + 0.5).clip(0, 1)[..., None]
        light = (0.35 + 0.65 * (0.7 * numpy.sqrt((1 - distance).clip(0, 1)) - 0.4 * x - 0.6 * y)).clip(0, 1)[..., None]
        return pixels * (1 - inside) + inside * light * numpy.array([235, 60, 150])

    return drawn


changed("light", {3: shadow})
changed("moved", {0: ball(0.56, 0.33, 0.085), 3: ball(0.33, 0.74, 0.1)})
changed("beyond", {})
PYTHON
for run in light moved; do
  "$gld" sample --model "$model" --scene "$work/scene_$run" --sources 0,3 --targets 1,2 --size photographs --overwrite --out "$work/$run"
done
"$gld" sample --model "$model" --scene "$work/scene_beyond" --sources 0,1 --targets 6,8 --size photographs --overwrite --out "$work/beyond"

# What the captions say of them comes from these runs.
for run in room_1 room_2 door light moved beyond; do
  mkdir -p "docs/measured/pictures/$run"
  cp "$work/$run/config.yaml" "$work/$run/report.json" "docs/measured/pictures/$run/"
done

# What each level says of a view (the paper's Figures 3 and 5): the sheet of gld eval, first room of the demo's seed.
"$gld" eval --model "$model" --synthetic 1 --synthetic-seed 910000 --pictures 1 --poses none --overwrite --out "$work/levels"

# What drawn rooms look like, plain, varied and photographic.
"$gld" synth --seed 910000 --scene-count 6 --frames 1 --width 224 --height 224 --out "$work/first" --overwrite
"$gld" synth --seed 910000 --scene-count 6 --frames 1 --width 224 --height 224 --rooms varied --out "$work/varied" --overwrite
"$gld" synth --seed 910000 --scene-count 6 --frames 1 --width 224 --height 224 --rooms photographic --out "$work/photographic" --overwrite

python3 - "$work" "$pictures" <<'PYTHON'
import pathlib
import sys

from PIL import Image, ImageDraw

work, pictures = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
GAP, FRAME, GIVEN = 6, 4, (224, 120, 32)


def strip(views, height, columns=None):
    """Pictures side by side; those that were given have a frame."""
    shown = []
    for file, given in views:
        picture = Image.open(file).convert("RGB")
        picture = picture.resize((round(picture.width * height / picture.height), height), Image.LANCZOS)
        if given:
            ImageDraw.Draw(picture).rectangle((0, 0, picture.width - 1, height - 1), outline=GIVEN, width=FRAME)
        shown.append(picture)
    columns = columns or len(shown)
    rows = -(-len(shown) // columns)
    width = max(picture.width for picture in shown)
    sheet = Image.new("RGB", (columns * (width + GAP) - GAP, rows * (height + GAP) - GAP), "white")
    for number, picture in enumerate(shown):
        sheet.paste(picture, (number % columns * (width + GAP), number // columns * (height + GAP)))
    return sheet


def view(folder, number):
    return work / folder / "images" / f"view_{number:02d}.png"


def save(picture, name, quality=82):
    picture.save(pictures / name, quality=quality, method=6)


def source(folder, number):
    return work / folder / "sources" / f"view_{number:02d}.png"


# Sources are the first views of a run, targets the others.
save(strip([(source("room_1", 0), True), (view("room_1", 2), False), (view("room_1", 3), False), (source("room_1", 1), True),
            (view("room_2", 2), False), (view("room_2", 3), False), (source("room_2", 1), True)], 240), "hero.webp")
given = [source("door", k) for k in range(4)]
made = [view("door", k) for k in (4, 5, 6)]
save(strip([(given[0], True), (made[0], False), (given[1], True), (made[1], False), (given[2], True), (made[2], False),
            (given[3], True)], 240), "lund_door.webp")
# A row each: two photographs, two views, their truth in the room as it was.
rows = []
for run, targets in (("light", (1, 2)), ("moved", (1, 2)), ("beyond", (6, 8))):
    true = [next((work / "scene").glob("scenes/*/images/")) / f"frame_{target:05d}.png" for target in targets]
    rows += [(source(run, 0), True), (source(run, 1), True), (view(run, 2), False), (view(run, 3), False)] + [(file, False) for file in true]
save(strip(rows, 200, 6), "failures.webp")
sheet = Image.open(work / "room_1" / "contact_sheet.png").convert("RGB")
sheet.thumbnail((1000, 1000), Image.LANCZOS)
save(sheet, "contact_sheet.webp")
sheet = Image.open(next((work / "levels" / "sheets").glob("*.png"))).convert("RGB")
sheet.thumbnail((1000, 1000), Image.LANCZOS)
save(sheet, "levels.webp")
rooms = [(file, False) for kind in ("first", "varied", "photographic") for file in sorted((work / kind).glob("scenes/*/images/*.png"))]
save(strip(rooms, 150, 6), "rooms.webp")
total = sum(file.stat().st_size for file in pictures.iterdir())
if total > 1000000:
    sys.exit(f"pictures: expected at most 1000000 bytes in {pictures}, found {total}; make them smaller.")
print(f"pictures: {total} bytes in {pictures}")
PYTHON
