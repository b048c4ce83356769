#!/usr/bin/env python3
"""Whether tests notice when the product is wrong: makes each change of tests/mutations.json by itself, builds the test
program named there and what that needs, and says whether the named case of the named test failed. Fails where one did not.
Where all were made and noticed, they stand in the table of tests/mutations.md. Needs a configured build folder.

    scripts/mutations.py [--build build/release] [WORD]    all, or those whose description holds WORD

It changes the sources of the tree that it lies in, one at a time, and puts each back as it was, also when it is stopped; a file
with changes that are not committed is refused.
"""
import argparse
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

root = Path(__file__).resolve().parent.parent


def build(folder, programs):
    return subprocess.run(["cmake", "--build", folder, "--target", *programs], cwd=root, capture_output=True, text=True)


def run_test(folder, test):
    # The entries for hardware (x_test_on_avx2) are left out: the change has to be seen on every machine.
    return subprocess.run(["ctest", "--test-dir", folder, "-R", f"^{test}$", "--no-tests=error", "--output-on-failure"],
                          cwd=root, capture_output=True, text=True)


def end(sentence):
    sys.exit("mutations: " + sentence)


def failed_cases(output):
    lines = (line.split("[  FAILED  ]")[1] for line in output.splitlines() if "[  FAILED  ]" in line)
    cases = (line.split("(")[0].split(",")[0].strip() for line in lines)
    return list(dict.fromkeys(case for case in cases if "." in case))


def is_of(case, failed):
    """Suite.Name stands for itself and for all that a suite with parameters makes of it: On/Suite.Name/7."""
    return case == failed or case in failed.split("/")


def write_table(mutations):
    lines = ["# Changes of the product that tests notice", "",
             "Written by `scripts/mutations.py`, which makes each of them by itself (`mutations.json`) and runs the test.", "",
             "| change | in | noticed by |", "|---|---|---|"]
    lines += [f"| {m['what']} | `{m['file']}` | `{m['test']}`: `{m['case']}` |" for m in mutations]
    (root / "tests/mutations.md").write_text("\n".join(lines) + "\n")


def main():
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that what was changed is put back
    parser = argparse.ArgumentParser()
    parser.add_argument("--build", default="build/release")
    parser.add_argument("word", nargs="?", default="")
    options = parser.parse_args()
    chosen = [m for m in json.loads((root / "tests/mutations.json").read_text()) if options.word in m["what"]]
    if not chosen:
        end(f"expected a description that holds '{options.word}', found none; see tests/mutations.json.")
    for mutation in chosen:
        file = mutation["file"]
        found = (root / file).read_text().count(mutation["from"])
        if found != 1:
            end(f"{file}: expected '{mutation['from']}' once, found it {found} times; mend tests/mutations.json.")
        if subprocess.run(["git", "diff", "--quiet", "HEAD", "--", file], cwd=root).returncode != 0:
            end(f"{file}: expected a file as it was committed, found changes; commit them first.")

    programs = sorted({m["program"] for m in chosen})
    built = build(options.build, programs)
    if built.returncode != 0:
        end("expected a tree that builds, found:\n" + built.stdout[-2000:] + built.stderr[-2000:])
    for test in sorted({m["test"] for m in chosen}):
        if run_test(options.build, test).returncode != 0:
            end(f"expected {test} to pass before anything is changed, found a failure.")

    missed = 0
    try:
        for mutation in chosen:
            path = root / mutation["file"]
            text = path.read_text()
            begun = time.monotonic()
            try:
                path.write_text(text.replace(mutation["from"], mutation["to"]))
                built = build(options.build, [mutation["program"]])
                if built.returncode != 0:
                    end(f"{mutation['what']}: expected a change that compiles, found:\n{built.stdout[-2000:]}")
                tested = run_test(options.build, mutation["test"])
            finally:
                path.write_text(text)
            failed = failed_cases(tested.stdout)
            caught = tested.returncode != 0 and any(is_of(mutation["case"], case) for case in failed)
            missed += not caught
            by = f"{mutation['test']}: {mutation['case']}"
            others = f", found {', '.join(failed) or 'no case that fails'}" if not caught else ""
            print(f"{'caught' if caught else 'MISSED'} | {mutation['what']} | {mutation['file']} | {by}{others} | "
                  f"{time.monotonic() - begun:.0f} s", flush=True)
    finally:
        build(options.build, programs)  # of the sources as they were
    if missed > 0:
        end(f"{missed} of {len(chosen)} changes were not noticed; write the tests.")
    print(f"all {len(chosen)} changes were noticed")
    if not options.word:
        write_table(chosen)


if __name__ == "__main__":
    main()
