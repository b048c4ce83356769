#!/usr/bin/env python3
"""Times evaluations of the published M1 at full size with random weights for beside_python.py. Prints a line of JSON.

Needs PyTorch and what the published stage2.models.DDT imports (timm, einops, transformers, omegaconf, regex).
"""
import argparse
import importlib
import json
import pathlib
import sys
import time
import types

import torch
from omegaconf import OmegaConf


def package(name, folder):
    """A package whose __init__ is not run: what it imports is not needed here."""
    made = types.ModuleType(name)
    made.__path__ = [str(folder)]
    sys.modules[name] = made


def published_model(checkout):
    package("stage2", checkout / "src/stage2")
    package("stage2.models", checkout / "src/stage2/models")
    settings = OmegaConf.load(checkout / "configs/training/DA3_level1.yaml").stage_2.params
    modules = importlib.import_module("stage2.models.DDT")
    model = modules.DiTwDDTHead(**OmegaConf.to_container(settings)).eval()
    with torch.no_grad():  # as gld bench forward fills its own: its zero-initialised layers would make denormal numbers
        for parameter in model.parameters():
            if parameter.dim() < 2:
                parameter.fill_(0.5)
            else:
                parameter.uniform_(-1, 1).div_(parameter[0].numel() ** 0.5)
    return model, settings


def inputs_of(settings, views, sources, width, height):
    patch = settings.cam_patch_size
    latent = torch.randn(views, 2 * settings.in_channels, height // patch, width // patch)
    latent[sources:, :settings.in_channels] = 0  # features of sources alone are known
    poses = torch.eye(4).repeat(1, views, 1, 1)
    poses[0, :, 0, 3] = -0.2 * torch.arange(views)
    focal = float(max(width, height))
    intrinsics = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]).repeat(1, views, 1, 1)
    return dict(x=latent, t=torch.full((views,), 0.7), total_view=views,
                camera_embedding=torch.randn(views, 7, height, width), viewmats=poses, Ks=intrinsics,
                prope_image_size=(height, width), cond_num=sources)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--published", type=pathlib.Path, required=True)
    parser.add_argument("--precision", choices=["float32", "bfloat16"], required=True)
    for name in ("views", "sources", "width", "height", "repeats", "threads"):
        parser.add_argument("--" + name, type=int, required=True)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(1)
    model, settings = published_model(options.published)

    def evaluate(arguments):
        start = time.perf_counter()
        velocity = model(**arguments)
        seconds = time.perf_counter() - start
        if not torch.isfinite(velocity).all():
            sys.exit("published_evaluation: expected finite velocities, found others; the time says nothing.")
        return seconds

    # Autocast keeps the weights that it has cast until it ends, as it would over a whole solve: the untimed evaluation
    # casts them, and chooses threads and kernels.
    reduced = options.precision == "bfloat16"
    with torch.inference_mode(), torch.autocast("cpu", dtype=torch.bfloat16, enabled=reduced):
        evaluate(inputs_of(settings, 2, 1, 56, 56))
        arguments = inputs_of(settings, options.views, options.sources, options.width, options.height)
        seconds = [evaluate(arguments) for _ in range(options.repeats)]
    print(json.dumps({"seconds": seconds,
                      "parameters": sum(p.numel() for p in model.parameters()),
                      "torch": torch.__version__, "vectors": torch.backends.cpu.get_cpu_capability(),
                      "blas": "mkl" if torch.backends.mkl.is_available() else "other"}))


if __name__ == "__main__":
    main()
