#!/usr/bin/env python3
"""Makes the reference cases rgb_decoder_vggt, dpt_head_da3_replaced, known_cameras_da3 and camera_decoder_da3,
tests/data/dpt_decoder, and the cases splat_* and refiner_* with the published modules.

Needs PyTorch, safetensors, for the first two transformers (of RAE's decoder), for DA3's einops, and for refiner_* diffusers
0.31 and einops. Each case is made where the checkouts that
it needs are given:
  --gld     cvlab-kaist/Geometric-Latent-Diffusion, of rgb_decoder_vggt and, together with
  --da3     ByteDance-Seed/Depth-Anything-3, of dpt_head_da3_replaced, known_cameras_da3 and camera_decoder_da3
  --gsplat  nerfstudio-project/gsplat at v1.5.3, of splat_*
  --splatent  orhir/Splatent, of refiner_*
Weights and inputs are random and exact in float16; outputs are float32, and the note of each case says how far they lie from
the same modules in float64. Those of splat_* are float64, from inputs exact in float32.
    scripts/make_published_cases.py --gld DIR --da3 DIR --gsplat DIR --splatent DIR --out tests/data
"""
import argparse
import ast
import copy
import importlib.util
import json
import math
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
    if weights:
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


def da3_packages(da3):
    source = da3 / "src/depth_anything_3"
    for name in ("", "model", "model/utils", "utils"):
        package(".".join(["depth_anything_3", *name.split("/")]).rstrip("."), source / name)
    sys.path.insert(0, str(da3 / "src"))


def replaced_head_case(gld, da3, out):
    da3_packages(da3)
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


def turned_cameras(views, width, height):
    """Camera-from-world of cameras around a place far from the world's origin, in float32, and their intrinsics."""
    torch.manual_seed(10)
    poses, intrinsics = torch.eye(4).repeat(views, 1, 1), torch.zeros(views, 3, 3)
    for view in range(views):
        # The last camera looks back: its quaternion has a negative w before it is made to have none.
        turn = torch.tensor(2.9 * view / (views - 1))
        axis = torch.nn.functional.normalize(torch.randn(3), dim=0)
        x, y, z = axis
        cross = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        poses[view, :3, :3] = torch.eye(3) + turn.sin() * cross + (1 - turn.cos()) * cross @ cross
        poses[view, :3, 3] = torch.randn(3) * 0.7 + torch.tensor([3.0, -2.0, 5.0])
        intrinsics[view] = torch.tensor([[(0.8 + 0.1 * view) * width, 0, 0.45 * width],
                                         [0, (1.1 - 0.1 * view) * height, 0.55 * height], [0, 0, 1]])
    return poses, intrinsics


