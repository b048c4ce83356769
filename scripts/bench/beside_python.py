#!/usr/bin/env python3
"""One evaluation of the full-size M1 by the published Python and by gld, on this machine in one sitting.

    scripts/bench/beside_python.py --published CHECKOUT --python PYTHON --out RUN
      --published  a checkout of cvlab-kaist/Geometric-Latent-Diffusion, whose model is run as it is
      --python     a Python with PyTorch and what that model imports: timm, einops, transformers, omegaconf, regex
Both have random weights, the same sizes and threads, and run one after the other. What the environment says to OpenBLAS,
MKL, oneDNN and ATen is left out for both. The published call computes what gld prepares once a scene too (camera and time
embeddings, about a hundredth of its operations). Writes beside_python.md, beside_python.csv and report.json into RUN, which
must not be there yet, and leaves gld's own tables in RUN/gld_WIDTHxHEIGHT.
"""
import argparse
import csv
import io
import json
import os
import pathlib
import statistics
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
OURS_IN_PRECISION = ["bfloat16", "int8"]
PATCH = 14  # pixels


def environment():
    restrictions = ("OPENBLAS_", "MKL_", "ONEDNN_", "DNNL_", "ATEN_")
    return {name: value for name, value in os.environ.items() if not name.startswith(restrictions)}


def output_of(command):
    words = [str(word) for word in command]
    run = subprocess.run(words, env=environment(), stdout=subprocess.PIPE, text=True, cwd=ROOT)
    if run.returncode != 0:
        sys.exit(f"beside_python: {' '.join(words)} ended with {run.returncode}; its message is above.")
    return run.stdout


def size_of(text):
    width, _, height = text.partition("x")
    if not (width.isdigit() and height.isdigit() and int(width) % PATCH == 0 and int(height) % PATCH == 0):
        sys.exit(f"beside_python: --sizes: expected WIDTHxHEIGHT in multiples of {PATCH} pixels, found '{text}'; "
                 "write for example 252x140.")
    return int(width), int(height)


def published_rows(options, size):
    width, height = size_of(size)
    rows, about = [], {}
    for precision in ("float32", "bfloat16"):
        print(f"beside_python: the published model at {size} in {precision}", flush=True)
        about = json.loads(output_of(
            [options.python, ROOT / "scripts/bench/published_evaluation.py", "--published", options.published,
             "--precision", precision, "--views", options.views, "--sources", options.sources, "--width", width,
             "--height", height, "--repeats", options.repeats, "--threads", options.threads]).splitlines()[-1])
        seconds = about.pop("seconds")
        rows.append({"size": size, "program": "published", "precision": precision,
                     "seconds": statistics.median(seconds), "lowest": min(seconds), "highest": max(seconds)})
    return rows, about


def our_rows(options, size):
    print(f"beside_python: gld at {size}", flush=True)
    folder = options.out / f"gld_{size}"
    output_of([options.gld, "bench", "forward", "--quiet", "--no-composed", "--views", options.views,
               "--source-views", options.sources, "--size", size, "--precisions", ",".join(OURS_IN_PRECISION),
               "--repeats", options.repeats, "--threads", options.threads, "--out", folder])
    report = json.loads((folder / "report.json").read_text())
    with open(folder / "forward.csv", newline="") as file:
        parts = [row for row in csv.DictReader(file) if row["part"] == "evaluation"]
    rows = []
    for row in parts:
        rows.append({"size": size, "program": "gld",
                     "precision": "float32" if row["variant"] == "ours" else row["variant"],
                     **{name: float(row[name]) for name in ("seconds", "lowest", "highest", "relative_rms")}})
    return rows, report


def processor():
    for line in open("/proc/cpuinfo"):
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return "unknown"


def commit_of(checkout):
    run = subprocess.run(["git", "-C", checkout, "rev-parse", "HEAD"], stdout=subprocess.PIPE,
                         stderr=subprocess.DEVNULL, text=True)
    return run.stdout.strip() or "unknown"


def table_text(rows, options):
    columns = [("published", "float32"), ("published", "bfloat16")]
    columns += [("gld", precision) for precision in ["float32"] + OURS_IN_PRECISION]
    lines = ["| size | " + " | ".join(f"{program}, {precision}" for program, precision in columns) +
             " | gld bfloat16 over published bfloat16 | gld int8 over published bfloat16 |",
             "|---|" + "---:|" * (len(columns) + 2)]
    for size in options.sizes:
        seconds = {(row["program"], row["precision"]): row["seconds"] for row in rows if row["size"] == size}
        theirs = seconds["published", "bfloat16"]
        lines.append(f"| {size} | " + " | ".join(f"{seconds[column]:.3g}" for column in columns) +
                     f" | {theirs / seconds['gld', 'bfloat16']:.2f} times as fast"
                     f" | {theirs / seconds['gld', 'int8']:.2f} times as fast |")
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--published", type=pathlib.Path, required=True)
    parser.add_argument("--python", required=True)
    parser.add_argument("--gld", type=pathlib.Path, default=ROOT / "build/release/cli/gld")
    parser.add_argument("--sizes", default="252x140,504x280", type=lambda text: text.split(","))
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--sources", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    options = parser.parse_args()
    for name in ("published", "gld"):
        path = getattr(options, name)
        if not path.exists():
            parser.error(f"--{name}: expected a path that exists, found '{path}'")
    for size in options.sizes:
        size_of(size)
    if not 0 < options.sources < options.views:
        parser.error(f"--sources: expected 1 to {options.views - 1}, fewer than --views, found {options.sources}")
    if options.out.exists():
        parser.error(f"--out: expected a folder that is not there yet, found '{options.out}'")
    for name in ("published", "gld", "out"):
        setattr(options, name, getattr(options, name).resolve())
    if os.sep in options.python:  # not what it links to, which would leave its virtual environment
        options.python = os.path.abspath(options.python)
    options.out.mkdir(parents=True)

    rows, reports, about = [], {}, {}
    for size in options.sizes:
        published, about = published_rows(options, size)
        ours, reports[size] = our_rows(options, size)
        rows += published + ours
    columns = ["size", "program", "precision", "seconds", "lowest", "highest", "relative_rms"]
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    first = next(iter(reports.values()))
    text = "\n".join([
        "# Beside the published Python", "",
        f"Seconds of one evaluation of the full-size M1 with random weights, {options.views} views ({options.sources} sources), "
        f"medians of {options.repeats}; {options.threads} threads of an {processor()}; float32 peak "
        f"{first['multiply_add_peak'] * 1e-9:.0f} GFLOP/s.",
        f"Published: PyTorch {about['torch']}, {about['vectors']}, bfloat16 by autocast, as it is trained, with the weights "
        "cast before.",
        f"gld: {first['blas_in_words']}. The published call computes what gld prepares once a scene too, about a hundredth "
        "of its operations.",
        "`relative_rms` in beside_python.csv is the difference of the velocity from gld's in float32.", "",
        table_text(rows, options), ""])
    files = {"beside_python.csv": buffer.getvalue(), "beside_python.md": text,
             "report.json": json.dumps(
                 {"command": "scripts/bench/beside_python.py", "processor": processor(), "views": options.views,
                  "sources": options.sources, "threads": options.threads, "repeats": options.repeats,
                  "published_commit": commit_of(options.published), "published": about, "gld": reports, "rows": rows},
                 indent=1) + "\n"}
    for name, content in files.items():
        temporary = options.out / (name + ".tmp")
        temporary.write_text(content)
        temporary.rename(options.out / name)
    print(text)


if __name__ == "__main__":
    main()
