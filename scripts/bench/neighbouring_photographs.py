#!/usr/bin/env python3
"""Whether one model makes more of real photographs than another: each photograph of six places from the one before and the one after.

    scripts/bench/neighbouring_photographs.py --models shipped=configs/tiny,next=runs/tiny/cascade/model --out TABLE.csv [--gld build/release/cli/gld]
        [--runs runs/neighbouring_photographs] [--evaluations 4]

The places are those of scripts/bench/photographs.py, known and fresh. One sample each, a row a photograph and model; an empty cell: nothing was carried,
or nothing was left unseen. At the end for each model the differences from the first one, with their standard error (photographs of one place
are not independent: read the places apart). RUNS keeps the evaluations, so that it goes on where it was stopped.
"""
import argparse
import collections
import csv
import json
import math
import pathlib
import statistics
import subprocess

from photographs import PLACES

COLUMNS = ["fill_psnr", "sample_psnr", "sample_psnr_unseen", "fill_psnr_unseen", "sample_sharpness"]


def measured(arguments, scene, first, model, run):
    """The means of that photograph's evaluation, or None behind the last photograph."""
    report = run / "report.json"
    if not report.is_file():
        made = subprocess.run([arguments.gld, "eval", "--model", model, "--scenes", scene, "--source-frames", f"{first},{first + 2}",
                               "--target-frames", str(first + 1), "--evaluations", str(arguments.evaluations), "--poses", "none", "--pictures", "0",
                               "--overwrite", "--out", str(run)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if made.returncode != 0:
            if "-frames: expected frames from" in made.stderr:
                return None
            raise SystemExit(made.stderr)
    means = json.loads(report.read_text())["means"]
    return [means[column]["mean"] for column in COLUMNS]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--models", required=True, help="NAME=BUNDLE,...; the first is what others are compared with")
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--runs", type=pathlib.Path, default=pathlib.Path("runs/neighbouring_photographs"))
    parser.add_argument("--evaluations", type=int, default=4)
    arguments = parser.parse_args()
    models = dict(model.split("=", 1) for model in arguments.models.split(","))
    rows = []
    for scene in dict.fromkeys(pathlib.Path(scenes, setting[1]) for scenes, _, settings in PLACES.values() for setting in settings):
        place = scene.name
        if not scene.exists():
            parser.error(f"expected the scene {scene}, found none; scripts/bench/photographs.py says where it comes from")
        first = 0
        while True:
            of_models = {name: measured(arguments, scene, first, bundle, arguments.runs / f"{place}_{first}_{name}") for name, bundle in models.items()}
            if None in of_models.values():
                break
            rows += [[place, f"{first},{first + 2}", first + 1, name, *values] for name, values in of_models.items()]
            first += 1
    with open(arguments.out, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["place", "sources", "target", "model", *COLUMNS])
        writer.writerows([*row[:4], *("" if value is None else f"{value:.4f}" for value in row[4:])] for row in rows)

    values = {(row[0], row[2], row[3]): row[4:] for row in rows}
    base = next(iter(models))
    for name in list(models)[1:]:
        differences = collections.defaultdict(list)
        for (place, target, model), numbers in values.items():
            if model != name:
                continue
            for column, new, old in zip(COLUMNS, numbers, values[place, target, base]):
                if new is not None and old is not None:
                    differences["all", column].append(new - old)
                    differences[place, column].append(new - old)
        for (place, column), found in differences.items():
            error = statistics.stdev(found) / math.sqrt(len(found)) if len(found) > 1 else float("nan")
            print(f"{name} over {base}, {place}, {column}: {statistics.mean(found):+.2f} (+- {error:.2f}), higher in {sum(value > 0 for value in found)} of {len(found)}")


if __name__ == "__main__":
    main()
