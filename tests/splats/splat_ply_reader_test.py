"""The splats.ply that gld splat fit makes of a run of gld sample, as other programs read and draw it.

splat_ply_reader_test.py GLD SCRATCH

GLD is the program. The room, the sources and the orbit are those of scripts/demo.sh, at the size that the model sees,
so that a minute is enough. The file is read by pip's plyfile and drawn by a splatter that is written here from what is
published (Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field Rendering, 2023; Zwicker et al., EWA Volume
Splatting, 2001), not from this project. Debian's python3-numpy and build/venv-testing are what it needs
(scripts/setup.sh --testing).
"""

import json
import pathlib
import shutil
import struct
import subprocess
import sys
import time
import zlib

import numpy
import plyfile

LEAST_PSNR = 20.0
# By how much a drawing of wrongly understood Gaussians has to be worse.
LEAST_LOSS = 3.0
# The definitions agree on all but the faint tails of Gaussians, and gld's pictures are rounded to 8 bits.
LEAST_PSNR_BESIDE_GLD = 40.0


def check(holds, what):
    if not holds:
        raise AssertionError(what)


def expect(found, expected, what, where):
    check(found == expected, f"{where}: expected {what} {expected}, found {found}")


# Pictures.

def read_png(file):
    """Of 8 bits a channel, RGB or RGBA, not interlaced: (height, width, 3) from 0 to 1."""
    data = file.read_bytes()
    expect(data[:8], b"\x89PNG\r\n\x1a\n", "the first bytes", file)
    packed, place = b"", 8
    while place < len(data):
        length, kind = struct.unpack(">I4s", data[place:place + 8])
        body = data[place + 8:place + 8 + length]
        if kind == b"IHDR":
            width, height, *form = struct.unpack(">IIBBBBB", body)
        elif kind == b"IDAT":
            packed += body
        place += 12 + length
    check(form in ([8, 2, 0, 0, 0], [8, 6, 0, 0, 0]), f"{file}: expected 8-bit RGB or RGBA, found depth, colour and so on {form}")
    channels = 3 if form[1] == 2 else 4
    raw, stride = zlib.decompress(packed), channels * width
    expect(len(raw), height * (stride + 1), "bytes of pixels:", file)
    rows, above = [], bytearray(stride)
    for row in range(height):
        kind, *line = raw[row * (stride + 1):(row + 1) * (stride + 1)]
        check(kind <= 4, f"{file}: expected filters from 0 to 4, found {kind} in row {row}")
        for i in range(stride):
            left, up = (line[i - channels] if i >= channels else 0), above[i]
            corner = above[i - channels] if i >= channels else 0
            if kind == 1:
                guess = left
            elif kind == 2:
                guess = up
            elif kind == 3:
                guess = (left + up) // 2
            elif kind == 4:
                guess = min((left, up, corner), key=lambda value: abs(left + up - corner - value))
            else:
                break
            line[i] = (line[i] + guess) & 255
        rows.append(line)
        above = line
    return numpy.array(rows, dtype=float).reshape(height, width, channels)[:, :, :3] / 255


def psnr(picture, truth):
    expect(picture.shape, truth.shape, "the other picture's shape", "pictures that are compared")
    shown = numpy.clip(picture, 0, 1)
    return -10 * numpy.log10(max(numpy.mean((shown - truth) ** 2), 1e-10))


# The file.

