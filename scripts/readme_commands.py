#!/usr/bin/env python3
"""Runs the shell blocks of README.md in order, as a reader would. Needs the built program and Python 3.

    scripts/readme_commands.py [--gld FILE] [--threads N] [--keep DIR]

They run in a scratch folder that has the program at build/release/cli/gld, the tree's configs, and in the place of a reader's photographs
(my_photos) two pictures of a room that `gld synth` draws, the demo's. A command that ends with another status than 0, or leaves nothing in
its --out, fails this script with the line of README.md. A block is lines indented by four blanks or more below an empty line, or a fence.

What is not run as it stands is named in README.md, in a comment between the block and the next one:

    <!-- commands: scripts/demo.sh left out: REASON; build/release/cli/gld ablate with --smoke: REASON -->

with the beginning of one command of the block: `left out`, or `with` options that are added to it. --threads is added to the
commands of the program that have it. --keep leaves the scratch folder at DIR, which must not be there.
"""
import argparse
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
PROGRAM = "build/release/cli/gld"
COMMENT = re.compile(r"<!-- commands: (.*?) -->")
LONGEST_SECONDS = 1200


def stop(line, expected, found):
    sys.exit(f"readme_commands: README.md:{line}: expected {expected}, found {found}")


class Command:
    def __init__(self, line, text):
        self.line, self.text, self.left_out, self.added = line, text, "", ""


def blocks_of(text):
    """Lists of commands, each with the text that follows as far as the next block."""
    blocks, block, fence, above_is_empty, goes_on = [], None, False, True, False
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip().startswith("```"):
            fence = not fence
            block = [] if fence else None
            if fence:
                blocks.append((block, []))
            continue
        inside = fence or (re.match(r" {4,}\S", line) and (block is not None or above_is_empty))
        if inside:
            if block is None:
                block = []
                blocks.append((block, []))
            command = line.strip()
            if goes_on:
                block[-1].text += " " + command.rstrip("\\").strip()
            elif command and not command.startswith("#"):
                block.append(Command(number, command.rstrip("\\").strip()))
            goes_on = command.endswith("\\")
        else:
            block = None
            if blocks:
                blocks[-1][1].append((number, line))
        above_is_empty = not line.strip()
    return blocks


def note(blocks):
    """Puts what comments say of commands into them."""
    for commands, below in blocks:
        for number, line in below:
            for comment in COMMENT.finditer(line):
                for entry in comment[1].split("; "):
                    said = re.fullmatch(r"(.+?) (left out|with (\S.*?)): (\S.*)", entry)
                    if not said:
                        stop(number, "COMMAND left out: REASON, or COMMAND with OPTIONS: REASON", f"'{entry}'")
                    named = [command for command in commands if (command.text + " ").startswith(said[1] + " ")]
                    if len(named) != 1:
                        stop(number, f"one command of the block above that begins with '{said[1]}'", len(named))
                    if said[3]:
                        named[0].added = " " + said[3]
                    else:
                        named[0].left_out = said[4]


def without_remark(text):
    return re.sub(r"\s+#.*$", "", text)


def has_threads(program, text):
    words = []
    for word in text.split()[1:]:
        if not re.fullmatch(r"[a-z][a-z-]*", word):
            break
        words.append(word)
    told = subprocess.run([program, *words, "--help-all"], capture_output=True, text=True, check=True).stdout
    return re.search(r"^  --threads ", told, re.M) is not None


def run(text, scratch, failed):
    """Seconds that it took. Where it does not end with 0 its last lines are shown, and failed is called with its status."""
    begin = time.monotonic()
    # A session of its own, so that what bash started ends with it.
    process = subprocess.Popen(["bash", "-euo", "pipefail", "-c", text], cwd=scratch, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                               stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True)
    try:
        said, _ = process.communicate(timeout=LONGEST_SECONDS)
        status = process.returncode
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        said, _ = process.communicate()
        status = f"no end within {LONGEST_SECONDS} s"
    if status != 0:
        print("\n".join(re.split(r"[\n\r]", said)[-30:]))
        failed(status)
    return time.monotonic() - begin


def photographs(scratch, threads):
    """my_photos: two photographs of one place, a step to the side between them."""
    command = f"{PROGRAM} synth --seed 910000 --scene-count 1 --frames 12 --width 448 --height 448 --out drawn{threads}"
    run(command, scratch, lambda status: sys.exit(f"readme_commands: expected {command} to run, found {status}"))
    pictures = sorted(scratch.glob("drawn/scenes/*/images/*.png"))
    (scratch / "my_photos").mkdir()
    for number in (0, 3):
        shutil.copy(pictures[number], scratch / "my_photos")
    shutil.rmtree(scratch / "drawn")
    print("my_photos: two pictures of a room that gld synth has drawn, in the place of a reader's photographs", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gld", type=pathlib.Path, default=ROOT / PROGRAM)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--keep", type=pathlib.Path)
    arguments = parser.parse_args()
    if not arguments.gld.is_file():
        sys.exit(f"readme_commands: expected the program at {arguments.gld}, found none; scripts/build.sh gld builds it.")
    blocks = blocks_of((ROOT / "README.md").read_text())
    note(blocks)
    if arguments.keep:
        arguments.keep.mkdir(parents=True)
    scratch = arguments.keep.resolve() if arguments.keep else pathlib.Path(tempfile.mkdtemp())
    threads = f" --threads {arguments.threads}" if arguments.threads is not None else ""
    count = 0
    begin = time.monotonic()
    try:
        (scratch / PROGRAM).parent.mkdir(parents=True)
        (scratch / PROGRAM).symlink_to(arguments.gld.resolve())
        (scratch / "configs").symlink_to(ROOT / "configs")
        photographs(scratch, threads)
        for command in (command for commands, _ in blocks for command in commands):
            text = without_remark(command.text)
            if command.left_out:
                print(f"README.md:{command.line}: {text}: left out: {command.left_out}")
                continue
            text += command.added
            if threads and text.startswith(PROGRAM) and has_threads(arguments.gld, text):
                text += threads
            took = run(text, scratch, lambda status: stop(command.line, f"'{text}' to run", f"status {status}"))
            out = re.search(r"--out (\S+)", text)
            if out and not any((scratch / out[1]).glob("*")):
                stop(command.line, f"'{text}' to leave something in {out[1]}", "nothing")
            count += 1
            print(f"README.md:{command.line}: {text}: {took:.0f} s", flush=True)
    finally:
        if not arguments.keep:
            shutil.rmtree(scratch)
    if not count:
        sys.exit("readme_commands: expected commands in README.md, found none that is run")
    print(f"readme_commands: {count} commands of README.md run, {time.monotonic() - begin:.0f} s")


if __name__ == "__main__":
    main()
