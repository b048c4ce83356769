#!/usr/bin/env python3
"""A scene with cameras from a folder of photographs, by Debian's colmap alone: nothing of ours has a part in its cameras.

    scripts/bench/registered_scene.py PHOTOGRAPHS SCENE [--longest 1000]

Turned as EXIF says, made smaller (Pillow), one lens with a radial distortion for all, which is taken out of the pictures
again. SCENE is the COLMAP folder (images/, sparse/) that gld reads.
"""
import argparse
import os
import pathlib
import subprocess
import tempfile

from PIL import Image, ImageOps


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("photographs", type=pathlib.Path)
    parser.add_argument("scene", type=pathlib.Path)
    parser.add_argument("--longest", type=int, default=1000, help="pixels of the longer side")
    arguments = parser.parse_args()
    if arguments.scene.exists():
        parser.error(f"expected no folder {arguments.scene}, found one; choose another or remove it")
    files = sorted(arguments.photographs.iterdir()) if arguments.photographs.is_dir() else []
    if len(files) < 3:
        parser.error(f"expected at least 3 photographs in {arguments.photographs}, found {len(files)}")

    with tempfile.TemporaryDirectory() as work:
        images = pathlib.Path(work, "images")
        images.mkdir()
        for file in files:
            picture = ImageOps.exif_transpose(Image.open(file)).convert("RGB")
            picture.thumbnail((arguments.longest, arguments.longest), Image.LANCZOS)
            picture.save(images / (file.stem + ".png"))

        def colmap(command, *options):
            subprocess.run(["colmap", command, *options], check=True, stdout=subprocess.DEVNULL,
                           env={**os.environ, "QT_QPA_PLATFORM": "offscreen"})

        data = ["--database_path", f"{work}/features.db"]
        colmap("feature_extractor", *data, "--image_path", str(images), "--ImageReader.single_camera", "1",
               "--ImageReader.camera_model", "SIMPLE_RADIAL", "--SiftExtraction.use_gpu", "0")
        colmap("exhaustive_matcher", *data, "--SiftMatching.use_gpu", "0")
        pathlib.Path(work, "models").mkdir()
        colmap("mapper", *data, "--image_path", str(images), "--output_path", f"{work}/models")
        colmap("image_undistorter", "--image_path", str(images), "--input_path", f"{work}/models/0",
               "--output_path", str(arguments.scene))
    print(f"{arguments.scene}: {len(list((arguments.scene / 'images').iterdir()))} of {len(files)} photographs registered")


if __name__ == "__main__":
    main()
