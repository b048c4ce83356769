#!/usr/bin/env python3
"""Compares the figures of documents with the reports that they come from. Needs Python 3 and nothing else.

    scripts/check_figures.py [--root DIR] [FILE...]      by default every page of README.md, docs/ and configs/tiny

A figure is named in a comment below the paragraph or the table that has it, which readers do not see:

    <!-- figures: docs/measured/photographs/lund_door_4/report.json
    31.7 means.sample_psnr.mean
    +12.5 {means.sample_psnr.mean} - {means.psnr_mean_source.mean}
    figures: docs/measured/forward/forward.csv
    5.8 seconds[part=evaluation, variant=bfloat16]
    given: 16
    -->

(or with "; " in the place of new lines). First the figure as the text has it ("21 min 50 s" is one), then where the report has it: keys and numbers of JSON between dots, a
column of CSV with the cells that choose its one row, `rows[...]` (how many such rows there are) or `bytes` (of all files of the name, which may hold *), or arithmetic of such in braces, of other
files as {FILE: ...}. The steps `sum` and `largest` go through a list: stages.sum.seconds. The report's value has to round to the figure. The figure has to stand in the text between the comment and
the one before it, or the heading. A page that is read as text, such as README.md, has `<!-- figures: see NAME -->` instead, and what would stand in the comment below a line `NAME:` of
docs/measured/figures/README.txt (of another page: its name), a figure a line. In the pages of WHOLE every number with a decimal point has to be named, or listed as `given`: a
version, a setting, what a paper says, what is counted, what the text says there is no report of; and no measurement of this program.
"""
import argparse
import ast
import csv
import json
import operator
import pathlib
import re
import sys

WHOLE = ["README.md", "docs/ABLATIONS.md", "docs/NUMBERS.md", "docs/PHOTOGRAPHS.md", "docs/RESULTS.md", "docs/SPLATS.md", "docs/TRAINING.md",
         "configs/tiny/README.md"]
NUMBER = r"[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?"
# The comment as a whole, headings, code: what is no text of a paragraph.
COMMENT = re.compile(r"<!-- *((?:figures|given):.*?)-->", re.S)
DURATION = re.compile(r"(\d+) h(?: (\d+) min)?|(\d+) min (\d+) s|(\d+) min")
OPERATIONS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}


class Wrong(Exception):
    pass


def with_comments(page, text, root):
    """The page's text with its comments in full."""
    path = root / "docs/measured/figures" / (pathlib.Path(page).stem + ".txt")
    sections, name = {}, None
    for line in path.read_text().splitlines() if path.is_file() else []:
        if re.fullmatch(r"\w+:", line):
            name = line[:-1]
            sections[name] = []
        elif line.strip():
            sections[name].append(line.strip())

    def full(reference):
        if reference[1] not in sections:
            raise SystemExit(f"check_figures: {page}: expected a line '{reference[1]}:' in {path}, found none.")
        return "<!-- " + "\n".join(sections[reference[1]]) + " -->"

    return re.sub(r"<!-- figures: see (\w+) -->", full, text)


class Reports:
    """The values in reports, each file read once."""

    def __init__(self, root):
        self.root = root
        self.read = {}

    def contents(self, name):
        if name not in self.read:
            path = self.root / name
            if not path.is_file():
                raise Wrong(f"expected a report {name}, found none")
            if name.endswith(".json"):
                self.read[name] = json.loads(path.read_text())
            elif name.endswith(".jsonl"):
                self.read[name] = [json.loads(line) for line in path.read_text().splitlines() if line]
            else:
                with open(path, newline="") as file:
                    self.read[name] = list(csv.DictReader(file))
        return self.read[name]

    def value(self, name, where):
        if where == "bytes":
            return float(sum(path.stat().st_size for path in self.root.glob(name)))
        found = self.of_table(name, where) if name.endswith(".csv") else self.of_json(self.contents(name), name, where)
        try:
            return float(found)
        except (TypeError, ValueError):
            raise Wrong(f"{name}: expected a number at {where}, found {found!r}") from None

    def of_table(self, name, where):
        matched = re.fullmatch(r"(\w+)\[(.*)\]", where)
        if not matched:
            raise Wrong(f"{name}: expected COLUMN[COLUMN=CELL, ...], found {where}")
        cells = dict(pair.split("=", 1) for pair in re.split(r", (?=\w+=)", matched[2])) if matched[2] else {}
        rows = [row for row in self.contents(name) if all(row.get(key) == cell for key, cell in cells.items())]
        if matched[1] == "rows":
            return len(rows)
        if len(rows) != 1:
            raise Wrong(f"{name}: expected one row of {where}, found {len(rows)}")
        return rows[0].get(matched[1])

    def of_json(self, here, name, where):
        steps = re.findall(r"[^.\[\]]+|\[[^\]]*\]", where)
        for number, step in enumerate(steps):
            if step in ("sum", "largest") and isinstance(here, list):
                rest = ".".join(steps[number + 1:])
                values = [float(self.of_json(entry, name, rest)) for entry in here]
                return sum(values) if step == "sum" else max(values)
            if step.startswith("["):
                key, _, cell = step[1:-1].partition("=")
                chosen = [entry for entry in here if str(entry.get(key)) == cell]
                if len(chosen) != 1:
                    raise Wrong(f"{name}: expected one entry {step} of {where}, found {len(chosen)}")
                here = chosen[0]
            elif isinstance(here, list) and re.fullmatch(r"-?\d+", step) and int(step) < len(here):
                here = here[int(step)]
            elif isinstance(here, dict) and step in here:
                here = here[step]
            else:
                raise Wrong(f"{name}: expected {where}, found no {step}")
        return here