def da3_camera_cases(da3, out):
    da3_packages(da3)
    from depth_anything_3.model import cam_enc
    from depth_anything_3.model.cam_dec import CameraDec
    from depth_anything_3.model.dinov2.vision_transformer import DinoVisionTransformer
    from depth_anything_3.model.utils.transform import pose_encoding_to_extri_intri
    from depth_anything_3.utils.geometry import affine_inverse

    # The method alone, which stands in the class of the whole program.
    tree = ast.parse((da3 / "src/depth_anything_3/api.py").read_text())
    method = next(node for item in tree.body if isinstance(item, ast.ClassDef) for node in item.body
                  if isinstance(node, ast.FunctionDef) and node.name == "_normalize_extrinsics")
    names = {"torch": torch, "affine_inverse": affine_inverse}
    exec(compile(ast.Module(body=[method], type_ignores=[]), "api", "exec"), names)
    # The published function rounds to float32, which modules in float64 do not take.
    encode_poses = cam_enc.extri_intri_to_pose_encoding

    torch.manual_seed(9)
    sizes = {"patch_size": 14, "embed_dim": 32, "depth": 8, "num_heads": 2, "mlp_ratio": 4}
    starts = {"alternating_start": 4, "qk_norm_start": 4, "rope_start": 4}
    out_layers = [5, 7]
    backbone = DinoVisionTransformer(
        img_size=4 * 14, **sizes, ffn_layer="mlp", alt_start=starts["alternating_start"],
        qknorm_start=starts["qk_norm_start"], rope_start=starts["rope_start"], cat_token=True).eval()
    encoder = cam_enc.CameraEnc(dim_out=32).eval()
    make_random(backbone)
    make_random(encoder)
    with torch.no_grad():
        backbone.pos_embed.copy_((0.3 * torch.randn_like(backbone.pos_embed)).half().float())
    height, width, views = 42, 56, 3
    images = torch.rand(views, 3, height, width).half().float()
    poses, intrinsics = turned_cameras(views, width, height)

    def run(backbone, encoder, dtype):
        cam_enc.extri_intri_to_pose_encoding = lambda *values: encode_poses(*values).to(dtype)
        normalised = names["_normalize_extrinsics"](None, poses[None].to(dtype).clone())
        pixels = (images.to(dtype) - IMAGENET_MEAN.to(dtype)) / IMAGENET_DEVIATION.to(dtype)
        with torch.no_grad():
            tokens = encoder(normalised, intrinsics[None].to(dtype), (height, width))
            # As they are before the final norm.
            levels, _ = backbone._get_intermediate_layers_not_chunked(pixels[None], out_layers, cam_token=tokens)
        return {f"known_cameras.level{i}": level[0] for i, (_, level) in enumerate(levels)}

    single = run(backbone, encoder, torch.float32)
    double = run(copy.deepcopy(backbone).double(), copy.deepcopy(encoder).double(), torch.float64)
    case = {"kind": "backbone",
            "config": {"type": "da3", **sizes, "pos_embed_grid": 4, "out_layers": out_layers, **starts,
                       "rope_frequency": 100, "camera_encoder_depth": 4, "camera_encoder_heads": 16},
            "relative_tolerance": 1e-5,
            "note": "levels are raw; the cameras, normalised by DepthAnything3._normalize_extrinsics, give the camera tokens "
                    "through CameraEnc | seed 9; weights and images exact in float16, cameras in float32; "
                    + observed(largest_error(single, double))}
    write_case(out / "reference_cases/known_cameras_da3", case,
               {**half({"images": images}), "camera_from_world": poses, "intrinsics": intrinsics}, single,
               {**half(backbone.state_dict(), "model.backbone.pretrained."),
                **half(encoder.state_dict(), "model.cam_enc.")})

    decoder = CameraDec(dim_in=64).eval()
    make_random(decoder)
    with torch.no_grad():
        # Fields of view near a radian: those that the ReLU cuts to 0 have no focal length.
        decoder.fc_fov[0].weight.mul_(0.25)
        decoder.fc_fov[0].bias.copy_(torch.tensor([0.75, 1.25]))
    tokens = torch.randn(4, 64).half().float()

    def decode(decoder, dtype):
        # The published forward rounds its features to float32; what follows them is run in the type of the module.
        class Kept(torch.Tensor):
            def float(self):
                return self

        with torch.no_grad():
            encoding = decoder(tokens[None].to(dtype).as_subclass(Kept)).as_subclass(torch.Tensor)
            pose, intrinsics = pose_encoding_to_extri_intri(encoding, (height, width))
            inverse = affine_inverse(pose)
        assert encoding[..., 7:].min() > 0.2 and encoding[..., 7:].max() < 2.8
        return {"pose_encoding": encoding[0], "camera_from_world": inverse[0], "intrinsics": intrinsics[0]}

    single, double = decode(decoder, torch.float32), decode(copy.deepcopy(decoder).double(), torch.float64)
    case = {"kind": "camera_decoder", "config": {"dim_in": 64, "height": height, "width": width},
            "relative_tolerance": 3e-6,
            "note": "DA3's CameraDec, pose_encoding_to_extri_intri and affine_inverse; the encoding's pose is world from camera | "
                    "seed 9; weights and tokens exact in float16; " + observed(largest_error(single, double))}
    write_case(out / "reference_cases/camera_decoder_da3", case, half({"camera_tokens": tokens}), single,
               half(decoder.state_dict(), "model.cam_dec."))


