#!/usr/bin/env python3
"""Cuts tests/data out of the folder of shared data: how every file there was made, but for the pictures of the RealEstate10K
clip, which are drawn (draw_test_clip.py). Needs Python 3 with Pillow, and is not needed to build or test.

    scripts/cut_test_data.py ../shared tests/data

Running it again on the same folder gives the same bytes (of the JPEG files: with the same Pillow).
"""
import collections
import io
import pickle
import shutil
import struct
import sys
import types
import zipfile
from pathlib import Path

from PIL import Image

from draw_test_clip import drawn

CLIP = "gld_layout_5e040cd0758dcc96"
TARTANAIR_FRAMES = ["000040", "000043"]
COLMAP_IMAGES = ["DSC_0001.JPG", "DSC_0005.JPG", "DSC_0010.JPG"]
COLMAP_POINTS = 600
TAEF2_TENSORS = 3


def copy(source, target):
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)


def copy_tree(source, target):
    for file in sorted(source.rglob("*")):
        if file.is_file():
            copy(file, target / file.relative_to(source))


def write_zip(file, members, method):
    file.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in members:
            entry = zipfile.ZipInfo(name)  # dated 1980: the same bytes every time
            entry.compress_type = method
            archive.writestr(entry, data)


def cut_clip(source, target):
    """The cameras of all 8 frames, those of the odd ones deflated, with the arrays in the other order, as they are found
    elsewhere in this layout. The pictures of the clip are frames of somebody's video: in their place stand drawn ones of a
    room under the same cameras, of the same size."""
    images = Path("nerfstudio") / "images_4"
    copy(source / "nerfstudio" / "transforms.json", target / "nerfstudio" / "transforms.json")
    for k in range(8):
        name = f"frame_{k:05d}"
        with Image.open(source / images / f"{name}.png") as picture:
            size = picture.size
        (target / images).mkdir(parents=True, exist_ok=True)
        pixels = drawn((source / images / f"{name}.npz").read_bytes(), *size)
        Image.frombytes("RGB", size, pixels).save(target / images / f"{name}.png", optimize=True)
        if k % 2 == 0:
            copy(source / images / f"{name}.npz", target / images / f"{name}.npz")
            continue
        with zipfile.ZipFile(source / images / f"{name}.npz") as archive:
            members = [(entry.filename, archive.read(entry)) for entry in reversed(archive.infolist())]
        write_zip(target / images / f"{name}.npz", members, zipfile.ZIP_DEFLATED)


def cut_tartanair(source, target):
    """Two neighbouring frames in full size, whose depth warps onto each other; the pictures, stored raw there, are
    compressed without loss."""
    names = sorted(file.name for file in (source / "image_left").iterdir())
    rows = [row for row in (source / "pose_left.txt").read_text().splitlines() if row.strip()]
    kept = [names.index(f"{frame}_left.png") for frame in TARTANAIR_FRAMES]
    (target / "image_left").mkdir(parents=True, exist_ok=True)
    for k in kept:
        with Image.open(source / "image_left" / names[k]) as picture:
            picture.save(target / "image_left" / names[k], optimize=True)
        depth = names[k].replace(".png", "_depth.npy")
        copy(source / "depth_left" / depth, target / "depth_left" / depth)
    (target / "pose_left.txt").write_text("".join(rows[k] + "\n" for k in kept))


