#!/usr/bin/env python3
"""Makes the reference cases rgb_decoder_vggt and dpt_head_da3_replaced, and tests/data/dpt_decoder, with the published modules.

Needs PyTorch, safetensors, transformers (of RAE's decoder) and checkouts of
  --gld  cvlab-kaist/Geometric-Latent-Diffusion
  --da3  ByteDance-Seed/Depth-Anything-3
Weights and inputs are random and exact in float16; outputs are float32, and the note of each case says how far they lie from
the same modules in float64.
    scripts/make_published_cases.py --gld DIR --da3 DIR --out tests/data
"""
import argparse
import ast
import copy
import importlib.util
import json
import pathlib
import sys
import types

import torch
from safetensors.torch import save_file

IMAGENET_MEAN = torch.tensor([0.485, 0.456, 0.406]).reshape(1, 3, 1, 1)
IMAGENET_DEVIATION = torch.tensor([0.229, 0.224, 0.225]).reshape(1, 3, 1, 1)


def module_of(name, file):
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def package(name, folder):
    """A package whose __init__ is not run: what it imports is not needed here."""
    made = types.ModuleType(name)
    made.__path__ = [str(folder)]
    sys.modules[name] = made


def make_random(module):
    """Matrices of unit gain, norms near one, exact in float16; tables of positions stay."""
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            if "pos_embed" not in name:
                if parameter.dim() >= 2 and "trainable" not in name:
                    parameter.copy_(torch.randn_like(parameter) / parameter[0].numel() ** 0.5)
                elif "norm" in name and name.endswith("weight"):
                    parameter.copy_(1 + 0.2 * torch.randn_like(parameter))
                else:
                    parameter.copy_(0.1 * torch.randn_like(parameter))
            parameter.copy_(parameter.half().float())


def half(tensors, prefix=""):
    return {prefix + name: tensor.half().contiguous() for name, tensor in tensors.items()}


def largest_error(single, double):
    return max(((single[k].double() - double[k]).abs().max() / max(1, double[k].abs().max())).item() for k in double)


def write_case(folder, case, inputs, outputs, weights):
    folder.mkdir(parents=True, exist_ok=True)
    save_file(inputs, folder / "inputs.safetensors")
    save_file({name: tensor.contiguous() for name, tensor in outputs.items()}, folder / "outputs.safetensors")
    save_file(weights, folder / "weights.safetensors")
    (folder / "case.json").write_text(json.dumps(case, indent=2))


def observed(error):
    return (f"largest observed max|a - b| / max(1, max|b|): {error:.1e} "
            "(the published modules in float32 against float64)")


