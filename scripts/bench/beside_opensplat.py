#!/usr/bin/env python3
"""A step of fitting 3D Gaussians by OpenSplat on the CPU and by gld: the same Gaussians, pictures and threads, in turns.

    scripts/bench/beside_opensplat.py --opensplat CHECKOUT --build DIR --out RUN
      --opensplat  a source tree of pierotofy/OpenSplat (AGPL: it is built and timed as it is, nothing of it is copied)
      --build      a folder outside this tree, where it is built for the CPU and where the runs' files lie meanwhile
Needs Python 3.11 with numpy, CMake, and Debian's libnanoflann-dev, libcxxopts-dev, nlohmann-json3-dev, libopencv-dev and
libtorch-dev; nothing is downloaded.

One room of gld synth; its Gaussians before the first step (gld splat fit --fit.steps 0) are where both begin, without moments of
Adam: OpenSplat by --resume, which wants a header without other comments and harmonics of its degree, so that the header is
written anew and harmonics are filled with the zeros that they are. The file claims to be of step N of 2 N, the second half of a
fit, where OpenSplat gathers nothing for densification; that, resets of opacity and smaller pictures are off on both sides, and
gld gets the rates of that half. Harmonics are of degree 3 from the first step (gld: the fourth).

Seconds a step are the wall clock of a run of --steps without that of one of --few-steps, by their difference: loading and writing
fall out. Medians of --repeats. So that a fast step that learns nothing would be seen, held-out views are drawn from both results
by gld and compared with the pictures; OpenSplat also draws one of them itself, in a run that is not timed. What the environment
says to OpenMP and BLAS is left out, and OMP_NUM_THREADS set for both. Writes beside_opensplat.md, beside_opensplat.csv,
options.yaml and report.json into RUN, which must not be there yet, all at once at the end.
"""
import argparse
import csv
import hashlib
import io
import json
import os
import pathlib
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import zlib

import numpy

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAMS = ["opensplat", "gld"]
DEGREE = 3
HARMONICS = 3 * ((DEGREE + 1) ** 2 - 1)
MEAN_RATES = [1.6e-5, 1.6e-6]  # of 3DGS, half way and at the end
PACKAGES = "libnanoflann-dev libcxxopts-dev nlohmann-json3-dev libopencv-dev libtorch-dev"
BUSY = 0.1  # processors that others may use


def fail(where, expected, found, what_to_do):
    sys.exit(f"beside_opensplat: {where}: expected {expected}, found {found}; {what_to_do}.")


class Parser(argparse.ArgumentParser):
    def error(self, message):
        sys.exit(f"beside_opensplat: {message}; --help lists the options.")


def environment(threads):
    restrictions = ("OMP_", "GOMP_", "KMP_", "OPENBLAS_", "GOTO_", "BLIS_", "MKL_", "ONEDNN_", "DNNL_", "ATEN_", "TORCH_")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(restrictions)}
    return {**kept, "OMP_NUM_THREADS": str(threads)}


def busy_seconds():
    """Of all processors and programs since the start of the machine."""
    ticks = [int(word) for word in pathlib.Path("/proc/stat").read_text().splitlines()[0].split()[1:]]
    return (sum(ticks[:3]) + sum(ticks[5:7])) / os.sysconf("SC_CLK_TCK")


def run(command, log, threads):
    """Seconds of a program: by the wall clock, of its processors, and of what others used of them meanwhile."""
    words = [str(word) for word in command]
    busy, began = busy_seconds(), time.monotonic()
    with open(log, "wb") as output:
        process = subprocess.Popen(words, env=environment(threads), stdout=output, stderr=subprocess.STDOUT,
                                   stdin=subprocess.DEVNULL, cwd=ROOT)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    wall, busy = time.monotonic() - began, busy_seconds() - busy
    if process.returncode != 0:
        tail = log.read_text(errors="replace").strip().splitlines()[-1:] or ["no message"]
        fail(" ".join(words), "a run that ends with 0", f"{process.returncode} ({tail[0].strip()})",
             f"see all that it said in {log}")
    processors = usage.ru_utime + usage.ru_stime
    return {"wall": wall, "processors": processors, "others": max(0.0, busy - processors) / wall}


