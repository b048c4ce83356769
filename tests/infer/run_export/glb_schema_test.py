"""The scene.glb that gld export makes of a run, held to the glTF 2.0 schema and read by another program.

glb_schema_test.py WRITE_DRAWN_RUN GLD SCRATCH

WRITE_DRAWN_RUN is tests/support/write_drawn_run, GLD the program. The schema is Khronos' own, of which pip's trimesh brings a copy, and
jsonschema is what compares with it; trimesh reads the file too. Debian's python3-numpy and python3-jsonschema and
build/venv-testing are what it needs (scripts/setup.sh --testing).
"""

import copy
import json
import pathlib
import shutil
import struct
import subprocess
import sys

import jsonschema
import numpy
import trimesh
import trimesh.exchange.gltf

JSON_CHUNK = 0x4E4F534A


def check(holds, what):
    if not holds:
        raise AssertionError(what)


def json_of(file):
    data = file.read_bytes()
    magic, version, length = struct.unpack("<4sII", data[:12])
    check((magic, version, length) == (b"glTF", 2, len(data)), f"{file}: expected a GLB of version 2 as long as it says, found {magic}, {version}, {length}")
    size, kind = struct.unpack("<II", data[12:20])
    check(kind == JSON_CHUNK, f"{file}: expected JSON in the first chunk, found {kind:#x}")
    return json.loads(data[20:20 + size])


def refused(header, change, what):
    """That the schema refuses what is changed: a comparison that accepts anything would find no fault."""
    changed = copy.deepcopy(header)
    change(changed)
    try:
        trimesh.exchange.gltf.validate(changed)
    except jsonschema.exceptions.ValidationError:
        return
    raise AssertionError(f"the schema: expected to refuse {what}, found it accepted")


def set_at(*keys_and_value):
    *keys, last, value = keys_and_value

    def change(header):
        for key in keys:
            header = header[key]
        header[last] = value
    return change


def main():
    write_run, gld, scratch = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3])
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    for name, words in {"plain": ["112x84", "2", "2", "plain"], "odd": ["84x112", "3", "1", "odd"]}.items():
        run, out = scratch / name, scratch / (name + "_export")
        subprocess.run([write_run, run, *words], check=True, stdout=subprocess.DEVNULL)
        subprocess.run([gld, "export", run, "--as", "glb", "--out", out, "--quiet"], check=True)
        file = out / "scene.glb"
        header = json_of(file)
        trimesh.exchange.gltf.validate(header)
        views = int(words[1]) + int(words[2])
        # glTF has no camera whose principal point is off the centre: the node keeps its intrinsics alone.
        cameras = [node for node in header["nodes"] if "fx" in node.get("extras", {})]
        check(len(cameras) == views, f"{file}: expected {views} nodes with intrinsics, found {len(cameras)}")
        shown = views if name == "plain" else 0
        check(len(header.get("cameras", [])) == shown, f"{file}: expected {shown} cameras, found {len(header.get('cameras', []))}")

        refused(header, lambda changed: changed["asset"].pop("version"), "a file without a version")
        refused(header, set_at("accessors", 0, "componentType", "float"), "numbers of a kind that is a word")
        refused(header, set_at("bufferViews", 0, "byteOffset", -4), "bytes before the first")
        refused(header, set_at("nodes", 0, "rotation", [0, 0, 1]), "a rotation of three numbers")
        if shown:
            refused(header, set_at("cameras", 0, "perspective", "yfov", 0), "a camera that sees nothing")
        refused(header, set_at("meshes", 0, "primitives", []), "a mesh of nothing")
        refused(header, set_at("materials", 0, "alphaCutoff", -1), "a cut below nothing")

        scene = trimesh.load(file, force="scene")
        surfaces = [part for part in scene.geometry.values() if isinstance(part, trimesh.Trimesh)]
        clouds = [part for part in scene.geometry.values() if isinstance(part, trimesh.PointCloud)]
        check(len(surfaces) == views, f"{file}: expected {views} surfaces, found {len(surfaces)}")
        check(len(clouds) == 1, f"{file}: expected one cloud, found {len(clouds)}")
        for part in surfaces + clouds:
            check(len(part.vertices) > 100 and numpy.isfinite(part.vertices).all(), f"{file}: expected finite places, more than 100")
        # The same room from all views: a surface of another frame or unit would lie elsewhere.
        box = scene.bounds[1] - scene.bounds[0]
        cloud = clouds[0].bounds[1] - clouds[0].bounds[0]
        check((box <= 3 * cloud.max()).all(), f"{file}: expected surfaces where the cloud is, of {cloud}, found a scene of {box}")
        print(f"{file.name} of {name}: as the schema wants, {len(surfaces)} surfaces and {len(clouds[0].vertices)} points read by trimesh {trimesh.__version__}")


main()
