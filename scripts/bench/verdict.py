#!/usr/bin/env python3
"""Whether what gld sample says of its pictures is so: its verdict beside the truth, on real scenes and drawn rooms.

    scripts/bench/verdict.py [--gld build/release/cli/gld] [--shared ../shared] [--rooms 8] [--out docs/measured/verdict]

A row a scene, best target views first: the PSNR of the target views, which the program is not told, and what it says: photographs
predicted from each other, the spread of its own depth beside what they agree on, its latents' distance from what it was trained on
(of the first generator, over what 99 of 100 training scenes stay below), and the verdict. Room folders keep report.json alone.
"""
import argparse
import json
import pathlib
import shutil
import subprocess

from photographs import SETTINGS

ROOM_SEED = 940000
ROOM_VIEWS = [("0,4", "2"), ("1,4,7", "3,5"), ("0,3,6,9", "2,7")]


def number(value, digits=1):
    return "-" if value is None else f"{value:.{digits}f}"


def mean(values):
    values = [value for value in values if value is not None]
    return sum(values) / len(values) if values else None


def row(name, report):
    verdict, left_out = report["verdict"], report.get("leave_one_out", [])
    usual = verdict.get("usual_latent_divergence")
    ratio = verdict["latent_divergence"][0] / usual[0] if usual else None
    psnr = mean([view["psnr"] for view in report["against_truth"]])
    return psnr, [name, number(psnr), number(mean([one["psnr"] for one in left_out])),
                  number(mean([one.get("psnr_covered") for one in left_out])),
                  number(mean([one["psnr_nearest_source"] for one in left_out])),
                  number(100 * mean([one["covered"] for one in left_out]), 0) + " %",
                  number(verdict.get("spread_of_model_depth"), 2), number(ratio, 2),
                  verdict["photographs"], "unlike" if verdict["unfamiliar"] else ""]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--shared", default="../shared")
    parser.add_argument("--rooms", type=int, default=8)
    parser.add_argument("--quality", default="options", help="of the samples: options, fast, ...")
    parser.add_argument("--out", default="docs/measured/verdict")
    arguments = parser.parse_args()
    out = pathlib.Path(arguments.out)
    out.mkdir(parents=True, exist_ok=True)
    work = out / "work"
    subprocess.run([arguments.gld, "synth", "--seed", str(ROOM_SEED), "--rooms", "varied", "--scene-count",
                    str(arguments.rooms), "--frames", "12", "--width", "112", "--height", "112", "--overwrite", "--quiet",
                    "--out", str(work / "rooms")], check=True)
    scenes = [(name, f"{arguments.shared}/scenes/{scene}", sources, targets)
              for name, scene, sources, targets in SETTINGS]
    for number_of, scene in enumerate(sorted((work / "rooms" / "scenes").iterdir())):
        sources, targets = ROOM_VIEWS[number_of % len(ROOM_VIEWS)]
        scenes.append((f"room_{number_of}_of_{len(sources.split(','))}", str(scene), sources, targets))
    rows = []
    for name, scene, sources, targets in scenes:
        subprocess.run([arguments.gld, "sample", "--model", "configs/tiny", "--scene", scene, "--sources", sources,
                        "--targets", targets, "--outputs", "image", "--quality", arguments.quality, "--overwrite", "--quiet",
                        "--out", str(work / name)], check=True)
        report = json.loads((work / name / "report.json").read_text())
        (out / f"{name}.json").write_text(json.dumps(report, indent=2) + "\n")
        rows.append(row(name, report))
    shutil.rmtree(work)
    head = ["scene", "targets, dB", "predicted, dB", "of what is covered", "nearest", "covered", "spread of own depth",
            "latents / usual", "photographs fit", "to the model"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(cells) + " |" for _, cells in sorted(rows, key=lambda entry: -entry[0])]
    table = "\n".join(lines) + "\n"
    (out / "table.md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
