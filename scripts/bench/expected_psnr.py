#!/usr/bin/env python3
"""How near the PSNR that gld sample expects of its views comes to what they have: the places of photographs.py, whose target views have a truth.

    scripts/bench/expected_psnr.py [--gld build/release/cli/gld] [--out docs/measured/expected_psnr]

Writes views.csv, a line a target view, and report.json: bias (expected less actual), RMS of the difference and correlation, over all views and
over those of places that nothing was chosen on. Without a setting whose photographs tell no depth: nothing is expected there.
"""
import argparse
import csv
import json
import pathlib
import statistics
import subprocess
import tempfile

import photographs


def views_of(gld, scenes, settings, place):
    for name, scene, sources, targets in settings:
        with tempfile.TemporaryDirectory() as folder:
            run = pathlib.Path(folder) / "run"
            subprocess.run([gld, "sample", "--model", "configs/tiny", "--scene", f"{scenes}/{scene}", "--sources", sources, "--targets",
                            targets, "--outputs", "image", "--quiet", "--out", str(run)], check=True, stdout=subprocess.DEVNULL)
            report = json.loads((run / "report.json").read_text())
        actual = {row["view"]: row["psnr"] for row in report["against_truth"]}
        for row in report.get("photographs", {}).get("kept", []):
            if "expected_psnr" in row:
                yield {"place": place, "setting": name, "view": row["view"], "from_photographs": row["share"],
                       "expected_psnr": row["expected_psnr"], "psnr": actual[row["view"]]}


def summary(rows):
    expected, actual = [row["expected_psnr"] for row in rows], [row["psnr"] for row in rows]
    off = [e - a for e, a in zip(expected, actual)]
    return {"views": len(rows), "bias": statistics.mean(off), "rms": statistics.mean(o * o for o in off) ** 0.5,
            "correlation": statistics.correlation(expected, actual)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--out", default="docs/measured/expected_psnr")
    arguments = parser.parse_args()
    rows = []
    for place, (scenes, _, settings) in photographs.PLACES.items():
        rows += views_of(arguments.gld, scenes, settings, place)
    out = pathlib.Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    with open(out / "views.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    report = {"command": "scripts/bench/expected_psnr.py", "all": summary(rows),
              "fresh": summary([row for row in rows if row["place"] == "fresh"])}
    (out / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