def arithmetic(node):
    if isinstance(node, ast.Expression):
        return arithmetic(node.body)
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATIONS:
        return OPERATIONS[type(node.op)](arithmetic(node.left), arithmetic(node.right))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return -arithmetic(node.operand)
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return node.value
    raise Wrong("expected + - * / of numbers")


def evaluated(reports, name, expression):
    if "{" not in expression:
        return reports.value(name, expression)

    def one(matched):
        other, colon, where = matched[1].partition(": ")
        return repr(reports.value(other, where) if colon else reports.value(name, matched[1]))

    return arithmetic(ast.parse(re.sub(r"\{([^}]*)\}", one, expression), mode="eval"))


def of_text(figure):
    """The value of a figure as it is written, and the most that rounding may have taken from it."""
    duration = DURATION.fullmatch(figure)
    if duration:
        hours, minutes, whole, seconds, only = (int(part) if part else 0 for part in duration.groups())
        return hours * 3600 + (minutes + whole + only) * 60 + seconds, 0.5 if duration[3] else 30
    if not re.fullmatch(NUMBER, figure):
        raise Wrong(f"expected a number or a duration, found '{figure}'")
    mantissa, _, exponent = figure.partition("e")
    places = len(mantissa.partition(".")[2])
    return float(figure), 0.5 * 10.0 ** (int(exponent or 0) - places)


def numbers(text):
    return re.findall(r"(?<![\w.,])" + NUMBER + r"(?![\w]*\w)(?!\.\d)", text)


def stands_in(figure, text):
    return re.search(r"(?<![\w.])" + re.escape(figure) + r"(?![\w]|\.\d)", text) is not None


def plain(text):
    """Without code, links, headings and other comments: numbers there are no figures."""
    text = re.sub(r"<!--.*?-->", " ", text, flags=re.S)
    text = re.sub(r"```.*?```", " ", text, flags=re.S)
    # Before spans of code become blanks, which a line of text may begin with.
    text = "\n".join(line for line in text.split("\n") if not line.startswith(("    ", "#")))
    text = re.sub(r"`[^`]*`", " ", text)
    return re.sub(r"\]\([^)]*\)", "] ", text)


def check(page, text, reports, whole):
    problems, compared, begin = [], 0, 0
    comments = list(COMMENT.finditer(text))
    for comment in comments:
        block = text[begin:comment.start()]
        begin = comment.end()
        named, name = [], None
        for line in re.split(r"\n|; ", comment[1].strip()):
            line = line.strip()
            if line.startswith("figures:"):
                name = line[8:].strip()
                continue
            if line.startswith("given:"):
                named += line[6:].split()
                continue
            duration = re.match(r"(\d+ h(?: \d+ min)?|\d+ min(?: \d+ s)?) (.*)", line)
            figure, _, expression = (duration[1], "", duration[2]) if duration else line.partition(" ")
            named.append(figure)
            try:
                if not stands_in(figure, plain(block)):
                    raise Wrong("expected it in the text above its comment, found it nowhere there")
                value = evaluated(reports, name, expression.strip())
                written, rounding = of_text(figure)
                if abs(value - written) > rounding * (1 + 1e-9) + 1e-12 * abs(value):
                    raise Wrong(f"{name} has {value:.6g} ({expression.strip()})")
                compared += 1
            except (Wrong, SyntaxError, ZeroDivisionError) as wrong:
                problems.append(f"{page}: figure {figure}: {wrong}")
        if whole:
            problems += [f"{page}: figure {number}: expected a report that has it, found none named"
                         for number in numbers(plain(block)) if "." in number and number not in named]
    if whole:
        problems += [f"{page}: figure {number}: expected a report that has it, found none named"
                     for number in numbers(plain(text[begin:])) if "." in number]
    return problems, compared


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", default=pathlib.Path(__file__).resolve().parent.parent, type=pathlib.Path)
    parser.add_argument("pages", nargs="*")
    arguments = parser.parse_args()
    root = arguments.root
    pages = arguments.pages or sorted(
        str(path.relative_to(root)) for pattern in ("*.md", "docs/*.md", "configs/*/*.md") for path in root.glob(pattern))
    reports, problems, compared = Reports(root), [], 0
    for page in pages:
        found, count = check(page, with_comments(page, (root / page).read_text(), root), reports, page in WHOLE)
        problems += found
        compared += count
    if not compared and not problems:
        problems.append("no figure was found at all")
    for problem in problems:
        print(problem, file=sys.stderr)
    if problems:
        sys.exit(f"check_figures: {len(problems)} figures are not what reports have, or of no report; change the text with the report.")
    print(f"check_figures: {compared} figures are what their reports have")


if __name__ == "__main__":
    main()