def expected_properties(rest):
    """In the order in which the authors' own program writes them."""
    return (["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"] + [f"f_rest_{i}" for i in range(rest)] +
            ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"])


def read_splats(file):
    """The columns of a file that a public viewer opens; an AssertionError says what it would stumble over."""
    try:
        ply = plyfile.PlyData.read(str(file), mmap=False)
    except (plyfile.PlyParseError, ValueError) as error:
        raise AssertionError(f"{file}: expected a PLY file that plyfile reads, found: {error}") from error
    expect((ply.text, ply.byte_order), (False, "<"), "binary, little-endian", file)
    expect([element.name for element in ply.elements], ["vertex"], "elements", file)
    vertex = ply["vertex"]
    names = [one.name for one in vertex.properties]
    rest = sum(name.startswith("f_rest_") for name in names)
    expect(names, expected_properties(rest), "properties", file)
    check(rest in [3 * ((degree + 1) ** 2 - 1) for degree in range(4)],
          f"{file}: expected 0, 9, 24 or 45 of f_rest, those of whole degrees, found {rest}")
    for one in vertex.properties:
        check(not isinstance(one, plyfile.PlyListProperty) and one.val_dtype == "f4",
              f"{file}: expected {one.name} to be float, found {one}")
    check(vertex.count > 0, f"{file}: expected Gaussians, found none")
    header = file.read_bytes().index(b"end_header\n") + len(b"end_header\n")
    expect(file.stat().st_size, header + 4 * len(names) * vertex.count, "bytes:", file)
    columns = {name: numpy.asarray(vertex[name], dtype=float) for name in names}
    for name, values in columns.items():
        check(numpy.isfinite(values).all(), f"{file}: expected finite {name}, found {numpy.sum(~numpy.isfinite(values))} that are not")
    lengths = numpy.linalg.norm([columns[f"rot_{i}"] for i in range(4)], axis=0)
    check((lengths > 0).all(), f"{file}: expected quaternions that turn, found {numpy.sum(lengths == 0)} that are 0")
    # Viewers add no origin: cameras.json would be elsewhere for them.
    check(not any("gld:origin" in comment for comment in ply.comments),
          f"{file}: expected the coordinates of cameras.json, found gld:origin")
    return columns


def test_refusals(file, scratch):
    """What read_splats refuses, so that it is known to look: a file of the first Gaussians that is broken in one way each."""
    data = file.read_bytes()
    start = data.index(b"end_header\n") + len(b"end_header\n")
    count, stride = 100, 4 * data[:start].count(b"\nproperty ")
    all_of_them = f"element vertex {(len(data) - start) // stride}\n".encode()
    check(all_of_them in data[:start], f"{file}: expected {all_of_them} in its header")
    head = data[:start].replace(all_of_them, f"element vertex {count}\n".encode())
    body = data[start:start + count * stride]

    def renamed(old, new):
        check(head.count(old) == 1, f"{file}: expected {old} once, found {head.count(old)} times")
        return head.replace(old, new) + body

    def with_value(place, value):
        return head + body[:4 * place] + struct.pack("<f", value) + body[4 * place + 4:]

    # Each as (what it is, the file's bytes, what the refusal says).
    wrong = [
        ("a property of another name", renamed(b"float rot_3\n", b"float rot_w\n"), "expected properties"),
        ("properties in another order", renamed(b"float opacity\nproperty float scale_0\n", b"float scale_0\nproperty float opacity\n"),
         "expected properties"),
        ("harmonics of no whole degree", renamed(b"property float f_rest_44\n", b""), "expected 0, 9, 24 or 45"),
        ("integers", renamed(b"float opacity\n", b"int opacity\n"), "expected opacity to be float"),
        ("big-endian", renamed(b"binary_little_endian", b"binary_big_endian"), "little-endian"),
        ("a byte less", head + body[:-1], "that plyfile reads"),
        ("a Gaussian less", head + body[:-stride], "that plyfile reads"),
        ("a byte more", head + body + b"\0", "expected bytes"),
        ("an element of another name", renamed(b"element vertex", b"element points"), "expected elements"),
        ("a mean that is no number", with_value(1, float("nan")), "expected finite y"),
        ("an opacity without end", with_value(stride // 4 - 8, float("inf")), "expected finite opacity"),
        ("a quaternion of 0", head + body[:stride - 16] + bytes(16) + body[stride:], "expected quaternions"),
        ("an origin", head.replace(b"element vertex", b"comment gld:origin 1 2 3\nelement vertex") + body, "gld:origin"),
    ]
    broken = scratch / "broken.ply"
    broken.write_bytes(head + body)
    read_splats(broken)
    for what, content, sentence in wrong:
        broken.write_bytes(content)
        try:
            read_splats(broken)
        except AssertionError as error:
            check(sentence in str(error), f"{broken}, {what}: expected a refusal that says {sentence!r}, found {error}")
        else:
            raise AssertionError(f"{broken}, {what}: expected a refusal, found none")


# The drawing.

def harmonics(x, y, z):
    """The real spherical harmonics up to degree 3 in the order and with the signs that 3DGS has: (16, n)."""
    return numpy.array([
        numpy.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * z * z - x * x - y * y),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (x * x - y * y),
        -0.5900435899266435 * y * (3 * x * x - y * y),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * z * z - x * x - y * y),
        0.3731763325901154 * z * (2 * z * z - 3 * x * x - 3 * y * y),
        -0.4570457994644658 * x * (4 * z * z - x * x - y * y),
        1.445305721320277 * z * (x * x - y * y),
        -0.5900435899266435 * x * (x * x - 3 * y * y),
    ])


def coefficients(columns):
    """(colours, harmonics, Gaussians): f_rest has all of red, then all of green, then all of blue."""
    rest = sum(name.startswith("f_rest_") for name in columns)
    constant = numpy.array([[columns[f"f_dc_{c}"]] for c in range(3)])
    others = numpy.array([columns[f"f_rest_{i}"] for i in range(rest)]).reshape(3, rest // 3, -1)
    return numpy.concatenate([constant, others], axis=1)


def with_transposed_harmonics(columns):
    """As if f_rest had all colours of the first harmonic, then those of the next."""
    rest = sum(name.startswith("f_rest_") for name in columns)
    swapped = dict(columns)
    for channel in range(3):
        for k in range(rest // 3):
            swapped[f"f_rest_{channel * (rest // 3) + k}"] = columns[f"f_rest_{3 * k + channel}"]
    return swapped


def draw(columns, camera):
    """Over black: (height, width, 3). A camera is a frame of cameras.json."""
    world_from_camera = numpy.array(camera["world_from_camera"])
    axes, centre = world_from_camera[:3, :3], world_from_camera[:3, 3]
    width, height = camera["width"], camera["height"]
    means = numpy.stack([columns[name] for name in "xyz"], axis=1)
    x, y, z = ((means - centre) @ axes).T
    # The published rasteriser's nearest depth.
    kept = numpy.flatnonzero(z > 0.2)
    x, y, z, means = x[kept], y[kept], z[kept], means[kept]

    q = numpy.stack([columns[f"rot_{i}"][kept] for i in range(4)])
    qw, qx, qy, qz = q / numpy.linalg.norm(q, axis=0)
    turns = numpy.array([
        [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)],
        [2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)],
        [2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)],
    ]).transpose(2, 0, 1)
    scales = numpy.exp(numpy.stack([columns[f"scale_{i}"][kept] for i in range(3)], axis=1))
    roots = axes.T @ (turns * scales[:, None, :])

    # The projection's derivative, at most 30 % outside of the picture, where it would grow without bound.
    across = numpy.clip(x / z, -1.3 * camera["cx"] / camera["fx"], 1.3 * (width - camera["cx"]) / camera["fx"])
    down = numpy.clip(y / z, -1.3 * camera["cy"] / camera["fy"], 1.3 * (height - camera["cy"]) / camera["fy"])
    derivative = numpy.zeros((len(kept), 2, 3))
    derivative[:, 0, 0], derivative[:, 0, 2] = camera["fx"] / z, -camera["fx"] * across / z
    derivative[:, 1, 1], derivative[:, 1, 2] = camera["fy"] / z, -camera["fy"] * down / z
    spread = derivative @ roots
    covariance = spread @ spread.transpose(0, 2, 1) + 0.3 * numpy.eye(2)
    a, b, d = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = a * d - b * b
    inverse = numpy.stack([d, -b, a], axis=1) / determinant[:, None]
    radius = numpy.ceil(3 * numpy.sqrt((a + d) / 2 + numpy.sqrt(numpy.maximum((a - d) ** 2 / 4 + b * b, 0.1))))
    # In pixels counted from the middle of the first.
    u = camera["fx"] * x / z + camera["cx"] - 0.5
    v = camera["fy"] * y / z + camera["cy"] - 0.5

    directions = means - centre
    sides = directions.T / numpy.linalg.norm(directions, axis=1)
    sums = coefficients(columns)[:, :, kept]
    colours = numpy.maximum(numpy.einsum("ckn,kn->nc", sums, harmonics(*sides)[:sums.shape[1]]) + 0.5, 0)
    opacities = 1 / (1 + numpy.exp(-columns["opacity"][kept]))

    picture, left = numpy.zeros((height, width, 3)), numpy.ones((height, width))
    low_x, high_x = numpy.maximum(u - radius, 0).astype(int), numpy.minimum(u + radius + 1, width).astype(int)
    low_y, high_y = numpy.maximum(v - radius, 0).astype(int), numpy.minimum(v + radius + 1, height).astype(int)
    for i in numpy.argsort(z, kind="stable"):
        if low_x[i] >= high_x[i] or low_y[i] >= high_y[i]:
            continue
        rows, columns_of = slice(low_y[i], high_y[i]), slice(low_x[i], high_x[i])
        dx = numpy.arange(low_x[i], high_x[i]) - u[i]
        dy = (numpy.arange(low_y[i], high_y[i]) - v[i])[:, None]
        power = -0.5 * (inverse[i, 0] * dx * dx + inverse[i, 2] * dy * dy) - inverse[i, 1] * dx * dy
        alpha = numpy.minimum(opacities[i] * numpy.exp(power), 0.99)
        # What 8 bits cannot show is left out, and what lies behind a pixel that is full.
        alpha[(alpha < 1 / 255) | (left[rows, columns_of] < 1e-4)] = 0
        weight = alpha * left[rows, columns_of]
        picture[rows, columns_of] += weight[:, :, None] * colours[i]
        left[rows, columns_of] -= weight
    return picture


