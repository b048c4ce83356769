#!/usr/bin/env python3
"""Scenes a second of a training of M1, with its data: rooms drawn and encoded as it goes, and found in a folder.

    scripts/bench/training_speed.py [--gld build/release/cli/gld] [--steps 80] [--out docs/measured/training_speed]

M1 of configs/tiny by its own recipe, 8 scenes of 4 views of 112x112 a step, two workers of one thread each. The first run draws each
of 320 scenes and encodes it (and keeps them: --kept-scenes); the others find them there, in float32 and in bfloat16, and one of
each has them in memory as well. Medians of the lines of metrics.jsonl, ten steps each. Writes report.json.
"""
import argparse
import json
import pathlib
import statistics
import subprocess
import tempfile

LINE = 10  # steps


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--steps", type=int, default=80)
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("docs/measured/training_speed"))
    arguments = parser.parse_args()
    batches = 80  # of 4 scenes, two a step: they come again after 40 steps
    report = {"scenes_a_step": 8, "scenes_a_second": {}}
    with tempfile.TemporaryDirectory() as work:
        def run(name, steps, *options):
            out = pathlib.Path(work, name)
            subprocess.run([arguments.gld, "train", "level", "--config", "configs/tiny/level.yaml", "--model", "configs/tiny",
                            "--out", str(out), "--threads", "2", "--steps", str(steps), "--log-every", str(LINE),
                            "--kept-scenes", f"{work}/kept", "--loop.workers", "2", "--data.distinct-batches", str(batches),
                            "--data.validation-scenes", "0", *options], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
            report["scenes_a_second"][name] = statistics.median(line["samples_per_second"] for line in lines[1:])
        folder_alone = ["--objective.kept-latents-gib", "0"]
        run("drawn_and_encoded", batches // 2, *folder_alone)
        run("from_folder", arguments.steps, *folder_alone)
        run("from_folder_bfloat16", arguments.steps, *folder_alone, "--loop.precision", "bfloat16")
        # The first pass takes them from the folder, the others from memory.
        run("from_memory", arguments.steps, "--objective.kept-latents-gib", "1")
        run("from_memory_bfloat16", arguments.steps, "--objective.kept-latents-gib", "1", "--loop.precision", "bfloat16")
        kept = [file.stat().st_size for file in pathlib.Path(work, "kept").rglob("*.safetensors")]
        report["kept_bytes_a_scene"] = sum(kept) / (4 * batches)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "report.json").write_text(json.dumps(report, indent=2) + "\n")
    print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
