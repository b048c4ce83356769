#!/usr/bin/env python3
"""What the program makes of real photographs: gld eval on the scenes in ../shared, and one table of all.

    scripts/bench/photographs.py [--gld build/release/cli/gld] [--shared ../shared] [--out docs/measured/photographs]

Means over the target views of one sample each, not scaled to the truth. "fill" is what the photographs show, carried by the same
depth, with gaps filled smoothly and nothing generated; "generated" is the sample before photographs were kept in it.
"""
import argparse
import csv
import pathlib
import shutil
import subprocess

SETTINGS = [
    ("lund_door_2", "colmap_lund_door", "3,6", "4,5"),
    ("lund_door_4", "colmap_lund_door", "2,4,6,8", "3,5,7"),
    ("tartanair_2", "tartanair_hospital", "0,3", "1,2"),
    ("tartanair_4", "tartanair_hospital", "0,2,4,6", "1,3,5"),
    ("re10k_4", "gld_layout_5e040cd0758dcc96", "0,2,4,6", "1,3,5"),
    ("re10k_2", "gld_layout_5e040cd0758dcc96", "1,4", "2,3"),
]
COLUMNS = [
    ("nearest source", "psnr_nearest_source", "ssim_nearest_source"),
    ("generated", "generated_psnr", "generated_ssim"),
    ("fill", "fill_psnr", "fill_ssim"),
    ("sample", "sample_psnr", "sample_ssim"),
    ("sample, seen", "sample_psnr_seen", None),
    ("sample, unseen", "sample_psnr_unseen", None),
    ("fill, unseen", "fill_psnr_unseen", None),
]


def number(row, column):
    return float(row[column]) if column and row.get(column) else None


def cell(row, psnr, ssim):
    value = number(row, psnr)
    if value is None:
        return "-"
    also = number(row, ssim)
    return f"{value:.1f}" if also is None else f"{value:.1f} / {also:.2f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--shared", default="../shared")
    parser.add_argument("--out", default="docs/measured/photographs")
    arguments = parser.parse_args()
    out = pathlib.Path(arguments.out)
    lines = ["| setting | " + " | ".join(name for name, _, _ in COLUMNS) + " | sharpness |",
             "|---|" + "---|" * (len(COLUMNS) + 1)]
    for name, scene, sources, targets in SETTINGS:
        # A folder out of git is no run that --overwrite would replace: it has no .gld-run.
        shutil.rmtree(out / name, ignore_errors=True)
        subprocess.run([arguments.gld, "eval", "--model", "configs/tiny", "--scenes",
                        f"{arguments.shared}/scenes/{scene}", "--source-frames", sources, "--target-frames", targets,
                        "--pictures", "0", "--out", str(out / name)], check=True)
        shutil.rmtree(out / name / "scenes", ignore_errors=True)
        with open(out / name / "eval.csv", newline="") as file:
            row = next(csv.DictReader(file))
        sharpness = number(row, "sample_sharpness")
        lines.append(f"| {name} ({sources} -> {targets}) | " +
                     " | ".join(cell(row, psnr, ssim) for _, psnr, ssim in COLUMNS) + f" | {sharpness:.2f} |")
    table = "\n".join(lines) + "\n"
    (out / "table.md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