def with_real_part_last(columns):
    """As if the real part were written last."""
    return dict(columns, rot_0=columns["rot_3"], rot_1=columns["rot_0"], rot_2=columns["rot_1"], rot_3=columns["rot_2"])


def test_sources(columns, run, frames):
    """The photographs that were fitted, and that Gaussians which are read wrongly do not show them."""
    for frame in frames:
        photograph = read_png(run / frame["image"])
        right = psnr(draw(columns, frame), photograph)
        print(f"{frame['name']}: drawn here, beside its photograph: {right:.2f} dB")
        check(right >= LEAST_PSNR, f"{run}, {frame['name']}: expected at least {LEAST_PSNR} dB of the photograph, found {right:.2f}")
        if frame is not frames[0]:
            continue
        for what, wrong, most in [
                ("x mirrored", dict(columns, x=-columns["x"]), LEAST_PSNR),
                ("harmonics transposed", with_transposed_harmonics(columns), right - LEAST_LOSS),
                ("quaternions with w last", with_real_part_last(columns), right - LEAST_LOSS)]:
            found = psnr(draw(wrong, frame), photograph)
            print(f"{frame['name']}: drawn here with {what}: {found:.2f} dB")
            check(found < most, f"{run}, {frame['name']}, {what}: expected less than {most:.2f} dB, found {found:.2f}")


