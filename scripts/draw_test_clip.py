"""Drawn pictures of a room under given cameras, the same bytes everywhere: additions, products, quotients, roots and integers, and
nothing else. scripts/cut_test_data.py puts them in the place of the frames of somebody's video.
"""
import array
import io
import re
import struct
import zipfile

# The room around the clip's cameras (world: x right, y down, z forward; the cameras turn from +z to -x), and what stands in it:
# smallest and largest corner, and which patches are painted on it.
ROOM = ((-5.5, -1.3, -1.5), (3.0, 1.1, 8.0), 0)
BOXES = [
    ((-0.6, 0.2, 5.6), (0.9, 1.1, 6.6), 1),
    ((1.7, -0.2, 2.6), (2.6, 1.1, 4.4), 2),
    ((-4.6, -0.5, 2.4), (-3.7, 1.1, 3.4), 3),
    ((-3.4, 0.35, 5.0), (-2.2, 1.1, 6.0), 4),
    ((-3.2, 0.5, 1.0), (-2.4, 1.1, 1.7), 5),
]
PALETTE = [(196, 178, 150), (150, 96, 62), (92, 120, 138), (214, 208, 196), (120, 140, 92), (176, 74, 58), (70, 66, 72), (222, 182, 96)]
PATCHES = {0: 0.62, 1: 0.3, 2: 0.34, 3: 0.28, 4: 0.26, 5: 0.22}  # side of a patch, world units
SHADE = [0.82, 1.0, 0.92]  # of surfaces across x, y, z
SAMPLES = ((0.25, 0.25), (0.75, 0.25), (0.25, 0.75), (0.75, 0.75))  # of a pixel


def read_npy(data):
    """Numbers and shape of a small npy file of little-endian floats."""
    length = struct.unpack_from("<H", data, 8)[0]
    header = data[10:10 + length].decode()
    kind = {"<f4": "f", "<f8": "d"}[re.search(r"'descr': '([^']+)'", header)[1]]
    values = array.array(kind)
    values.frombytes(data[10 + length:])
    return list(values)


def hashed(a, b, c):
    """32 bits of three integers (the last rounds of MurmurHash3)."""
    h = (a * 0x9E3779B1 ^ b * 0x85EBCA77 ^ c * 0xC2B2AE3D) & 0xFFFFFFFF
    h = (h ^ h >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    h = (h ^ h >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return h ^ h >> 16


def painted(axis, side, u, v, kind):
    """A patch of one colour with a smaller one in it, at a place that no other patch has it at."""
    size = PATCHES[kind]
    i, j = u // size, v // size
    h = hashed(int(i) + 1000, int(j) + 1000, 16 * kind + 2 * axis + side)
    a, b = u / size - i, v / size - j
    left, top = 0.12 + (h >> 8 & 7) * 0.05, 0.12 + (h >> 11 & 7) * 0.05
    inside = left < a < left + 0.2 + (h >> 14 & 7) * 0.05 and top < b < top + 0.2 + (h >> 17 & 7) * 0.05
    return PALETTE[(h >> 3 & 7) if inside else (h & 7)]


def seen(origin, ray):
    """The colour along a ray: of the nearest box that it enters, else of the room's wall that it leaves by."""
    nearest, surface = None, None
    inverse = [1.0 / c if c != 0.0 else 1e30 for c in ray]
    for low, high, kind in BOXES:
        enter, leave, across = 0.0, 1e30, None
        for k in (0, 1, 2):
            a, b = (low[k] - origin[k]) * inverse[k], (high[k] - origin[k]) * inverse[k]
            if a > b:
                a, b = b, a
            if a > enter:
                enter, across = a, k
            if b < leave:
                leave = b
        if across is not None and enter < leave and (nearest is None or enter < nearest):
            nearest, surface = enter, (across, kind)
    if nearest is None:
        low, high, kind = ROOM
        for k in (0, 1, 2):
            leave = ((high if ray[k] > 0.0 else low)[k] - origin[k]) * inverse[k]
            if nearest is None or leave < nearest:
                nearest, surface = leave, (k, kind)
    across, kind = surface
    point = [origin[k] + nearest * ray[k] for k in (0, 1, 2)]
    u, v = (point[k] for k in (0, 1, 2) if k != across)
    colour = painted(across, 1 if ray[across] > 0.0 else 0, u, v, kind)
    return [SHADE[across] * c for c in colour]


def drawn(camera_file, width, height):
    """RGB bytes of the room as the camera of an npz file (`intrinsic`, `pose` = world_from_camera) sees it."""
    with zipfile.ZipFile(io.BytesIO(camera_file)) as archive:
        k, pose = read_npy(archive.read("intrinsic.npy")), read_npy(archive.read("pose.npy"))
    origin = [pose[4 * row + 3] for row in (0, 1, 2)]
    pixels = bytearray()
    for y in range(height):
        for x in range(width):
            total = [0.0, 0.0, 0.0]
            for right, down in SAMPLES:
                a, b = (x + right - k[2]) / k[0], (y + down - k[5]) / k[4]
                ray = [pose[4 * row] * a + pose[4 * row + 1] * b + pose[4 * row + 2] for row in (0, 1, 2)]
                colour = seen(origin, ray)
                for c in (0, 1, 2):
                    total[c] += colour[c]
            pixels += bytes(int(total[c] / len(SAMPLES) + 0.5) for c in (0, 1, 2))
    return bytes(pixels)