def build_opensplat(options):
    """OpenSplat's program, built by its own CMakeLists.txt for the CPU with Debian's packages."""
    print("beside_opensplat: building OpenSplat", flush=True)
    program, cache = options.build / "opensplat", options.build / "CMakeCache.txt"
    if cache.exists():
        source = cached(cache, "CMAKE_HOME_DIRECTORY")
        if pathlib.Path(source) != options.opensplat:
            fail("--build", f"a folder where {options.opensplat} is built", f"one of {source}", "choose another folder")
    prefix = [f"-DCMAKE_PREFIX_PATH={options.libtorch}"] if options.libtorch else []
    configure = ["cmake", "-S", options.opensplat, "-B", options.build, "-DGPU_RUNTIME=CPU", "-DCMAKE_BUILD_TYPE=Release",
                 f"-DCMAKE_CXX_FLAGS={options.cxx_flags}", "-DFETCHCONTENT_TRY_FIND_PACKAGE_MODE=ALWAYS",
                 "-DFETCHCONTENT_FULLY_DISCONNECTED=ON", *prefix]
    make = ["cmake", "--build", options.build, "--target", "opensplat", "--parallel", options.threads]
    for step, command in (("configure", configure), ("compile", make)):
        log = options.build / f"{step}.log"
        with open(log, "wb") as output:
            ended = subprocess.run([str(word) for word in command], stdout=output, stderr=subprocess.STDOUT).returncode
        if ended != 0:
            fail(f"cmake, to {step} OpenSplat", "an end with 0", f"{ended}",
                 f"see {log}, and install {PACKAGES} where one is missing")
    if not program.is_file():
        fail(str(options.build), "the program opensplat once it is built", "none", "check --opensplat")
    libtorch = pathlib.Path(cached(cache, "Torch_DIR")) / "TorchConfigVersion.cmake"
    version = re.search(r'PACKAGE_VERSION "([^"]*)"', libtorch.read_text()) if libtorch.exists() else None
    return program, {"version": (options.opensplat / "VERSION").read_text().strip(),
                     "commit": commit_of(options.opensplat), "sources_sha256": sources_hash(options.opensplat),
                     "compiler": compiler(cache),
                     "flags": f"{cached(cache, 'CMAKE_CXX_FLAGS')} {cached(cache, 'CMAKE_CXX_FLAGS_RELEASE')}".strip(),
                     "libtorch": version[1] if version else "unknown"}


def cached(cache, name):
    found = re.search(rf"^{name}:[A-Z]+=(.*)$", cache.read_text(), re.M)
    return found[1] if found else "unknown"


def compiler(cache):
    said = subprocess.run([cached(cache, "CMAKE_CXX_COMPILER"), "--version"], stdout=subprocess.PIPE, text=True).stdout
    return said.splitlines()[0] if said else "unknown"


def commit_of(checkout):
    """Of a checkout that is the top of its repository, not of one that it lies in."""
    run_git = subprocess.run(["git", "-C", checkout, "rev-parse", "HEAD"], stdout=subprocess.PIPE,
                             stderr=subprocess.DEVNULL, text=True)
    return run_git.stdout.strip() if (pathlib.Path(checkout) / ".git").exists() and run_git.stdout else "unknown"


def sources_hash(folder):
    """Of names and bytes of all C++ sources, which tells a tree without a repository from another."""
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.suffix in (".cpp", ".hpp", ".h", ".cu", ".cuh")):
        digest.update(str(file.relative_to(folder)).encode() + b"\0" + file.read_bytes() + b"\0")
    return digest.hexdigest()


def processor():
    for line in open("/proc/cpuinfo"):
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return "unknown"


