#!/usr/bin/env python3
"""How much the frames of a path flicker, beside the truth's own: drawn rooms with exact depth.

    scripts/bench/flicker.py [--gld build/release/cli/gld] [--rooms 12] [--seed 31500] [--out docs/measured/flicker]

Of every room gld sample makes five views between two photographs, frames 3 to 7 between 2 and 8 of a path of 16. Each view is
carried into the next one by the room's true depth (bilinear colours); flicker is the mean absolute difference of the two over the pixels that
both show, from 0 to 1. The same of the true pictures is what a camera's own sampling leaves. Needs NumPy and Pillow. Writes report.json.
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import tempfile

import numpy
from PIL import Image

SOURCES, TARGETS = (2, 8), (3, 4, 5, 6, 7)
HIDDEN_BEHIND = 1.05  # depths over what a view shows at a place, to be hidden from it


def picture(file):
    return numpy.asarray(Image.open(file).convert("RGB"), dtype=float) / 255


def bilinear(values, x, y):
    """values (height, width, channels) at places that count from the first pixel's middle, inside the picture."""
    left, top = numpy.floor(x).astype(int), numpy.floor(y).astype(int)
    across, down = (x - left)[:, None], (y - top)[:, None]
    upper = values[top, left] * (1 - across) + values[top, left + 1] * across
    lower = values[top + 1, left] * (1 - across) + values[top + 1, left + 1] * across
    return upper * (1 - down) + lower * down


def flicker(first, second, first_frame, second_frame, first_depth, second_depth):
    """The first view, carried into the second one, beside it."""
    def intrinsics(frame):
        return numpy.array([[frame["fx"], 0, frame["cx"]], [0, frame["fy"], frame["cy"]], [0, 0, 1]])
    height, width = second_depth.shape
    columns, rows = numpy.meshgrid(numpy.arange(width) + 0.5, numpy.arange(height) + 0.5)
    rays = numpy.linalg.inv(intrinsics(second_frame)) @ numpy.stack([columns.ravel(), rows.ravel(), numpy.ones(width * height)])
    points = numpy.vstack([rays * second_depth.ravel(), numpy.ones(width * height)])
    first_from_second = numpy.linalg.inv(numpy.array(first_frame["world_from_camera"])) @ numpy.array(second_frame["world_from_camera"])
    seen = intrinsics(first_frame) @ (first_from_second @ points)[:3]
    known = (second_depth.ravel() > 0) & (seen[2] > 0)
    z = numpy.where(known, seen[2], 1)
    x, y = seen[0] / z - 0.5, seen[1] / z - 0.5
    known &= (x >= 0) & (y >= 0) & (x < width - 1) & (y < height - 1)
    x, y, z = x[known], y[known], z[known]
    shown = z <= HIDDEN_BEHIND * first_depth[numpy.rint(y).astype(int), numpy.rint(x).astype(int)]
    carried = bilinear(first, x[shown], y[shown])
    beside = second.reshape(-1, 3)[known][shown]
    return float(numpy.abs(carried - beside).mean())


def flicker_of(pictures, frames, depths):
    return statistics.mean(flicker(pictures[i], pictures[i + 1], frames[i], frames[i + 1], depths[i], depths[i + 1])
                           for i in range(len(pictures) - 1))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--rooms", type=int, default=12)
    parser.add_argument("--seed", type=int, default=31500)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("docs/measured/flicker"))
    arguments = parser.parse_args()
    rooms = []
    with tempfile.TemporaryDirectory() as work:
        subprocess.run([arguments.gld, "synth", "--seed", str(arguments.seed), "--scene-count", str(arguments.rooms), "--frames", "16",
                        "--out", f"{work}/drawn"], check=True, stdout=subprocess.DEVNULL)
        for scene in sorted(pathlib.Path(work, "drawn", "scenes").iterdir()):
            run = pathlib.Path(work, scene.name)
            subprocess.run([arguments.gld, "sample", "--model", "configs/tiny", "--scene", str(scene), "--sources", ",".join(map(str, SOURCES)),
                            "--targets", ",".join(map(str, TARGETS)), "--outputs", "image", "--quiet", "--out", str(run)], check=True,
                           stdout=subprocess.DEVNULL)
            all_frames = json.loads((scene / "cameras.json").read_text())["frames"]
            frames = [all_frames[i] for i in TARGETS]
            depths = [numpy.load(scene / frame["depth"]) for frame in frames]
            made = [picture(file) for file in sorted((run / "images").iterdir())]
            true = [picture(scene / frame["image"]) for frame in frames]
            ours, own = flicker_of(made, frames, depths), flicker_of(true, frames, depths)
            rooms.append({"room": scene.name, "flicker": ours, "of_the_truth": own})
            print(f"{scene.name}: {ours:.4f} beside {own:.4f}")
    means = {name: statistics.mean(room[name] for room in rooms) for name in ("flicker", "of_the_truth")}
    report = {"command": f"scripts/bench/flicker.py --rooms {arguments.rooms} --seed {arguments.seed}", **means,
              "ratio": means["flicker"] / means["of_the_truth"], "rooms": rooms}
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    print(f"{means['flicker']:.4f} beside {means['of_the_truth']:.4f}: {report['ratio']:.2f} times the truth's")


if __name__ == "__main__":
    main()
