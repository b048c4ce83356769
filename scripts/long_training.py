#!/usr/bin/env python3
"""Trains a very small M1 for many steps twice, once in one go and once killed with SIGKILL every now and then.

    scripts/long_training.py OUT [--steps 20000] [--gld build/release/cli/gld] [--seconds 20 120] [--seed 1]

Both must end with the same bytes, and the memory of the first must not grow. OUT/record.json holds what happened (steps, kills and
the step that each resumed from, memory by step, SHA-256 of the model); the exit status is 1 where something did not hold. An OUT
with parts of an earlier call goes on from them.
"""
import argparse
import hashlib
import json
import os
import pathlib
import random
import re
import shutil
import signal
import subprocess
import sys
import time

# Memory after the first tenth may grow by so much: the allocator's own moves.
MOST_GROWTH = 1.05


def small_bundle(source: pathlib.Path, folder: pathlib.Path) -> None:
    """The shipped backbone with an M1 of a few thousand weights."""
    if folder.exists():
        return
    making = folder.with_name(folder.name + ".partial")
    shutil.rmtree(making, ignore_errors=True)
    making.mkdir(parents=True)
    for name in ("backbone", "dpt_head", "statistics_level0", "statistics_level1"):
        shutil.copy(source / f"{name}.safetensors", making)
    text = (source / "model.yaml").read_text()
    for old, new in (
        ("hidden_size: [160, 256]", "hidden_size: [32, 64]"),
        ("depth: [3, 3]", "depth: [1, 1]"),
        ("num_heads: [4, 4]\n  mlp_ratio: 3", "num_heads: [2, 2]\n  mlp_ratio: 2"),
    ):
        if old not in text:
            sys.exit(f"long_training: expected '{old}' in {source}/model.yaml, found none; mend this script.")
        text = text.replace(old, new, 1)
    (making / "model.yaml").write_text(text)
    making.rename(folder)


def resident_bytes(process: subprocess.Popen) -> int:
    try:
        status = pathlib.Path(f"/proc/{process.pid}/status").read_text()
    except OSError:
        return 0
    found = re.search(r"VmRSS:\s*(\d+) kB", status)
    return int(found.group(1)) * 1024 if found else 0


def newest_step(run: pathlib.Path) -> int:
    steps = [int(file.stem.split("_")[1]) for file in run.glob("checkpoints/step_*.safetensors")]
    return max(steps, default=0)


def logged_step(run: pathlib.Path) -> int:
    try:
        lines = (run / "metrics.jsonl").read_text().splitlines()
    except OSError:
        return 0
    return next((json.loads(line)["step"] for line in reversed(lines) if line.endswith("}")), 0)


def hashes(run: pathlib.Path) -> dict:
    return {
        str(file.relative_to(run)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in sorted(run.glob("model/*.safetensors"))
    }


class Training:
    def __init__(self, options, model: pathlib.Path):
        self.command = [
            options.gld, "train", "level", "--model", str(model), "--steps", str(options.steps), "--threads", "1",
            "--loop.seed", str(options.seed), "--views", "3", "--most-sources", "2",
            "--distinct-batches", "16", "--kept-latents-gib", "1", "--loop.micro-batches", "1", "--loop.workers", "1",
            "--batch-size", "1", "--loop.checkpoint-every", "200", "--loop.validate-every", "500", "--validation-scenes", "2",
            "--log-every", "50",
        ]

    def start(self, run: pathlib.Path) -> subprocess.Popen:
        how = ["--resume"] if newest_step(run) else ["--overwrite"]
        run.parent.mkdir(parents=True, exist_ok=True)
        log = open(run.with_name(run.name + ".log"), "ab")
        return subprocess.Popen([*self.command, "--out", str(run), *how], stdout=log, stderr=log)


def ended_well(process: subprocess.Popen, run: pathlib.Path) -> None:
    if process.returncode != 0:
        sys.exit(f"long_training: expected status 0, found {process.returncode}; see {run}.log.")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=pathlib.Path)
    parser.add_argument("--gld", default="build/release/cli/gld")
    parser.add_argument("--steps", type=int, default=20000)
    parser.add_argument("--seconds", type=float, nargs=2, default=(20, 120), help="shortest and longest time to a kill")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    tiny = pathlib.Path(__file__).resolve().parent.parent / "configs/tiny"
    model = options.out / "model"
    small_bundle(tiny, model)
    training = Training(options, model)
    record_file = options.out / "record.json"
    record = json.loads(record_file.read_text()) if record_file.exists() else {"memory": [], "kills": []}

    def keep() -> None:
        partial = record_file.with_suffix(".partial")
        partial.write_text(json.dumps(record, indent=1) + "\n")
        partial.rename(record_file)

    whole, killed = options.out / "whole", options.out / "killed"
    if not (whole / "report.json").exists():
        process = training.start(whole)
        while process.poll() is None:
            time.sleep(2)
            record["memory"].append([logged_step(whole), resident_bytes(process)])
        ended_well(process, whole)
        keep()

    draws = random.Random(options.seed)
    while not (killed / "report.json").exists():
        process = training.start(killed)
        from_step = newest_step(killed)
        try:
            process.wait(draws.uniform(*options.seconds))
            ended_well(process, killed)
        except subprocess.TimeoutExpired:
            os.kill(process.pid, signal.SIGKILL)
            process.wait()
            record["kills"].append({"resumed_from": from_step, "killed_after": newest_step(killed)})
        keep()

    record["steps"] = options.steps
    record["whole"], record["killed"] = hashes(whole), hashes(killed)
    later = [size for step, size in record["memory"] if step >= options.steps // 10 and size > 0]
    tenth = [size for size in later[: max(1, len(later) // 10)]]
    last = [size for size in later[-max(1, len(later) // 10) :]]
    record["memory_growth"] = (sum(last) / len(last)) / (sum(tenth) / len(tenth)) if later else None
    record["same_bytes"] = record["whole"] == record["killed"] and len(record["whole"]) > 0
    keep()
    print(f"long_training: {options.steps} steps, {len(record['kills'])} kills, same bytes: {record['same_bytes']}, "
          f"memory at the end over that after a tenth: {record['memory_growth']:.3f}")
    if not record["same_bytes"] or record["memory_growth"] > MOST_GROWTH or len(record["kills"]) < 2:
        sys.exit(1)


if __name__ == "__main__":
    main()
