#!/usr/bin/env python3
"""Whether the unit that gld sample finds for depth of a real place has the true one in its 95 % interval: TartanAir's hospital, whose depth is known.

    scripts/bench/scale_intervals.py [--gld build/release/cli/gld] [--scene ../shared/scenes/tartanair_hospital] [--out docs/measured/scale_intervals]

Every two of its eight views are sources, and eight sets of three or four. The true unit is the median of true over predicted depth of the
source views, as the small model's head predicts it. Writes intervals.csv, a line a set, and report.json.
"""
import argparse
import csv
import itertools
import json
import pathlib
import subprocess
import tempfile

import numpy

SIDE = 112  # of the small model's pictures
FAR = 100  # metres: farther is sky
SETS = [*itertools.combinations(range(8), 2), (0, 2, 4), (1, 3, 5), (2, 4, 6), (3, 5, 7), (0, 3, 6), (1, 4, 7), (0, 2, 4, 6), (1, 3, 5, 7)]


def written_depth(path):
    with open(path, "rb") as file:
        file.readline()
        width, height = map(int, file.readline().split())
        order = "<f4" if float(file.readline()) < 0 else ">f4"
        return numpy.frombuffer(file.read(), order).reshape(height, width)[::-1]


def true_depth(path):
    """The middle square, sampled at the centres of SIDE pixels."""
    depth = numpy.load(path)
    height, width = depth.shape
    at = ((numpy.arange(SIDE) + 0.5) * height / SIDE).astype(int)
    return depth[:, (width - height) // 2:][numpy.ix_(at, at)]


def sampled(gld, scene, sources, folder, *options):
    target = next(view for view in range(8) if view not in sources)
    run = pathlib.Path(folder) / "run"
    subprocess.run([gld, "sample", "--model", "configs/tiny", "--scene", scene, "--sources", ",".join(map(str, sources)), "--targets",
                    str(target), "--outputs", "depth", "--evaluations", "2", "--quiet", "--overwrite", "--out", str(run), *options],
                   check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return run, json.loads((run / "report.json").read_text())


def row_of(gld, scene, sources):
    maps = sorted(pathlib.Path(scene, "depth_left").glob("*.npy"))
    with tempfile.TemporaryDirectory() as folder:
        # What the head alone says, in its own unit or that which was found for it.
        run, report = sampled(gld, scene, sources, folder, "--source-depth", "model", "--compose", "none")
        unit = (report.get("depth_scale") or {"scale": 1})["scale"]
        ratios = []
        for place, view in enumerate(sources):
            said, true = written_depth(run / f"depth/view_{place:02d}.pfm"), true_depth(maps[view])
            known = numpy.isfinite(said) & (said > 0) & (true < FAR)
            ratios.append(numpy.log(true[known] / said[known]))
        truth = unit * float(numpy.exp(numpy.median(numpy.concatenate(ratios))))
        found = sampled(gld, scene, sources, folder)[1].get("depth_scale")
    low, high = found["interval"] if found else (None, None)
    return {"sources": " ".join(map(str, sources)), "true": truth, "found": found["scale"] if found else None, "low": low, "high": high,
            "from": found["estimator"] if found else "", "holds": int(low <= truth <= high) if found else ""}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--scene", default="../shared/scenes/tartanair_hospital")
    parser.add_argument("--out", default="docs/measured/scale_intervals")
    options = parser.parse_args()
    rows = [row_of(options.gld, options.scene, sources) for sources in SETS]
    out = pathlib.Path(options.out)
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "intervals.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    known = [row for row in rows if row["found"] is not None]
    (out / "report.json").write_text(json.dumps({"sets": len(rows), "with_unit": len(known), "holds": sum(row["holds"] for row in known),
                                                 "within_a_third": sum(3 / 4 < row["found"] / row["true"] < 4 / 3 for row in known)},
                                                indent=2) + "\n")


if __name__ == "__main__":
    main()
