"""The scene.glb that gld export makes of a run, held to the glTF 2.0 schema and read by other programs, its cameras beside the run's.

glb_schema_test.py WRITE_DRAWN_RUN GLD SCRATCH

WRITE_DRAWN_RUN is tests/support/write_drawn_run, GLD the program. The schema is Khronos' own, of which pip's trimesh brings a copy, and
jsonschema is what compares with it; trimesh reads the file too, and its scene graph, in double precision, says where cameras are; Assimp reads it in floats, and
its own glTF of it is compared as well. Debian's python3-numpy, python3-jsonschema and assimp-utils and build/venv-testing are
what it needs (scripts/setup.sh --testing).
"""

import copy
import io
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
POSE_ERROR = 1e-6  # of the scene's size, and of a rotation's entries
INTRINSICS_ERROR = 1e-12  # relative
HALF_TURN_ABOUT_X = numpy.diag([1.0, -1.0, -1.0, 1.0])
# So far out floats round by more than a millionth of a room, and the file is recentred.
FAR = numpy.array([5000.25, -3000.5, 800.125])


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


def with_header(file, header):
    """The bytes of a GLB with other JSON."""
    data = file.read_bytes()
    size = struct.unpack("<I", data[12:16])[0]
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size:]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), JSON_CHUNK) + text + rest


def compare_poses(file, header, cameras):
    """Every camera of the file, with HEADER for its JSON, is where the run's is; returns the largest error."""
    # trimesh takes a file's first camera for a child of the world and overwrites a node with it: it gets the nodes without.
    plain = copy.deepcopy(header)
    plain.pop("cameras", None)
    for node in plain["nodes"]:
        node.pop("camera", None)
    scene = trimesh.load(io.BytesIO(with_header(file, plain)), file_type="glb", force="scene")
    names = {view["name"] + " camera": numpy.array(view["world_from_camera"]) for view in cameras}
    check(names.keys() <= set(scene.graph.nodes), f"{file}: expected cameras {sorted(names)}, found {sorted(scene.graph.nodes)}")
    shown = numpy.vstack([scene.bounds] + [scene.graph.get(name)[0][:3, 3] for name in names])
    low, high = shown.min(axis=0), shown.max(axis=0)
    size = numpy.linalg.norm(high - low)

    # y and z change their signs from our world to glTF's (y_up); far from the origin a scene is moved there before (recentred).
    moved = numpy.eye(4)
    recentred = "recentred" in scene.graph.nodes
    if recentred:
        moved[:3, 3] = scene.graph.get("recentred", frame_from="y_up")[0][:3, 3]
        # By the middle of all that is shown, rounded to floats.
        beside = numpy.abs(low + high) / 2
        check((beside <= POSE_ERROR * size + numpy.abs(moved[:3, 3]).max() / 2**24).all(), f"{file}: expected the scene about the origin, found it {beside} beside")
    largest = 0.0
    for name, pose in names.items():
        for frame, expected in {
                scene.graph.base_frame: HALF_TURN_ABOUT_X @ moved @ pose @ HALF_TURN_ABOUT_X,
                # Below it a node moves back: this is the world of cameras.json. glTF's camera looks along -z with y up.
                "recentred" if recentred else "y_up": pose @ HALF_TURN_ABOUT_X}.items():
            found = scene.graph.get(name, frame_from=frame)[0]
            error = max(numpy.abs(found - expected)[:3, :3].max(), numpy.linalg.norm((found - expected)[:3, 3]) / size)
            check(error <= POSE_ERROR, f"{file}, {name} in {frame}: expected the pose\n{expected}\nwithin {POSE_ERROR} of the scene's size {size}, found\n{found}")
            largest = max(largest, error)
    return largest


def compare_intrinsics(file, header, cameras):
    """Every camera of the file has the run's K, in glTF's own terms too where it has such; returns the largest relative error."""
    eyes = {node["name"]: node for node in header["nodes"] if "fx" in node.get("extras", {})}
    largest = 0.0
    for view in cameras:
        node = eyes[view["name"] + " camera"]
        extras = node["extras"]
        for key in ["role", "width", "height"]:
            check(extras[key] == view[key], f"{file}, {node['name']}: expected {key} {view[key]}, found {extras[key]}")
        numbers = {key: (extras[key], view[key]) for key in ["fx", "fy", "cx", "cy"]}
        if "camera" in node:
            perspective = header["cameras"][node["camera"]]["perspective"]
            numbers["yfov"] = (perspective["yfov"], 2 * numpy.arctan(view["height"] / (2 * view["fy"])))
            numbers["aspectRatio"] = (perspective["aspectRatio"], view["width"] * view["fy"] / (view["height"] * view["fx"]))
        for key, (found, expected) in numbers.items():
            error = abs(found / expected - 1)
            check(error <= INTRINSICS_ERROR, f"{file}, {node['name']}: expected {key} {expected}, found {found}")
            largest = max(largest, error)
    return largest