def random_splats(seed, count, degree, smallest, largest):
    """Gaussians in a box around (0, 0, 4), some of them behind the cameras and some far beside the pictures."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(low, high, *shape):
        return low + (high - low) * torch.rand(*shape, generator=generator)

    means = uniform(-1, 1, count, 3) * torch.tensor([1.2, 1.0, 1.5]) + torch.tensor([0.0, 0.0, 4.0])
    means[::8] *= torch.tensor([4.0, 4.0, 1.0])
    means[3::16, 2] -= 6
    return {"means": means,
            "log_scales": uniform(math.log(smallest), math.log(largest), count, 3),
            "rotations": uniform(-1, 1, count, 4) * uniform(0.2, 3, count, 1),
            "logit_opacities": uniform(-2, 4, count),
            "harmonics": uniform(-1, 1, count, (degree + 1) ** 2, 3)
            * torch.tensor([1.5] + [0.4] * ((degree + 1) ** 2 - 1)).reshape(1, -1, 1)}


def splat_cameras(views, width, height):
    poses, intrinsics = [], []
    for view in range(views):
        turn, tilt = 0.12 * (view - 1), 0.08 * view
        about_y = torch.tensor([[math.cos(turn), 0, math.sin(turn)], [0, 1, 0], [-math.sin(turn), 0, math.cos(turn)]])
        about_z = torch.tensor([[math.cos(tilt), -math.sin(tilt), 0], [math.sin(tilt), math.cos(tilt), 0], [0, 0, 1]])
        pose = torch.eye(4)
        pose[:3, :3] = about_y @ about_z
        pose[:3, 3] = torch.tensor([0.3 * (view - 1), 0.1, 0.2 * view])
        poses.append(pose)
        intrinsics.append(torch.tensor([[(1.1 + 0.2 * view) * width, 0, 0.53 * width], [0, 1.2 * width, 0.44 * height],
                                        [0, 0, 1]]))
    return {"camera_to_world": torch.stack(poses), "intrinsics": torch.stack(intrinsics)}


class Splats:
    """The published functions on double inputs of which gradients are asked."""

    def __init__(self, gsplat, inputs, config):
        self.published = gsplat
        self.config = config
        double = {name: tensor.double() for name, tensor in inputs.items()}
        self.leaves = {name: double[name].requires_grad_()
                       for name in ("means", "log_scales", "rotations", "logit_opacities", "harmonics")}
        rotations = double["camera_to_world"][:, :3, :3]
        self.centres = double["camera_to_world"][:, :3, 3]
        self.world_to_camera = torch.eye(4, dtype=torch.float64).repeat(len(rotations), 1, 1)
        self.world_to_camera[:, :3, :3] = rotations.transpose(1, 2)
        self.world_to_camera[:, :3, 3] = -(rotations.transpose(1, 2) @ self.centres[..., None])[..., 0]
        covariances, _ = gsplat._quat_scale_to_covar_preci(self.leaves["rotations"], self.leaves["log_scales"].exp(),
                                                           compute_preci=False)
        _, self.places, self.depths, self.conics, compensations = gsplat._fully_fused_projection(
            self.leaves["means"], covariances, self.world_to_camera, double["intrinsics"], config["width"],
            config["height"], near_plane=config["near"], calc_compensations=config["antialias"])
        self.opacities = torch.sigmoid(self.leaves["logit_opacities"]).expand(self.depths.shape)
        if config["antialias"]:
            self.opacities = self.opacities * compensations
        self.seen = self.depths > config["near"]

    def colours(self, view):
        directions = self.leaves["means"] - self.centres[view]
        return torch.clamp_min(self.published._spherical_harmonics(
            self.config["degree"], directions, self.leaves["harmonics"]) + 0.5, 0)

    def gradients(self, loss, names):
        found = torch.autograd.grad(loss, [self.leaves[name] for name in names])
        return {f"gradient.{name}": gradient for name, gradient in zip(names, found)}


SHAPE = ("means", "log_scales", "rotations", "logit_opacities")


def splat_projection_case(gsplat, out, name, seed, antialias):
    config = {"width": 96, "height": 61, "near": 0.2, "antialias": antialias, "degree": 3}
    # So large that antialiasing leaves each an opacity that is drawn: what is not is no part of the published functions.
    inputs = {**random_splats(seed, 64, 3, 0.03 if antialias else 0.003, 0.4), **splat_cameras(3, 96, 61)}
    generator = torch.Generator().manual_seed(seed + 1)
    for of, last in (("places", 2), ("conics", 3), ("opacities", None)):
        shape = (3, 64) + (() if last is None else (last,))
        inputs["of_" + of] = torch.rand(shape, generator=generator) * 2 - 1
    splats = Splats(gsplat, inputs, config)
    seen = splats.seen.double()
    assert splats.opacities[splats.seen].min() > 1 / 255

    def visible(tensor):
        return torch.where(splats.seen.reshape(seen.shape + (1,) * (tensor.dim() - 2)), tensor, torch.zeros_like(tensor))

    outputs = {"seen": seen, "depths": visible(splats.depths), "places": visible(splats.places),
               "conics": visible(splats.conics), "opacities": visible(splats.opacities)}
    loss = sum((outputs[of] * inputs["of_" + of].double()).sum() for of in ("places", "conics", "opacities"))
    outputs.update(splats.gradients(loss, SHAPE))
    del inputs["harmonics"]
    case = {"kind": "splat_projection", "config": {**config, "degree": 0}, "relative_tolerance": 1e-11,
            "note": "projection and covariance of gsplat 1.5.3's _torch_impl.py in float64, and its autograd's gradients of "
                    "the sum of of_places, of_conics and of_opacities times them, over the views; 0 for Gaussians before the "
                    f"near plane | seed {seed}; inputs exact in float32"}
    write_case(out / "reference_cases" / name, case, inputs, {k: v.detach() for k, v in outputs.items()}, {})


def splat_colours_case(gsplat, out):
    config = {"width": 96, "height": 61, "near": 0.2, "antialias": False, "degree": 3}
    inputs = {**random_splats(21, 64, 3, 0.003, 0.4), **splat_cameras(3, 96, 61)}
    inputs["of_colours"] = torch.rand(3, 64, 3, generator=torch.Generator().manual_seed(22)) * 2 - 1
    splats = Splats(gsplat, inputs, config)
    colours = torch.stack([splats.colours(view) for view in range(3)])
    outputs = {"colours": colours, **splats.gradients((colours * inputs["of_colours"].double()).sum(), ("means", "harmonics"))}
    outputs["gradient_through_colours.means"] = outputs.pop("gradient.means")
    case = {"kind": "splat_projection", "config": config, "relative_tolerance": 3e-7,
            "note": "spherical harmonics of gsplat 1.5.3's _torch_impl.py in float64, as its rasterization adds 1/2 and cuts at "
                    "0, and its autograd's gradients; this program keeps sums for coefficients as float32 | seed 21; inputs "
                    "exact in float32"}
    write_case(out / "reference_cases/splat_colours", case, inputs, {k: v.detach() for k, v in outputs.items()}, {})


def composite_densely(splats, view, features, background):
    """3DGS's compositing, every pixel against every Gaussian; gsplat's own needs CUDA. Also how near alphas and transmittances
    come to where they jump, relatively."""
    width, height = splats.config["width"], splats.config["height"]
    order = torch.argsort(splats.depths[view], stable=True)
    order = order[splats.seen[view][order]]
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    pixels = torch.stack([columns, rows], -1).reshape(-1, 1, 2).double()
    d = pixels - splats.places[view][order]
    q = splats.conics[view][order]
    value = splats.opacities[view][order] * torch.exp(
        -0.5 * (q[:, 0] * d[..., 0] ** 2 + q[:, 2] * d[..., 1] ** 2) - q[:, 1] * d[..., 0] * d[..., 1])
    alpha = torch.where(value >= 1 / 255, value.clamp(max=0.99), torch.zeros_like(value))
    left = torch.cumprod(1 - alpha, 1)
    # The first Gaussian that would leave less than 1e-4 ends its pixel; all before it stay, since left only falls.
    alpha = torch.where(left >= 1e-4, alpha, torch.zeros_like(alpha))
    left = torch.cumprod(1 - alpha, 1)
    before = torch.cat([torch.ones_like(left[:, :1]), left[:, :-1]], 1)
    picture = (alpha * before) @ features[order] + left[:, -1:] * background
    jumps = [(value * 255 - 1).abs().min(), (value / 0.99 - 1).abs().min(), (torch.cumprod(1 - alpha, 1) * 1e4 - 1).abs().min()]
    # As before the cut, so that a transmittance just below 1e-4 counts as well.
    first = torch.where(value >= 1 / 255, value.clamp(max=0.99), torch.zeros_like(value))
    jumps.append((torch.cumprod(1 - first, 1) * 1e4 - 1).abs().min())
    shape = (height, width, -1)
    return picture.reshape(shape).permute(2, 0, 1), left[:, -1].reshape(height, width), min(jumps).item()


def splat_compositing_case(gsplat, out, name, channels, antialias):
    """channels None: the colours, of spherical harmonics, on black."""
    width, height, count = 45, 29, 70
    degree = 2 if channels is None else 0
    config = {"width": width, "height": height, "near": 0.2, "antialias": antialias, "degree": degree}
    for seed in range(31, 1000):
        inputs = {**random_splats(seed, count, degree, 0.02, 0.5), **splat_cameras(2, width, height)}
        generator = torch.Generator().manual_seed(seed + 1)
        if channels is not None:
            inputs["features"] = torch.rand(count, channels, generator=generator) * 2 - 1
            inputs["background"] = torch.rand(channels, generator=generator)
        inputs["of_pictures"] = torch.rand(2, channels or 3, height, width, generator=generator) * 2 - 1
        splats = Splats(gsplat, inputs, config)
        features = inputs["features"].double().requires_grad_() if channels is not None else None
        background = inputs["background"].double() if channels is not None else torch.zeros(3, dtype=torch.float64)
        results = [composite_densely(splats, view, splats.colours(view) if features is None else features, background)
                   for view in range(2)]
        # Where float32 takes the other side of a jump nothing can be compared.
        if min(jump for _, _, jump in results) > 3e-5:
            break
    else:
        raise SystemExit(f"{name}: no seed keeps away from jumps")
    outputs = {"pictures": torch.stack([picture for picture, _, _ in results]),
               "transmittances": torch.stack([left for _, left, _ in results])}
    loss = (outputs["pictures"] * inputs["of_pictures"].double()).sum()
    if features is not None:
        outputs["gradient.features"], = torch.autograd.grad(loss, [features], retain_graph=True)
        del inputs["harmonics"]
    outputs.update(splats.gradients(loss, SHAPE if features is not None else SHAPE + ("harmonics",)))
    case = {"kind": "splat_compositing", "config": config, "relative_tolerance": 2e-6,
            "note": "gsplat 1.5.3's projection, covariance and spherical harmonics in float64, composited densely by PyTorch with "
                    "3DGS's bounds (1/255, .99, 1e-4), and autograd's gradients of the sum of of_pictures times pictures | seed "
                    f"{seed}, the first whose alphas and transmittances stay 3e-5 of themselves away from where they jump; "
                    "inputs exact in float32"}
    write_case(out / "reference_cases" / name, case, inputs, {k: v.detach() for k, v in outputs.items()}, {})


def splat_cases(checkout, out):
    gsplat = module_of("gsplat_torch", checkout / "gsplat/cuda/_torch_impl.py")
    splat_projection_case(gsplat, out, "splat_projection", 11, False)
    splat_projection_case(gsplat, out, "splat_projection_antialias", 12, True)
    splat_colours_case(gsplat, out)
    splat_compositing_case(gsplat, out, "splat_compositing", 5, False)
    splat_compositing_case(gsplat, out, "splat_picture", None, True)


def functions_of(file, names, given):
    """Functions and methods of a file by name, alone, so that what the file imports is not needed."""
    made = dict(given)
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.FunctionDef) and node.name in names:
            exec(compile(ast.Module(body=[node], type_ignores=[]), file.name, "exec"), made)
    return [made[name] for name in names]


class JoinedViews:
    """Splatent's attention over pixels without its grid, by PyTorch's: the tokens of `views` maps behind each other joined
    ("self"), or the first one's queries for the others and each of these for itself ("cross")."""

    def __init__(self, views, kind):
        self.views, self.kind = views, kind

    def __call__(self, attn, hidden_states, encoder_hidden_states=None, attention_mask=None, temb=None, *_, **__):
        keys = hidden_states if encoder_hidden_states is None else encoder_hidden_states

        def heads(tokens):
            return tokens.unflatten(-1, (attn.heads, -1)).transpose(1, 2)

        def attended(query, key, value):
            result = torch.nn.functional.scaled_dot_product_attention(heads(query), heads(key), heads(value))
            return result.transpose(1, 2).flatten(2)

        query, key, value = attn.to_q(hidden_states), attn.to_k(keys), attn.to_v(keys)
        if encoder_hidden_states is not None:
            result = attended(query, key, value)
        elif self.kind == "self":
            result = attended(*[part.flatten(0, 1).unsqueeze(0) for part in (query, key, value)]).reshape(query.shape)
        else:
            first = attended(query[:1], key[1:].flatten(0, 1).unsqueeze(0), value[1:].flatten(0, 1).unsqueeze(0))
            result = torch.cat([first, attended(query[1:], key[1:], value[1:])])
        return attn.to_out[0](result)