def rgb_decoder_case(gld, out):
    package("decoders", gld / "src/stage1/decoders")
    decoders = module_of("decoders.decoder", gld / "src/stage1/decoders/decoder.py")
    torch.manual_seed(5)
    config = decoders.ViTMAEConfig(
        hidden_size=4 * 64, decoder_hidden_size=32, decoder_num_hidden_layers=2, decoder_num_attention_heads=2,
        decoder_intermediate_size=64, patch_size=14, num_channels=3, hidden_act="gelu", hidden_dropout_prob=0.0,
        attention_probs_dropout_prob=0.0, layer_norm_eps=1e-12, qkv_bias=True, image_size=112)
    config._attn_implementation = "eager"
    decoder = decoders.GeneralDecoder_Variable(config, base_image_size=(112, 112)).eval()
    make_random(decoder)
    height, width, views, special = 56, 42, 2, 5
    tokens = (height // 14) * (width // 14)
    torch.manual_seed(6)
    # Generated levels carry special tokens, propagated ones do not.
    levels = [torch.randn(1, views, tokens + (special if level < 2 else 0), 64).half().float() for level in range(4)]
    features = torch.cat([level[:, :, -tokens:] for level in levels], -1).reshape(views, tokens, 256)

    def run(model, dtype):
        with torch.no_grad():
            logits = model(features.to(dtype), input_size=(height, width), drop_cls_token=False).logits
            image = model.unpatchify(logits, (height, width))
        return {"logits": logits, "image_imagenet_normalized": image,
                "image": image * IMAGENET_DEVIATION.to(dtype) + IMAGENET_MEAN.to(dtype)}

    single, double = run(decoder, torch.float32), run(copy.deepcopy(decoder).double(), torch.float64)
    case = {"kind": "rgb_decoder",
            "config": {"in_channels": 256, "hidden_size": 32, "num_layers": 2, "num_heads": 2, "intermediate_size": 64,
                       "patch_size": 14, "base_image_size": 112, "height": height, "width": width},
            "relative_tolerance": 4e-6,
            "note": "VGGT's RGB decoder: the four levels, special tokens of the generated ones stripped as "
                    "RAE_VGGT.decode does, are concatenated on channels | seed 5; weights and features exact in float16; "
                    + observed(largest_error(single, double))}
    write_case(out / "reference_cases/rgb_decoder_vggt", case, half({"features": features}), single,
               half(decoder.state_dict(), "decoder."))


def replaced_head_case(gld, da3, out):
    source = da3 / "src/depth_anything_3"
    package("depth_anything_3", source)
    package("depth_anything_3.model", source / "model")
    package("depth_anything_3.model.utils", source / "model/utils")
    sys.path.insert(0, str(da3 / "src"))
    from depth_anything_3.model.dualdpt import DualDPT

    torch.manual_seed(7)
    sizes = {"dim_in": 128, "features": 16, "out_channels": [8, 12, 16, 20], "aux_pyramid_levels": 2,
             "aux_out1_conv_num": 1}
    head = DualDPT(**sizes).eval()
    make_random(head)
    original = {name: tensor.clone() for name, tensor in head.state_dict().items()}
    other = DualDPT(**sizes).eval()
    make_random(other)
    checkpoint = {"model": {}, "epoch": 3}
    for name, tensor in other.state_dict().items():
        if name.startswith("scratch.output_conv2"):
            checkpoint["model"]["pred." + name] = tensor.clone()
        elif name.startswith(("scratch.refinenet", "projects")):
            checkpoint["model"]["decoder." + name] = tensor.clone()
    checkpoint["model"]["encoder.norm.weight"] = torch.ones(3)
    folder = out / "dpt_decoder"
    folder.mkdir(parents=True, exist_ok=True)
    torch.save(checkpoint, folder / "dpt_decoder.pt")
    save_file(half(original), folder / "head.safetensors")

    # The method alone, so that the release's own code puts the tensors in place.
    tree = ast.parse((gld / "src/stage1/rae_da3.py").read_text())
    method = next(node for item in tree.body if isinstance(item, ast.ClassDef) for node in item.body
                  if isinstance(node, ast.FunctionDef) and node.name == "_init_dpt_decoder")

    class DepthAnything3:
        def __init__(self, *_):
            self.model = types.SimpleNamespace(head=head)

        def load_state_dict(self, *_, **__):
            pass

    names = {"torch": torch, "DepthAnything3": DepthAnything3, "load_file": lambda path: {}}
    exec(compile(ast.Module(body=[method], type_ignores=[]), "rae_da3", "exec"), names)
    model = types.SimpleNamespace(encoder=types.SimpleNamespace(backbone=None), dpt_model_type="da3-base")
    names["_init_dpt_decoder"](model, "unused", str(folder / "dpt_decoder.pt"))
    replaced = model.rae_cl_decoder

    height, width, views = 42, 56, 2
    torch.manual_seed(8)
    levels = [torch.randn(1, views, (height // 14) * (width // 14), 128).half().float() for _ in range(4)]

    def run(model, dtype):
        with torch.no_grad():
            result = model([(level.to(dtype), torch.zeros(1, views, 128, dtype=dtype)) for level in levels], height,
                           width, 0)
        return {name: result[name][0] for name in ("depth", "depth_conf", "ray", "ray_conf")}

    single, double = run(replaced, torch.float32), run(copy.deepcopy(replaced).double(), torch.float64)
    case = {"kind": "dpt_head",
            "config": {**sizes, "patch_size": 14, "height": height, "width": width},
            "relative_tolerance": 9e-6,
            "note": "DA3's head after RAE_DA3._init_dpt_decoder put tests/data/dpt_decoder/dpt_decoder.pt into the place "
                    "of its tensors | seed 7; weights and levels exact in float16; "
                    + observed(largest_error(single, double))}
    write_case(out / "reference_cases/dpt_head_da3_replaced", case,
               half({f"level{i}": level[0] for i, level in enumerate(levels)}), single,
               half(replaced.state_dict(), "model.head."))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("gld", "da3", "out"):
        parser.add_argument("--" + name, type=pathlib.Path, required=True)
    options = parser.parse_args()
    rgb_decoder_case(options.gld, options.out)
    replaced_head_case(options.gld, options.da3, options.out)


if __name__ == "__main__":
    main()