def cut_colmap(source, binary, target, binary_target):
    """Three images and the points that all three see, in text and in binary form, as if COLMAP had been asked for
    these images alone; of the photographs their copies at half the width and height."""
    model, cut = source / "sparse" / "0", target / "sparse" / "0"
    cut.mkdir(parents=True, exist_ok=True)
    (binary_target / "sparse" / "0").mkdir(parents=True, exist_ok=True)
    copy(model / "cameras.txt", cut / "cameras.txt")
    copy(binary / "sparse" / "0" / "cameras.bin", binary_target / "sparse" / "0" / "cameras.bin")

    lines = [line for line in (model / "images.txt").read_text().splitlines() if not line.startswith("#")]
    images = {}  # id -> (header line, observations as triples of text)
    for header, observed in zip(lines[0::2], lines[1::2]):
        fields = header.split()
        if fields[9] in COLMAP_IMAGES:
            words = observed.split()
            images[int(fields[0])] = (header, list(zip(words[0::3], words[1::3], words[2::3])))
    points = {}
    for line in (model / "points3D.txt").read_text().splitlines():
        if line.startswith("#"):
            continue
        fields = line.split()
        track = list(zip(map(int, fields[8::2]), map(int, fields[9::2])))
        if set(images) <= {image for image, _ in track}:
            points[int(fields[0])] = (fields[:8], track)
    points = dict(sorted(points.items())[:COLMAP_POINTS])

    # Observations of the kept points keep their order and get new numbers; of the others every 40th stays, as a key
    # point without a point.
    renumbered = {}
    for image, (header, observed) in images.items():
        kept = [k for k, (_, _, point) in enumerate(observed)
                if int(point) in points or k % 40 == 0]
        renumbered[image] = {old: new for new, old in enumerate(kept)}
        images[image] = (header, [observed[k] if int(observed[k][2]) in points else (*observed[k][:2], "-1")
                                  for k in kept])
    comments = "# Cut from a larger model by scripts/cut_test_data.py\n"
    text = comments
    for header, observed in images.values():
        text += header + "\n" + " ".join(" ".join(triple) for triple in observed) + "\n"
    (cut / "images.txt").write_text(text)
    text = comments
    for fields, track in points.values():
        text += " ".join(fields + [f"{i} {renumbered[i][k]}" for i, k in track if i in images]) + "\n"
    (cut / "points3D.txt").write_text(text)

    cut_binary_images(binary / "sparse" / "0" / "images.bin", binary_target / "sparse" / "0" / "images.bin",
                      images, points, renumbered)
    cut_binary_points(binary / "sparse" / "0" / "points3D.bin", binary_target / "sparse" / "0" / "points3D.bin",
                      points, renumbered)
    (target / "images_2").mkdir(parents=True, exist_ok=True)
    for name in COLMAP_IMAGES:
        with Image.open(source / "images" / name) as picture:
            half = picture.resize((picture.width // 2, picture.height // 2), Image.LANCZOS)
            half.save(target / "images_2" / name, quality=85)


def cut_binary_images(source, target, images, points, renumbered):
    data, position, cut = source.read_bytes(), 8, b""
    for _ in range(struct.unpack_from("<Q", data)[0]):
        start = position
        image = struct.unpack_from("<I", data, start)[0]
        name_end = data.index(b"\0", start + 64) + 1
        count = struct.unpack_from("<Q", data, name_end)[0]
        position = name_end + 8 + 24 * count
        if image not in images:
            continue
        kept = list(renumbered[image])
        cut += data[start:name_end] + struct.pack("<Q", len(kept))
        for k in kept:
            x, y, point = struct.unpack_from("<ddq", data, name_end + 8 + 24 * k)
            cut += struct.pack("<ddq", x, y, point if point in points else -1)
    target.write_bytes(struct.pack("<Q", len(images)) + cut)


def cut_binary_points(source, target, points, renumbered):
    data, position, cut = source.read_bytes(), 8, b""
    for _ in range(struct.unpack_from("<Q", data)[0]):
        start = position
        point, length = struct.unpack_from("<Q", data, start)[0], struct.unpack_from("<Q", data, start + 43)[0]
        position = start + 51 + 8 * length
        if point not in points:
            continue
        track = [struct.unpack_from("<II", data, start + 51 + 8 * k) for k in range(length)]
        track = [(image, renumbered[image][k]) for image, k in track if image in renumbered]
        cut += data[start:start + 43] + struct.pack("<Q", len(track))
        for pair in track:
            cut += struct.pack("<II", *pair)
    target.write_bytes(struct.pack("<Q", len(points)) + cut)


class Storage:
    def __init__(self, kind, key, device, count):
        self.identity = ("storage", kind, key, device, count)


class Tensor:
    """What a tensor of a PyTorch file is to pickle: a call of torch._utils._rebuild_tensor_v2."""

    def __init__(self, *arguments):
        self.arguments = arguments

    def __reduce__(self):
        return REBUILD, self.arguments


def rebuild(*arguments):
    return Tensor(*arguments)


# Pickle names functions and types by their modules; with these it reads and writes torch's names without torch.
TORCH = {name: types.ModuleType(name) for name in ("torch", "torch._utils")}
for storage in ("FloatStorage", "HalfStorage"):
    setattr(TORCH["torch"], storage, type(storage, (), {"__module__": "torch"}))
rebuild.__module__, rebuild.__qualname__, rebuild.__name__ = "torch._utils", *2 * ("_rebuild_tensor_v2",)
TORCH["torch._utils"]._rebuild_tensor_v2 = REBUILD = rebuild
sys.modules.update(TORCH)


class Unpickler(pickle.Unpickler):
    def persistent_load(self, identity):
        return Storage(*identity[1:])


class Pickler(pickle.Pickler):
    def persistent_id(self, value):
        return value.identity if isinstance(value, Storage) else None


def cut_taef2(source, target):
    """The first tensors of an OrderedDict saved by PyTorch, in the same zip layout."""
    with zipfile.ZipFile(source) as archive:
        root = archive.namelist()[0].split("/")[0]
        tensors = Unpickler(io.BytesIO(archive.read(f"{root}/data.pkl"))).load()
        first = collections.OrderedDict(list(tensors.items())[:TAEF2_TENSORS])
        pickled = io.BytesIO()
        Pickler(pickled, protocol=2).dump(first)
        members = [(f"{root}/data.pkl", pickled.getvalue())]
        for key in sorted({tensor.arguments[0].identity[2] for tensor in first.values()}, key=int):
            members.append((f"{root}/data/{key}", archive.read(f"{root}/data/{key}")))
        members.append((f"{root}/version", archive.read(f"{root}/version")))
    write_zip(target, members, zipfile.ZIP_STORED)


def main():
    shared, data = Path(sys.argv[1]), Path(sys.argv[2])
    scenes = shared / "scenes"
    copy_tree(shared / "compact_cases", data / "reference_cases")
    for kind in ("backbone_vggt", "dpt_head_vggt", "camera_head_vggt", "backbone_dinov2"):
        copy_tree(shared / "compact_cases_later" / kind, data / "reference_cases" / kind)
    cut_clip(scenes / CLIP, data / "scenes" / CLIP)
    copy_tree(scenes / "re10k", data / "scenes" / "re10k")
    copy_tree(scenes / "hypersim_pieces", data / "scenes" / "hypersim_pieces")
    cut_tartanair(scenes / "tartanair_hospital", data / "scenes" / "tartanair_hospital")
    cut_colmap(scenes / "colmap_lund_door", scenes / "colmap_lund_door_binary",
               data / "scenes" / "colmap_lund_door", data / "scenes" / "colmap_lund_door_binary")
    copy_tree(shared / "stats", data / "stats")
    copy_tree(shared / "problems", data / "problems")
    copy(shared / "checkpoint_manifests.json", data / "checkpoint_manifests.json")
    for file in sorted((shared / "weights").glob("lpips_*.pth")):
        copy(file, data / "weights" / file.name)
    for part in ("encoder", "decoder"):
        cut_taef2(shared / "weights" / f"taef2_{part}.pth", data / "weights" / f"taef2_{part}_first_tensors.pth")


if __name__ == "__main__":
    main()
