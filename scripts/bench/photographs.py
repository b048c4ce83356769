#!/usr/bin/env python3
"""What the program makes of real photographs: gld eval on scenes of real places, and one table of all.

    scripts/bench/photographs.py [--gld build/release/cli/gld] [--places known|fresh] [--source-depth fused] [--large [--side 448]]

known: ../shared/scenes, on which the matching's settings were chosen, into docs/measured/photographs. fresh: three places on which
nothing was chosen, not ours to hand on, into docs/measured/photographs_fresh: ../fresh_places holds registered_scene.py's scenes of
openMVG's ImageDataset_SceauxCastle (sceaux), Mapillary OpenSfM's data/berlin (berlin) and AliceVision's dataset_monstree (monstree,
those 17 that were at hand: images 1036 to 1057). Another depth than the default's goes into a folder DEPTH_depth of these.
--large: gld sample --size photographs in the place of gld eval, and pictures are compared as large as they are written; into a
folder large of these, with the contact sheet where a place may be shown (needs Pillow). --side N reduces photographs beforehand, to N pixels of their shorter side where they are larger, and
goes into a folder large_N with those settings whose photographs are and lie in a folder images*.

Means over the target views of one sample each, not scaled to the truth. "fill" is what the photographs show, carried by the same
depth, with gaps filled smoothly and nothing generated; "generated" is the sample before photographs were kept in it.
"""
import argparse
import csv
import json
import pathlib
import shutil
import subprocess
import tempfile

KNOWN = [
    ("lund_door_2", "colmap_lund_door", "3,6", "4,5"),
    ("lund_door_4", "colmap_lund_door", "2,4,6,8", "3,5,7"),
    ("tartanair_2", "tartanair_hospital", "0,3", "1,2"),
    ("tartanair_4", "tartanair_hospital", "0,2,4,6", "1,3,5"),
    ("re10k_4", "gld_layout_5e040cd0758dcc96", "0,2,4,6", "1,3,5"),
    ("re10k_2", "gld_layout_5e040cd0758dcc96", "1,4", "2,3"),
]
# Written down before the first of them was run.
FRESH = [
    ("sceaux_2", "sceaux", "4,6", "5"),
    ("sceaux_2_first", "sceaux", "0,2", "1"),
    ("sceaux_4", "sceaux", "2,4,6,8", "3,5,7"),
    ("berlin_2", "berlin", "0,2", "1"),
    ("monstree_2", "monstree", "0,2", "1"),
    ("monstree_3", "monstree", "8,10,12", "9,11"),
    ("monstree_4", "monstree", "0,2,4,6", "1,3,5"),
]
SHOWN = ("colmap_lund_door", "tartanair_hospital")
PLACES = {"known": ("../shared/scenes", "docs/measured/photographs", KNOWN),
          "fresh": ("../fresh_places", "docs/measured/photographs_fresh", FRESH)}
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


def reduced(scenes, settings, side, work):
    """Scenes with photographs of side pixels at their shorter side, below work, and the settings of those that had larger ones."""
    from PIL import Image
    kept = []
    for setting in settings:
        scene = pathlib.Path(scenes, setting[1])
        pictures = [file for file in scene.rglob("*") if file.suffix.lower() in (".jpg", ".png") and "images" in str(file.relative_to(scene))]
        if not pictures or min(Image.open(pictures[0]).size) <= side:
            continue
        kept.append(setting)
        copy = pathlib.Path(work, setting[1])
        if copy.is_dir():
            continue
        shutil.copytree(scene, copy)
        for file in pictures:
            picture = Image.open(file).convert("RGB")
            factor = side / min(picture.size)
            size = tuple(round(factor * length) for length in picture.size)
            picture.resize(size, Image.LANCZOS).save(copy / file.relative_to(scene), **({} if file.suffix.lower() == ".png" else {"quality": 97}))
    return kept