def refiner_case(splatent, out, kind, seed):
    from diffusers import DDPMScheduler, UNet2DConditionModel
    from einops import rearrange

    torch.manual_seed(seed)
    config = {"channels": [8, 16, 24], "heads": [2, 4, 3], "attending_stages": 2, "layers_per_block": 2 if kind == "grid" else 1,
              "norm_groups": 4, "latent_channels": 4, "prompt_tokens": 5, "prompt_channels": 12, "timestep": 300,
              "form": "published", "attention": kind, "references": 3}
    unet = UNet2DConditionModel(
        in_channels=4, out_channels=4, block_out_channels=config["channels"], layers_per_block=config["layers_per_block"],
        down_block_types=("CrossAttnDownBlock2D", "CrossAttnDownBlock2D", "DownBlock2D"),
        up_block_types=("UpBlock2D", "CrossAttnUpBlock2D", "CrossAttnUpBlock2D"), norm_num_groups=config["norm_groups"],
        cross_attention_dim=config["prompt_channels"], attention_head_dim=config["heads"],
        use_linear_projection=True).eval()
    make_random(unet)
    views, height, width = 4, 6, 7  # odd, so that what is halved does not double to what it was
    latents = torch.randn(views, 4, height, width).half().float()
    prompt = torch.randn(config["prompt_tokens"], config["prompt_channels"]).half().float()
    schedule = DDPMScheduler(num_train_timesteps=1000, beta_start=0.00085, beta_end=0.012, beta_schedule="scaled_linear")
    signal = schedule.alphas_cumprod.double()
    arrange, extract = functions_of(splatent / "src/model.py", ["_arrange_grid", "_extract_from_grid"],
                                    {"rearrange": rearrange})
    distance, nearest = functions_of(splatent / "scripts/generate_dataset.py", ["compute_camera_distance", "find_top_k_closest_ref_views"],
                                     {"np": __import__("numpy"), "Dict": dict, "List": list})
    nearest.__globals__["compute_camera_distance"] = distance
    if kind != "grid":
        unet.set_attn_processor(JoinedViews(views, kind))

    def run(model, dtype):
        maps, rows, columns = latents.to(dtype), 1, 1
        if kind == "grid":
            maps, rows, columns = arrange(None, latents.to(dtype).unsqueeze(0))
            maps = maps[:, 0]
        with torch.no_grad():
            prediction = model(maps, config["timestep"], prompt.to(dtype).unsqueeze(0).expand(len(maps), -1, -1)).sample
        if kind == "grid":
            prediction = extract(None, prediction.unsqueeze(1), rows, columns)[0]
        left = signal[config["timestep"]].to(dtype)
        refined = (latents[0].to(dtype) - (1 - left).sqrt() * prediction[0]) / left.sqrt()
        return {"prediction": prediction, "refined": refined}

    single, double = run(unet, torch.float32), run(copy.deepcopy(unet).double(), torch.float64)
    turns = torch.linalg.qr(torch.randn(9, 3, 3)).Q
    turns = turns * torch.linalg.det(turns)[:, None, None]
    poses = torch.eye(4).repeat(9, 1, 1)
    poses[:, :3, :3], poses[:, :3, 3] = turns, torch.randn(9, 3)
    frames = [{"transform_matrix": pose.tolist()} for pose in poses.double()]
    inputs = {"latents": latents, "prompt": prompt, "camera_to_world": poses.double()}
    outputs = {**single, "alpha_bar": signal.float(),
               "references": torch.tensor(nearest(frames[0], frames[1:], 8), dtype=torch.float32)}
    case = {"kind": "refiner", "config": config, "relative_tolerance": 1e-5,
            "note": "diffusers' UNet2DConditionModel"
                    + (" on the grid of Splatent's own _arrange_grid" if kind == "grid"
                       else f", attention over pixels {kind}")
                    + "; one step with alphas_cumprod of its DDPMScheduler, as current diffusers refuses timestep 300 there; "
                      "references of camera 0 among the others by Splatent's find_top_k_closest_ref_views | "
                      f"seed {seed}; weights and inputs exact in float16; " + observed(largest_error(single, double))}
    write_case(out / ("reference_cases/refiner_" + kind), case, inputs, outputs,
               half({**unet.state_dict(), "prompt": prompt}))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("gld", "da3", "gsplat", "splatent"):
        parser.add_argument("--" + name, type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    options = parser.parse_args()
    if options.gld:
        rgb_decoder_case(options.gld, options.out)
    if options.gld and options.da3:
        replaced_head_case(options.gld, options.da3, options.out)
    if options.da3:
        da3_camera_cases(options.da3, options.out)
    if options.gsplat:
        splat_cases(options.gsplat, options.out)
    if options.splatent:
        for kind, seed in (("grid", 41), ("self", 42), ("cross", 43)):
            refiner_case(options.splatent, options.out, kind, seed)


if __name__ == "__main__":
    main()