def read_splats(file):
    """Names of the properties and an array of floats, a row a Gaussian."""
    data = file.read_bytes()
    header, mark, body = data.partition(b"end_header\n")
    lines = header.decode(errors="replace").splitlines()
    count = next((int(line.split()[2]) for line in lines if line.startswith("element vertex")), -1)
    properties = [line.split() for line in lines if line.startswith("property")]
    is_known = all(words[1] == "float" for words in properties) and "format binary_little_endian 1.0" in lines
    if not mark or not is_known or len(body) != 4 * count * len(properties):
        fail(str(file), "a binary PLY file of floats", "another one", "check that --gld is of this tree")
    if any(line.startswith("comment gld:origin") for line in lines):
        fail(str(file), "Gaussians near the world's origin", "ones beside an origin of their own",
             "choose another --scene-seed")
    return [words[2] for words in properties], numpy.frombuffer(body, "<f4").reshape(count, len(properties))


def write_splats(file, names, values, step):
    """For OpenSplat, whose reader takes these properties in this order and one comment."""
    wanted = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    wanted += [f"f_rest_{k}" for k in range(HARMONICS)]
    wanted += ["opacity"] + [f"scale_{k}" for k in range(3)] + [f"rot_{k}" for k in range(4)]
    rows = numpy.zeros((len(values), len(wanted)), "<f4")
    for column, name in enumerate(wanted):
        if name in names:
            rows[:, column] = values[:, names.index(name)]
    header = ["ply", "format binary_little_endian 1.0", f"comment Generated by opensplat at iteration {step}",
              f"element vertex {len(rows)}", *(f"property float {name}" for name in wanted), "end_header", ""]
    file.write_bytes("\n".join(header).encode() + rows.tobytes())


def write_points(file, names, values):
    """Middles and colours of the Gaussians, which OpenSplat reads before it takes those that it goes on from."""
    rows = numpy.zeros(len(values), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"),
                                     ("blue", "u1")])
    for axis in "xyz":
        rows[axis] = values[:, names.index(axis)]
    for k, colour in enumerate(("red", "green", "blue")):
        shown = 0.5 + values[:, names.index(f"f_dc_{k}")] / (2 * numpy.sqrt(numpy.pi))
        rows[colour] = numpy.clip(numpy.rint(255 * shown), 0, 255)
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}",
              *(f"property float {axis}" for axis in "xyz"),
              *(f"property uchar {colour}" for colour in ("red", "green", "blue")), "end_header", ""]
    file.write_bytes("\n".join(header).encode() + rows.tobytes())


def read_png(file):
    """Height x width x 3 of 8 bits; the pictures of both programs, without interlacing or palette."""
    data = file.read_bytes()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        fail(str(file), "a PNG file", "another one", "check that --gld is of this tree")
    at, packed, header = 8, b"", b""
    while at + 8 <= len(data):
        length, kind = int.from_bytes(data[at:at + 4], "big"), data[at + 4:at + 8]
        if kind == b"IHDR":
            header = data[at + 8:at + 8 + length]
        elif kind == b"IDAT":
            packed += data[at + 8:at + 8 + length]
        at += 12 + length
    width, height = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:8], "big")
    if header[8:] != b"\x08\x02\x00\x00\x00":
        fail(str(file), "8 bits of red, green and blue", "another kind of picture", "check that --gld is of this tree")
    rows = numpy.frombuffer(zlib.decompress(packed), numpy.uint8).reshape(height, 1 + 3 * width)
    picture = numpy.zeros((height, width, 3), numpy.int64)
    above = numpy.zeros((width, 3), numpy.int64)
    for y in range(height):
        kind, row = rows[y, 0], rows[y, 1:].reshape(width, 3).astype(numpy.int64)
        if kind == 1:
            row = numpy.cumsum(row, axis=0) % 256
        elif kind == 2:
            row = (row + above) % 256
        elif kind in (3, 4):
            left = corner = numpy.zeros(3, numpy.int64)
            for x in range(width):
                up = above[x]
                if kind == 3:
                    guess = (left + up) // 2
                else:
                    distances = numpy.abs([up - corner, left - corner, left + up - 2 * corner])
                    guess = numpy.choose(numpy.argmin(distances, axis=0), [left, up, corner])
                left, corner = (row[x] + guess) % 256, up
                row[x] = left
        picture[y] = above = row
    return picture