def compare_as_assimp_writes(file, cameras):
    """The same poses in the glTF that Assimp writes of what it has read, whose numbers are all digits of its floats."""
    again = file.parent.parent / (file.parent.name + "_assimp.glb")
    subprocess.run(["assimp", "export", file, again, "-fglb2"], check=True, stdout=subprocess.DEVNULL)
    return compare_poses(again, json_of(again), cameras)


def wrong_cameras(file, header, cameras):
    """That the comparison refuses other cameras; returns how many were tried."""
    number = {node["name"]: i for i, node in enumerate(header["nodes"])}
    view = cameras[-1]["name"]
    box = trimesh.load(file, force="scene").bounds
    size = float(numpy.linalg.norm(box[1] - box[0]))

    def node(name, key, value):
        return set_at("nodes", number[name], key, value)

    pose = header["nodes"][number[view]]
    x, y, z = pose["translation"]
    changes = {
        "a mirrored axis": node("y_up", "scale", [1, 1, -1]),
        "a mirrored picture": node(view + " camera", "scale", [-1, 1, 1]),
        "y down": node("y_up", "rotation", [0, 0, 0, 1]),
        "a camera that looks back": node(view + " camera", "rotation", [0, 0, 0, 1]),
        "a rotation that is inverted": node(view, "rotation", [-part for part in pose["rotation"][:3]] + pose["rotation"][3:]),
        "a place on the other side": node(view, "translation", [-x, y, z]),
        "a place that is beside itself": node(view, "translation", [x, y, z + 3 * POSE_ERROR * size]),
        "another world": node("world", "translation", [0, 3 * POSE_ERROR * size, 0]),
        "another focal length": set_at("nodes", number[view + " camera"], "extras", "fx", cameras[-1]["fx"] * (1 + 1e-11)),
    }
    if "recentred" in number:
        moved = header["nodes"][number["recentred"]]["translation"]
        changes["another centre"] = node("recentred", "translation", [moved[0] + 1e-3 * size, *moved[1:]])
    for what, change in changes.items():
        changed = copy.deepcopy(header)
        change(changed)
        check(changed != header, f"expected {what} to change the file")
        try:
            compare_poses(file, changed, cameras)
            compare_intrinsics(file, changed, cameras)
        except AssertionError:
            continue
        raise AssertionError(f"{file}: expected the comparison to refuse {what}, found it accepted")
    return len(changes)


def move(run, by):
    """Moves a run of write_drawn_run in its world."""
    cameras = json.loads((run / "cameras.json").read_text())
    for view in cameras["frames"]:
        for row, number in zip(view["world_from_camera"], by):
            row[3] += number
    (run / "cameras.json").write_text(json.dumps(cameras))
    header, end, points = (run / "points.ply").read_bytes().partition(b"end_header\n")
    vertex = numpy.dtype([("place", "<f4", 3), ("colour", "u1", 3), ("confidence", "<f4")])
    points = numpy.frombuffer(points, vertex).copy()
    points["place"] = points["place"] + by
    (run / "points.ply").write_bytes(header + end + points.tobytes())


def main():
    write_run, gld, scratch = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3])
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    for name, words in {"plain": ["112x84", "2", "2", "plain"], "odd": ["84x112", "3", "1", "odd"], "far": ["112x84", "2", "2", "plain"]}.items():
        run, out = scratch / name, scratch / (name + "_export")
        subprocess.run([write_run, run, *words], check=True, stdout=subprocess.DEVNULL)
        if name == "far":
            move(run, FAR)
        subprocess.run([gld, "export", run, "--as", "glb", "--out", out, "--quiet"], check=True)
        file = out / "scene.glb"
        header = json_of(file)
        trimesh.exchange.gltf.validate(header)
        views = int(words[1]) + int(words[2])
        # glTF has no camera whose principal point is off the centre: the node keeps its intrinsics alone.
        cameras = [node for node in header["nodes"] if "fx" in node.get("extras", {})]
        check(len(cameras) == views, f"{file}: expected {views} nodes with intrinsics, found {len(cameras)}")
        shown = 0 if name == "odd" else views
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

        run_cameras = json.loads((run / "cameras.json").read_text())["frames"]
        check(len(run_cameras) == views, f"{run}: expected {views} cameras, found {len(run_cameras)}")
        check(("recentred" in scene.graph.nodes) == (name == "far"), f"{file}: expected a scene that is recentred where it is far, and there alone")
        error, k_error = compare_poses(file, header, run_cameras), compare_intrinsics(file, header, run_cameras)
        assimp_error = compare_as_assimp_writes(file, run_cameras)
        tried = wrong_cameras(file, header, run_cameras)
        print(f"{file.name} of {name}: {views} cameras within {error:.1e} of the scene's size, {assimp_error:.1e} by Assimp, intrinsics within {k_error:.1e}; {tried} wrong ones refused")
        print(f"{file.name} of {name}: as the schema wants, {len(surfaces)} surfaces and {len(clouds[0].vertices)} points read by trimesh {trimesh.__version__}")


main()