def test_views_between(columns, between, rendered):
    """Generated views that nothing was fitted to, as gld shows the Gaussians and as they are drawn here."""
    generated, shown = frames_of(between), frames_of(rendered)
    expect([one["name"] for one in shown], [one["name"] for one in generated], "views", rendered)
    sources = [one for one in generated if one["role"] == "source"]
    targets = [one for one in generated if one["role"] == "target"]
    for frame in targets[:-1]:
        name, truth, by_gld = frame["name"], read_png(between / frame["image"]), read_png(rendered / "images" / f"{frame['name']}.png")
        found = psnr(by_gld, truth)
        copied = [psnr(read_png(between / one["image"]), truth) for one in sources]
        print(f"{name}: rendered by gld, beside the generated view: {found:.2f} dB (the better source photograph: {max(copied):.2f} dB)")
        check(found >= LEAST_PSNR, f"{rendered}, {name}: expected at least {LEAST_PSNR} dB of the generated view, found {found:.2f}")
        check(found > max(copied) + LEAST_LOSS,
              f"{rendered}, {name}: expected {LEAST_LOSS} dB more than a source photograph has, {max(copied):.2f}, found {found:.2f}")
    frame = targets[len(targets) // 2]
    drawn = draw(columns, frame)
    beside = psnr(drawn, read_png(rendered / "images" / f"{frame['name']}.png"))
    found = psnr(drawn, read_png(between / frame["image"]))
    print(f"{frame['name']}: drawn here, beside gld's rendering: {beside:.2f} dB, beside the generated view: {found:.2f} dB")
    check(beside >= LEAST_PSNR_BESIDE_GLD,
          f"{frame['name']}: expected gld to show what is drawn here, at {LEAST_PSNR_BESIDE_GLD} dB or more, found {beside:.2f}")
    check(found >= LEAST_PSNR, f"{frame['name']}: expected a drawing of at least {LEAST_PSNR} dB of the generated view, found {found:.2f}")


def frames_of(folder):
    return json.loads((folder / "cameras.json").read_text())["frames"]


def poses_of(frames):
    return [one["world_from_camera"] for one in frames]


def main():
    begun = time.monotonic()
    program, scratch = sys.argv[1], pathlib.Path(sys.argv[2]).resolve()
    root = pathlib.Path(__file__).resolve().parents[2]
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)

    def gld(*arguments):
        command = [str(one) for one in (program, *arguments, "--threads", 1, "--quiet")]
        done = subprocess.run(command, check=False)
        expect(done.returncode, 0, "the exit status", " ".join(command))

    gld("synth", "--seed", 910000, "--scene-count", 1, "--frames", 12, "--width", 448, "--height", 448, "--out", scratch / "drawn")
    scene = next((scratch / "drawn/scenes").iterdir())
    orbit, between, fit, rendered = (scratch / name for name in ("orbit", "between", "fit", "rendered"))
    # The demo's orbit has two views, the ends of its arc; with four there are two that stand between.
    for folder, views in [(orbit, 2), (between, 4)]:
        gld("sample", "--model", root / "configs/tiny", "--scene", scene, "--sources", "0,3", "--path", "orbit", "--orbit-degrees", 20,
            "--frames", views, "--outputs", "image,depth", "--out", folder)
    ends, more = ([one for one in frames_of(folder) if one["role"] == "target"] for folder in (orbit, between))
    expect(poses_of([more[0], more[-1]]), poses_of(ends), "the same arc,", between)
    # Few steps for the sake of time, at rates with which harmonics and turns go so far in them that it shows where they
    # are read wrongly.
    gld("splat", "fit", "--run", orbit, "--held-out", 1, "--steps", 200, "--degree-every", 20, "--harmonic", 0.0006, "--rotation", 0.01,
        "--out", fit)
    gld("splat", "render", "--splats", fit, "--path", between / "cameras.json", "--frames", 0, "--out", rendered)

    file = fit / "splats.ply"
    columns = read_splats(file)
    expect(sum(name.startswith("f_rest_") for name in columns), 45, "harmonics of degree 3,", file)
    test_refusals(file, scratch)
    test_sources(columns, orbit, [one for one in frames_of(orbit) if one["role"] == "source"])
    # The fit knows one generated view, the end of the arc. The other end was held out.
    expect([one["name"] for one in frames_of(fit) if one["role"] == "target"], [ends[0]["name"]], "held out", fit)
    held_out = json.loads((fit / "report.json").read_text())["held_out_psnr"]
    print(f"{ends[0]['name']}: held out, by the fit's report: {held_out:.2f} dB")
    check(held_out >= LEAST_PSNR, f"{fit}: expected at least {LEAST_PSNR} dB of the held-out view, found {held_out:.2f}")
    test_views_between(columns, between, rendered)
    print(f"all of it in {time.monotonic() - begun:.0f} s")


if __name__ == "__main__":
    main()