def psnr(picture, truth):
    if picture.shape != truth.shape:
        fail("a drawn view", f"a picture of {truth.shape[1]}x{truth.shape[0]}",
             f"one of {picture.shape[1]}x{picture.shape[0]}", "check that --gld is of this tree")
    error = float(numpy.mean(((picture - truth) / 255.0) ** 2))
    return 10 * float(numpy.log10(1 / max(error, 1e-12)))


class Comparison:
    """The scene, where both begin, and runs of both programs on it."""

    def __init__(self, options, opensplat, work):
        self.options, self.opensplat, self.work = options, opensplat, work
        self.runs = 0
        synth = work / "synth"
        self.call_gld("synth", "--scene-count", 1, "--seed", options.scene_seed, "--frames",
                      options.views + options.held_out, "--width", options.side, "--height", options.side, "--layout",
                      "nerfstudio", "--out", synth)
        self.scene = next(iter(synth.glob("scenes/*")), None)
        if self.scene is None:
            fail("--gld", "a program that writes a scene by gld synth", f"none in {synth}", "build gld of this tree anew")
        self.start = work / "start"
        self.fit(self.start, 0)
        self.start_report = json.loads((self.start / "report.json").read_text())
        cameras = json.loads((self.start / "cameras.json").read_text())
        cameras["frames"] = [frame for frame in cameras["frames"] if frame["role"] == "target"]
        self.held_out = [frame["name"] for frame in cameras["frames"]]
        (work / "held_out.json").write_text(json.dumps(cameras))
        self.write_opensplat_scenes()

    def log(self, name):
        self.runs += 1
        return self.work / f"{self.runs:02}_{name}.log"

    def call_gld(self, *words):
        name = "_".join(str(word) for word in words[:2] if not str(word).startswith("-"))
        return run([self.options.gld, *words, "--quiet", "--threads", self.options.threads], self.log(f"gld_{name}"),
                   self.options.threads)

    def fit(self, out, steps):
        return self.call_gld(
            "splat", "fit", "--scene", self.scene, "--side", self.options.side, "--held-out", self.options.held_out,
            "--fit.steps", steps, "--fit.degree", DEGREE, "--fit.degree-every", 1, "--fit.rates.mean", MEAN_RATES[0],
            "--fit.rates.last-mean", MEAN_RATES[1], "--fit.density.densify", "none", "--fit.density.most-gaussians",
            self.options.gaussians, "--checkpoint-every", 0, "--out", out)

    def write_opensplat_scenes(self):
        """The fitted views, and beside it a scene of these and one that OpenSplat is told to withhold and to draw."""
        names, values = read_splats(self.start / "splats.ply")
        for steps in (self.options.few_steps, self.options.steps):
            write_splats(self.work / f"start_{steps}.ply", names, values, steps)
        transforms = json.loads((self.scene / "transforms.json").read_text())
        self.shown = self.held_out[len(self.held_out) // 2]
        for folder, more in (("fitted", []), ("withheld", [self.shown])):
            target = self.work / folder
            target.mkdir()
            write_points(target / "points.ply", names, values)
            frames = []
            for frame in transforms["frames"]:
                name = pathlib.Path(frame["file_path"]).stem
                if name in self.held_out and name not in more:
                    continue
                frames.append({key: value for key, value in frame.items() if key != "depth_file_path"} |
                              {"file_path": str(self.scene / frame["file_path"])})
            (target / "transforms.json").write_text(
                json.dumps({**transforms, "frames": frames, "ply_file_path": "points.ply"}))

    def run_opensplat(self, out, steps, withheld=False):
        out.mkdir()
        last = 2 * steps
        words = [self.opensplat, self.work / ("withheld" if withheld else "fitted"), "--output", out / "splats.ply",
                 "--resume", self.work / f"start_{steps}.ply", "--num-iters", last, "--keep-crs", "--cpu",
                 "--num-downscales", 0, "--sh-degree", DEGREE, "--sh-degree-interval", 1, "--ssim-weight", 0.2,
                 "--refine-every", last + 1, "--warmup-length", last + 1]
        if withheld:
            words += ["--val-image", f"{self.shown}.png", "--val-render", out / "views"]
        taken = run(words, self.log(f"opensplat_{steps}"), self.options.threads)
        if not (out / "splats.ply").is_file():
            fail("OpenSplat", f"{out / 'splats.ply'} when it has ended", "none", f"see the last log in {self.work}")
        return taken

    def one(self, program, out, steps):
        return self.run_opensplat(out, steps) if program == "opensplat" else self.fit(out, steps)

    def held_out_psnr(self, name, splats):
        """dB of each held-out view, drawn by gld."""
        out = self.work / f"drawn_{name}"
        self.call_gld("splat", "render", "--splats", splats, "--cameras", self.start / "cameras.json", "--path",
                      self.work / "held_out.json", "--frames", 0, "--projection.near", self.start_report["near"],
                      "--out", out)
        drawn = sorted((out / "images").iterdir())
        return {view: psnr(read_png(file), self.truth(view)) for view, file in zip(self.held_out, drawn, strict=True)}

    def truth(self, view):
        return read_png(self.scene / "images" / f"{view}.png")


def measure(options, comparison):
    rows = []
    for repeat in range(options.repeats):
        # The other one first every second time.
        for program in PROGRAMS if repeat % 2 == 0 else PROGRAMS[::-1]:
            taken = {}
            for steps in (options.few_steps, options.steps):
                out = comparison.work / f"{program}_{repeat}_{steps}"
                taken[steps] = comparison.one(program, out, steps)
            few, many = taken[options.few_steps], taken[options.steps]
            between = options.steps - options.few_steps
            row = {"program": program, "repeat": repeat,
                   "seconds": (many["wall"] - few["wall"]) / between,
                   "processor_seconds": (many["processors"] - few["processors"]) / between,
                   "wall_few": few["wall"], "wall_many": many["wall"], "others": max(few["others"], many["others"])}
            rows.append(row)
            print(f"beside_opensplat: {program}: {row['seconds']:.4g} s a step, {row['processor_seconds']:.4g} s of "
                  f"processors; others used {row['others']:.2f} processors", flush=True)
    for key in ("seconds", "processor_seconds"):
        for program, found in summary(rows, key).items():
            if found["median"] <= 0:
                fail("--steps", f"runs of {program} of {options.steps} steps that take longer than those of "
                     f"{options.few_steps}", "shorter ones", "raise --steps, or wait until the machine is idle")
    return rows


def summary(rows, key):
    values = {program: [row[key] for row in rows if row["program"] == program] for program in PROGRAMS}
    return {program: {"median": statistics.median(some), "lowest": min(some), "highest": max(some)}
            for program, some in values.items()}


def table_text(report):
    lines = ["| program | s a step | lowest to highest | s of processors a step | processors in use | Gaussians | "
             "held-out views, dB |",
             "|---|---:|---:|---:|---:|---:|---:|",
             f"| before the first step | | | | | {report['gaussians']['start']} | {report['held_out_psnr']['start']:.2f} |"]
    for program, name in (("opensplat", "OpenSplat"), ("gld", "gld")):
        seconds, processors = report["seconds"][program], report["processor_seconds"][program]["median"]
        lines.append(f"| {name} | {seconds['median']:.3g} | {seconds['lowest']:.3g} to {seconds['highest']:.3g} | "
                     f"{processors:.3g} | {processors / seconds['median']:.1f} | {report['gaussians'][program]} | "
                     f"{report['held_out_psnr'][program]:.2f} |")
    return "\n".join(lines)


def report_text(report, options):
    opensplat = report["opensplat"]
    lines = [
        "# Beside OpenSplat on the CPU", "",
        f"A step of fitting {report['gaussians']['start']} Gaussians to a view of {options.side}x{options.side}, "
        f"{options.views} views in turn, harmonics of degree {DEGREE}, no densification; both from the same Gaussians; "
        f"medians of {options.repeats}, in turns; {options.threads} threads of an {report['processor']}.",
        f"OpenSplat {opensplat['version']}, LibTorch {opensplat['libtorch']}, built with `{opensplat['flags']}`. gld: of the "
        f"tree at {report['gld']['tree'][:10]}.",
        f"Quality: after {options.steps} steps, {options.held_out} held-out views drawn by gld from both results. OpenSplat "
        f"itself draws {report['shown_view']['name']} at {report['shown_view']['opensplat_itself']:.2f} dB, gld draws the "
        f"same from OpenSplat's Gaussians at {report['shown_view']['opensplat_by_gld']:.2f} dB.", "",
        table_text(report), "",
        f"By the clock gld's step is {report['times_as_fast']['wall']:.1f} times as fast; it takes "
        f"{1 / report['times_as_fast']['processors']:.3f} of the processor time of OpenSplat's.", ""]
    if report["problems"]:
        lines += ["**Not on an idle machine**: " + "; ".join(report["problems"]) + ".", ""]
    return "\n".join(lines)


def rows_csv(rows):
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue()


def config_text(options):
    lines = ["# scripts/bench/beside_opensplat.py: the options of this run, defaults included"]
    for name, value in sorted(vars(options).items()):
        # Where a folder lay on one machine says nothing on another.
        lines.append(f"{name}: {json.dumps(value.name if isinstance(value, pathlib.Path) else value)}")
    return "\n".join(lines) + "\n"


def write_together(out, files):
    """All of the files under their last name at once, or none."""
    out.parent.mkdir(parents=True, exist_ok=True)
    temporary = pathlib.Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    temporary.chmod(0o755)
    for name, content in files.items():
        (temporary / name).write_text(content)
    try:
        temporary.rename(out)
    except OSError as error:
        fail("--out", "a folder that is not there yet", str(error), f"the results are in {temporary}")


def parsed_options():
    parser = Parser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opensplat", type=pathlib.Path, required=True)
    parser.add_argument("--build", type=pathlib.Path, required=True)
    parser.add_argument("--gld", type=pathlib.Path, default=ROOT / "build/release/cli/gld")
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--cxx-flags", default="", help="more flags for OpenSplat, such as -march=native")
    parser.add_argument("--libtorch", type=pathlib.Path, help="of OpenSplat, in the place of Debian's")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--few-steps", type=int, default=20)
    parser.add_argument("--steps", type=int, default=220)
    parser.add_argument("--side", type=int, default=256, help="pixels")
    parser.add_argument("--views", type=int, default=20, help="that are fitted")
    parser.add_argument("--held-out", type=int, default=4)
    parser.add_argument("--gaussians", type=int, default=20000, help="no more than these")
    parser.add_argument("--scene-seed", type=int, default=0, help="of the room")
    parser.add_argument("--keep", action="store_true", help="leave the runs' files in --build")
    options = parser.parse_args()

    # Before anything is run.
    for name, what in (("opensplat", "CMakeLists.txt"), ("libtorch", "share/cmake/Torch/TorchConfig.cmake")):
        folder = getattr(options, name)
        if folder is not None and not (folder / what).is_file():
            fail(f"--{name}", f"a folder with {what}", f"'{folder}'", "check the path")
    if not (options.opensplat / "rasterizer/gsplat-cpu").is_dir() or not (options.opensplat / "VERSION").is_file():
        fail("--opensplat", "OpenSplat's sources with rasterizer/gsplat-cpu and VERSION", f"'{options.opensplat}'",
             "unpack pierotofy/OpenSplat and name its folder")
    if not (options.gld.is_file() and os.access(options.gld, os.X_OK)):
        fail("--gld", "the program gld", f"'{options.gld}'", "build it with scripts/build.sh gld or name another")
    if options.out.exists():
        fail("--out", "a folder that is not there yet", f"'{options.out}'", "choose another or remove it")
    if options.build.resolve().is_relative_to(ROOT) or options.build.resolve().is_relative_to(options.opensplat.resolve()):
        fail("--build", f"a folder outside {ROOT} and outside OpenSplat's sources", f"'{options.build}'", "choose another")
    if options.build.exists() and not options.build.is_dir():
        fail("--build", "a folder", f"the file '{options.build}'", "choose another")
    if shutil.which("cmake") is None:
        fail("PATH", "cmake", "none", "install it")
    for name, lowest, highest in (("threads", 1, 1024), ("repeats", 1, 1000), ("few_steps", 4, 10**6), ("side", 16, 8192),
                                  ("views", 1, 10**5), ("held_out", 1, 10**5), ("gaussians", 1, 5 * 10**7),
                                  ("scene_seed", 0, 2**62)):
        value = getattr(options, name)
        if not lowest <= value <= highest:
            fail(f"--{name.replace('_', '-')}", f"{lowest} to {highest}", f"{value}", "choose another")
    if options.steps <= options.few_steps or options.steps % 5 != 0:
        # OpenSplat draws the withheld view after every tenth step, and runs from N to 2 N.
        fail("--steps", f"a multiple of 5 above --few-steps ({options.few_steps})", f"{options.steps}", "choose another")
    return options


def resolved(options):
    for name in ("opensplat", "build", "gld", "libtorch", "out"):
        if getattr(options, name) is not None:
            setattr(options, name, getattr(options, name).resolve())


def gaussians_in(file):
    return len(read_splats(file)[1])


def main():
    options = parsed_options()
    config = config_text(options)
    resolved(options)
    options.build.mkdir(parents=True, exist_ok=True)
    opensplat, about = build_opensplat(options)
    work = pathlib.Path(tempfile.mkdtemp(prefix="runs_", dir=options.build))
    comparison = Comparison(options, opensplat, work)
    rows = measure(options, comparison)

    results = {"start": comparison.start / "splats.ply",
               **{program: work / f"{program}_{options.repeats - 1}_{options.steps}" / "splats.ply" for program in PROGRAMS}}
    views = {name: comparison.held_out_psnr(name, splats) for name, splats in results.items()}
    own = work / "opensplat_own"
    comparison.run_opensplat(own, options.steps, withheld=True)
    own_view = read_png(own / "views" / f"{2 * options.steps}.png")
    own_drawn = comparison.held_out_psnr("opensplat_own", own / "splats.ply")
    seconds, processors = summary(rows, "seconds"), summary(rows, "processor_seconds")
    others = max(row["others"] for row in rows)
    report = {
        "command": "scripts/bench/beside_opensplat.py", "processor": processor(), "processors": os.cpu_count(),
        "threads": options.threads, "repeats": options.repeats, "few_steps": options.few_steps, "steps": options.steps,
        "side": options.side, "views": options.views, "degree": DEGREE, "opensplat": about,
        "gld": {"tree": commit_of(ROOT), "sha256": hashlib.sha256(options.gld.read_bytes()).hexdigest()},
        "gaussians": {name: gaussians_in(file) for name, file in results.items()},
        "seconds": seconds, "processor_seconds": processors,
        "times_as_fast": {"wall": seconds["opensplat"]["median"] / seconds["gld"]["median"],
                          "processors": processors["opensplat"]["median"] / processors["gld"]["median"]},
        "held_out_psnr": {name: statistics.mean(values.values()) for name, values in views.items()},
        "held_out_psnr_of_views": views,
        "shown_view": {"name": comparison.shown,
                       "opensplat_itself": psnr(own_view, comparison.truth(comparison.shown)),
                       "opensplat_by_gld": own_drawn[comparison.shown]},
        "others": others,
        "problems": [f"other programs used up to {others:.2f} processors"] if others > BUSY else [],
        "rows": rows}
    text = report_text(report, options)
    write_together(options.out, {"beside_opensplat.md": text, "beside_opensplat.csv": rows_csv(rows), "options.yaml": config,
                                 "report.json": json.dumps(report, indent=1) + "\n"})
    if not options.keep:
        shutil.rmtree(work)
    print(text)


if __name__ == "__main__":
    try:
        main()
    except OSError as error:
        fail(str(error.filename or "a file"), "a file or folder to read or write", error.strerror or str(error),
             "check the paths and the space left")
    except KeyboardInterrupt:
        sys.exit("beside_opensplat: interrupted; --out is not written, and the runs' files are left in --build.")