def large(gld, scenes, out, settings):
    """The table of pictures of the photographs' size, whose reports go into out."""
    columns = [("nearest source", "psnr_nearest_source"), ("sample", "psnr"), ("seen", "psnr_seen"), ("unseen", "psnr_unseen"), ("SSIM", "ssim"),
               ("sharpness", "sharpness")]
    lines = ["| setting | size | " + " | ".join(name for name, _ in columns) + " |", "|---|---|" + "---|" * len(columns)]
    for name, scene, sources, targets in settings:
        with tempfile.TemporaryDirectory() as work:
            run = pathlib.Path(work, name)
            subprocess.run([gld, "sample", "--model", "configs/tiny", "--scene", f"{scenes}/{scene}", "--sources", sources, "--targets", targets,
                            "--size", "photographs", "--outputs", "image", "--out", str(run)], check=True)
            (out / name).mkdir(parents=True, exist_ok=True)
            for file in ("report.json", "config.yaml"):
                (out / name / file).write_text((run / file).read_text().replace(f"{work}/", "runs/"))
            if scene in SHOWN:
                from PIL import Image
                Image.open(run / "contact_sheet.png").convert("RGB").save(out / name / "contact_sheet.webp", quality=80)
        # Photographs that are no larger than the model's pictures are compared in that size.
        views = [view.get("large", view) for view in json.loads((out / name / "report.json").read_text())["against_truth"]]

        def mean(column):
            values = [view[column] for view in views if column in view]
            return f"{sum(values) / len(values):.{2 if column in ('ssim', 'sharpness') else 1}f}" if values else "-"
        lines.append(f"| {name} ({sources} -> {targets}) | {views[0].get('width', '')}x{views[0].get('height', '')} | " +
                     " | ".join(mean(column) for _, column in columns) + " |")
    return lines


def evaluated(gld, scenes, out, settings, depth):
    """The table of gld eval, whose runs are made in out."""
    lines = ["| setting | " + " | ".join(name for name, _, _ in COLUMNS) + " | sharpness |",
             "|---|" + "---|" * (len(COLUMNS) + 1)]
    for name, scene, sources, targets in settings:
        # A folder out of git is no run that --overwrite would replace: it has no .gld-run.
        shutil.rmtree(out / name, ignore_errors=True)
        subprocess.run([gld, "eval", "--model", "configs/tiny", "--scenes",
                        f"{scenes}/{scene}", "--source-frames", sources, "--target-frames", targets,
                        "--pictures", "0", *depth, "--out", str(out / name)], check=True)
        shutil.rmtree(out / name / "scenes", ignore_errors=True)
        with open(out / name / "eval.csv", newline="") as file:
            row = next(csv.DictReader(file))
        sharpness = number(row, "sample_sharpness")
        lines.append(f"| {name} ({sources} -> {targets}) | " +
                     " | ".join(cell(row, psnr, ssim) for _, psnr, ssim in COLUMNS) + f" | {sharpness:.2f} |")
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--places", choices=PLACES, default="known")
    parser.add_argument("--source-depth", help="of gld eval, where not the default is measured")
    parser.add_argument("--large", action="store_true", help="pictures of the photographs' size, by gld sample")
    parser.add_argument("--side", type=int, help="of --large: pixels to which photographs are reduced beforehand")
    arguments = parser.parse_args()
    scenes, folder, settings = PLACES[arguments.places]
    out = pathlib.Path(folder)
    if arguments.large and arguments.source_depth:
        parser.error("expected --large or --source-depth, found both; leave out one")
    if arguments.side is not None and not arguments.large:
        parser.error("expected --side with --large, found it alone; add --large")
    if arguments.side is not None and arguments.side < 16:
        parser.error(f"expected a --side of 16 pixels or more, found {arguments.side}; choose the photographs' shorter side")
    if arguments.side is not None:
        out = out / f"large_{arguments.side}"
        with tempfile.TemporaryDirectory() as work:
            settings = reduced(scenes, settings, arguments.side, work)
            lines = large(arguments.gld, work, out, settings)
        for file in [*out.glob("*/report.json"), *out.glob("*/config.yaml")]:
            file.write_text(file.read_text().replace(f"{work}/", f"runs/photographs_of_{arguments.side}/"))
    elif arguments.large:
        out = out / "large"
        lines = large(arguments.gld, scenes, out, settings)
    elif arguments.source_depth:
        out = out / f"{arguments.source_depth}_depth"
        lines = evaluated(arguments.gld, scenes, out, settings, ["--photograph-use.source-depth", arguments.source_depth])
    else:
        lines = evaluated(arguments.gld, scenes, out, settings, [])
    table = "\n".join(lines) + "\n"
    (out / "table.md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
