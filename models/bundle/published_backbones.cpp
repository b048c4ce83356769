#include "models/bundle/published_backbones.h"

#include "gld/base/dashed_name.h"
#include "gld/base/error.h"
#include "models/backbones/autoencoder_kl.h"
#include "models/backbones/da3_backbone.h"
#include "models/backbones/dinov2_backbone.h"
#include "models/backbones/tiny_autoencoder.h"
#include "models/backbones/vggt_backbone.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/vggt_heads.h"

#include <algorithm>
#include <regex>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

bool starts_with(const std::string& text, const std::string& beginning) {
  return text.compare(0, beginning.size(), beginning) == 0;
}

bool any_name(const WeightFile& file, const std::function<bool(const std::string&)>& matches) {
  const auto& entries = file.entries();
  return std::any_of(entries.begin(), entries.end(),
                     [&](const TensorEntry& entry) { return matches(entry.name); });
}

bool has_signature(const WeightFile& file, const std::string& signature) {
  return any_name(file, [&](const std::string& name) { return starts_with(name, signature); });
}

bool holds(const WeightFile& file, const PublishedBackbone& published) {
  return any_name(file, [&](const std::string& name) {
    return starts_with(inner_name(published, name), published.signature);
  });
}

// Returns what of the table a file holds; null for nothing of it.
const PublishedBackbone* held_backbone(const WeightFile& file) {
  const auto& table = published_backbones();
  const auto found = std::find_if(table.begin(), table.end(),
                                  [&](const PublishedBackbone& entry) { return holds(file, entry); });
  return found == table.end() ? nullptr : &*found;
}

std::string flag_of(const PublishedBackbone& published) { return "--" + dashed_name(published.option); }

constexpr const char* kNotInTheDescription = "a head that the model's description leaves out";

// DA3's parts for cameras, which every published file has and bundles may do without.
const std::string kDa3CameraEncoder = "model.cam_enc.";
const std::string kDa3CameraDecoder = "model.cam_dec.";

bool da3_decodes_cameras(const BundleOptions& bundle) {
  return bundle.geometry_head.exists() && bundle.geometry_head.architecture().decodes_cameras();
}

void take_da3_cameras(const WeightFile& file, BundleOptions& bundle) {
  bundle.backbone.as<Da3BackboneOptions>().camera_encoder_depth =
      has_signature(file, kDa3CameraEncoder) ? CameraEncoderSizes().depth : 0;
  bundle.geometry_head.as<DptHeadOptions>().camera_decoder = has_signature(file, kDa3CameraDecoder);
}

std::vector<IgnoredName> da3_cameras_left_out(const BundleOptions& bundle) {
  std::vector<IgnoredName> left_out;
  if (!da3_decodes_cameras(bundle)) {
    left_out.push_back(
        {kDa3CameraDecoder + "*", "DA3's camera decoder, which the model's description leaves out"});
  }
  if (!bundle.backbone.architecture().takes_cameras()) {
    left_out.push_back(
        {kDa3CameraEncoder + "*", "DA3's camera encoder, which the model's description leaves out"});
  }
  return left_out;
}

void require_da3_cameras(const WeightFile& file, const BundleOptions& bundle) {
  const auto require = [&](bool wanted, const std::string& part, const std::string& beginning,
                           const std::string& without) {
    if (!wanted || has_signature(file, beginning)) return;
    fail({file.path().string(), fmt::format("DA3's camera {}, tensors {}*", part, beginning), "none",
          fmt::format("get the whole file, or say in --description what the model has ({})", without)});
  };
  require(bundle.backbone.architecture().takes_cameras(), "encoder", kDa3CameraEncoder,
          "backbone.camera_encoder_depth: 0");
  require(da3_decodes_cameras(bundle), "decoder", kDa3CameraDecoder, "dpt_head.camera_decoder: false");
}

std::vector<IgnoredName> vggt_heads_left_out(const BundleOptions& bundle) {
  VggtHeadsOptions none;
  none.point_head = none.camera_head = false;
  const bool own = bundle.geometry_head.architecture().kind() == none.kind();
  const auto& heads = own ? bundle.geometry_head.as<VggtHeadsOptions>() : none;
  std::vector<IgnoredName> left_out;
  if (!own) left_out.push_back({"depth_head.*", kNotInTheDescription});
  if (!heads.point_head) left_out.push_back({"point_head.*", kNotInTheDescription});
  if (!heads.camera_head) left_out.push_back({"camera_head.*", kNotInTheDescription});
  return left_out;
}

void require_vggt_heads(const WeightFile& file, const BundleOptions& bundle) {
  if (bundle.geometry_head.architecture().kind() != VggtHeadsOptions().kind()) return;
  const auto& heads = bundle.geometry_head.as<VggtHeadsOptions>();
  for (const auto& [head, wanted] : std::vector<std::pair<std::string, bool>>{
           {"depth_head", true}, {"point_head", heads.point_head}, {"camera_head", heads.camera_head}}) {
    if (!wanted || has_signature(file, head + ".")) continue;
    const std::string without =
        head == "depth_head" ? "dpt_head: {type: none}" : "dpt_head." + head + ": false";
    fail({file.path().string(), fmt::format("VGGT's {}, tensors {}.*", head, head), "none",
          fmt::format("get the whole file, or say in --description what the model has ({})", without)});
  }
}

void require_registers(const WeightFile& file, const BundleOptions& bundle) {
  if (bundle.backbone.as<Dinov2Options>().sizes.num_register_tokens == 0 ||
      has_signature(file, "register_tokens"))
    return;
  fail({file.path().string(), "DINOv2 with registers, a tensor register_tokens", "none",
        "give a model with registers, or say num_register_tokens: 0, antialias: false and "
        "interpolate_offset: 0.1 in --description"});
}

std::string autoencoder_name(const std::string& name, const BundleOptions& bundle) {
  const auto& options = bundle.backbone.as<AutoencoderKlOptions>();
  return diffusers_autoencoder_name(name, static_cast<int64_t>(options.block_out_channels.size()));
}

PublishedBackbone tiny_half(const std::string& half, const std::string& signature, const std::string& help) {
  PublishedBackbone published;
  published.option = "tiny_autoencoder_" + half;
  published.help = help;
  published.name = "the " + half + " of a tiny autoencoder";
  published.kind = "tiny_autoencoder";
  published.signature = signature;
  published.module_prefix = half + ".";
  published.options = [] {
    return single_level_options("TAEF2, the tiny autoencoder of FLUX.2", TinyAutoencoderOptions());
  };
  return published;
}

std::vector<PublishedBackbone> make_table() {
  std::vector<PublishedBackbone> table;
  PublishedBackbone da3;
  da3.option = "da3";
  da3.help = "DA3-Base safetensors: gives the backbone and the DPT head";
  da3.name = "DA3";
  da3.kind = "da3";
  da3.signature = "model.backbone.pretrained.";
  da3.with_head = true;
  da3.options = released_da3_options;
  da3.take_optional_parts = take_da3_cameras;
  da3.left_out = da3_cameras_left_out;
  da3.require_whole = require_da3_cameras;
  table.push_back(std::move(da3));

  PublishedBackbone vggt;
  vggt.option = "vggt";
  vggt.help = "VGGT-1B safetensors or .pt: gives the backbone and its heads";
  vggt.name = "VGGT";
  vggt.kind = "vggt";
  vggt.signature = "aggregator.";
  vggt.with_head = true;
  vggt.ignored = {{"track_head.*", "VGGT's head for point tracks, which GLD does not use"}};
  vggt.options = released_vggt_options;
  vggt.left_out = vggt_heads_left_out;
  vggt.require_whole = require_vggt_heads;
  table.push_back(std::move(vggt));

  PublishedBackbone dinov2;
  dinov2.option = "dinov2";
  dinov2.help = "DINOv2's .pth, with or without registers: gives the backbone";
  dinov2.name = "DINOv2";
  dinov2.kind = "dinov2";
  dinov2.signature = "cls_token";
  dinov2.options = [] { return single_level_options("DINOv2-Base with registers", Dinov2Options()); };
  dinov2.other_layouts = {{"embeddings.cls_token",
                           "DINOv2 under Hugging Face's names, which are not read: give the original .pth"}};
  dinov2.require_whole = require_registers;
  table.push_back(std::move(dinov2));

  PublishedBackbone autoencoder;
  autoencoder.option = "autoencoder_kl";
  autoencoder.help = "autoencoder of Stable Diffusion, diffusers' or original names";
  autoencoder.name = "an AutoencoderKL";
  autoencoder.kind = "autoencoder_kl";
  autoencoder.signature = "quant_conv.";
  autoencoder.outer_prefixes = {"state_dict.", "first_stage_model."};
  autoencoder.ignored = {{"loss.*", "the losses it was trained with"},
                         {"model_ema*", "another copy of the weights"},
                         {"model.diffusion_model.*", "Stable Diffusion's own network"},
                         {"denoiser.*", "SDXL's noise schedule"},
                         {"cond_stage_model.*", "Stable Diffusion's text encoder"},
                         {"conditioner.*", "Stable Diffusion's text encoders"},
                         {"optimizer*", "state of the optimiser"}};
  for (const char* buffer : {"betas", "alphas_cumprod*", "sqrt_*", "log_one_minus_*", "posterior_*", "lvlb_*",
                             "logvar", "scale_factor"}) {
    autoencoder.ignored.push_back({buffer, "Stable Diffusion's noise schedule"});
  }
  autoencoder.renamed = autoencoder_name;
  autoencoder.options = [] {
    return single_level_options("Stable Diffusion's autoencoder", AutoencoderKlOptions());
  };
  // The same network and names, so that no file tells which of the two it is of.
  PublishedBackbone sdxl = autoencoder;
  table.push_back(std::move(autoencoder));
  sdxl.option = "sdxl_autoencoder";
  sdxl.help = "autoencoder of SDXL, whose latents have another scale";
  sdxl.name = "SDXL's AutoencoderKL";
  sdxl.options = [] {
    AutoencoderKlOptions of_sdxl;
    of_sdxl.scaling_factor = 0.13025;
    return single_level_options("SDXL's autoencoder", of_sdxl);
  };
  table.push_back(std::move(sdxl));

  table.push_back(tiny_half("encoder", "1.conv.0.", "encoder of a tiny autoencoder, taef2_encoder.pth"));
  table.push_back(tiny_half("decoder", "19.", "its decoder, taef2_decoder.pth"));
  return table;
}

}  // namespace

BundleOptions released_da3_options() {
  BundleOptions options;
  options.name = "GLD DA3-Base, released";
  options.rgb_decoder.hidden_size = 1152;
  options.rgb_decoder.num_layers = 28;
  options.rgb_decoder.num_heads = 16;
  options.rgb_decoder.intermediate_size = 4096;
  DitOptions& released_cascade = options.generator(cascade(1, 0)).dit;
  released_cascade.split_embedders = false;
  released_cascade.prope_image_size = "504";
  released_cascade.unconditional_intrinsics = UnconditionalIntrinsics::kKeep;
  for (auto& part : options.generators) apply_published_conventions(part.dit);
  return options;
}

BundleOptions released_vggt_options() {
  BundleOptions options;
  options.name = "GLD VGGT-1B, released";
  options.backbone = VggtBackboneOptions();
  options.geometry_head = VggtHeadsOptions();
  const int64_t channels = options.backbone.level_channels();
  options.rgb_decoder.in_channels = options.backbone.levels() * channels;
  options.rgb_decoder.hidden_size = 1152;
  options.rgb_decoder.num_layers = 28;
  options.rgb_decoder.num_heads = 16;
  options.rgb_decoder.intermediate_size = 4096;
  for (auto& part : options.generators) {
    part.dit.in_channels = channels;
    part.dit.num_special_tokens = options.backbone.leading_tokens();
    apply_published_conventions(part.dit);
  }
  return options;
}

const std::vector<PublishedBackbone>& published_backbones() {
  static const std::vector<PublishedBackbone> table = make_table();
  return table;
}

const PublishedBackbone& published_backbone(const std::string& option) {
  const auto& table = published_backbones();
  const auto found = std::find_if(table.begin(), table.end(),
                                  [&](const PublishedBackbone& entry) { return entry.option == option; });
  if (found == table.end()) fail({"--" + option, "a published backbone", "none", "see gld convert --help"});
  return *found;
}

std::vector<GivenBackbone> given_backbones(const std::map<std::string, std::string>& files) {
  std::vector<GivenBackbone> given;
  for (const auto& published : published_backbones()) {
    const auto found = files.find(published.option);
    if (found != files.end() && !found->second.empty()) given.push_back({published, found->second});
  }
  return given;
}

std::string inner_name(const PublishedBackbone& published, const std::string& name) {
  std::string inner = name;
  for (const auto& prefix : published.outer_prefixes) {
    if (starts_with(inner, prefix)) inner.erase(0, prefix.size());
  }
  return inner;
}

void require_published(const WeightFile& file, const std::string& option) {
  const auto& wanted = published_backbone(option);
  if (holds(file, wanted)) return;
  const std::string expected = "weights of " + wanted.name;
  for (const auto& [beginning, layout] : wanted.other_layouts) {
    if (has_signature(file, beginning)) fail({file.path().string(), expected, layout, ""});
  }
  if (const auto* held = held_backbone(file)) {
    fail({file.path().string(), expected, "weights of " + held->name, "give it as " + flag_of(*held)});
  }
  fail({file.path().string(), expected, "weights of another model", "check that the file is the one meant"});
}

void require_no_backbone(const WeightFile& file, const std::string& wanted) {
  if (const auto* held = held_backbone(file)) {
    fail({file.path().string(), "weights of " + wanted, "weights of " + held->name,
          "give it as " + flag_of(*held)});
  }
  if (has_signature(file, "mean") && has_signature(file, "var")) {
    fail({file.path().string(), "weights of " + wanted, "latent statistics",
          "give it as --statistics-level0 or --statistics-level1"});
  }
}

std::string diffusers_autoencoder_name(const std::string& name, int64_t stages) {
  std::smatch match;
  static const std::regex kStage(R"((encoder\.down|decoder\.up)\.(\d{1,4})\.(.*))");
  // The matcher takes a frame of the stack for every letter; no tensor of these models has a name of that length.
  constexpr size_t kLongestName = 256;
  if (name.size() > kLongestName) return name;
  std::string result = name;
  if (std::regex_match(name, match, kStage)) {
    const bool encodes = match[1] == "encoder.down";
    const int64_t stage = std::stoll(match[2]);
    result = (encodes ? "encoder.down_blocks." : "decoder.up_blocks.") +
             std::to_string(encodes ? stage : stages - 1 - stage) + "." + match[3].str();
  }
  static const std::vector<std::pair<std::regex, std::string>> kRenames = [] {
    std::vector<std::pair<std::regex, std::string>> renames;
    for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
             {R"((_blocks\.\d+)\.block\.)", "$1.resnets."},
             {R"(\.nin_shortcut\.)", ".conv_shortcut."},
             {R"(\.downsample\.conv\.)", ".downsamplers.0.conv."},
             {R"(\.upsample\.conv\.)", ".upsamplers.0.conv."},
             {R"(\.mid\.block_1\.)", ".mid_block.resnets.0."},
             {R"(\.mid\.block_2\.)", ".mid_block.resnets.1."},
             {R"(\.mid\.attn_1\.norm\.)", ".mid_block.attentions.0.group_norm."},
             {R"(\.mid\.attn_1\.proj_out\.)", ".mid_block.attentions.0.to_out.0."},
             {R"(\.mid\.attn_1\.([qkv])\.)", ".mid_block.attentions.0.to_$1."},
             {R"(\.attentions\.0\.query\.)", ".attentions.0.to_q."},
             {R"(\.attentions\.0\.key\.)", ".attentions.0.to_k."},
             {R"(\.attentions\.0\.value\.)", ".attentions.0.to_v."},
             {R"(\.attentions\.0\.proj_attn\.)", ".attentions.0.to_out.0."},
             {R"(coder\.norm_out\.)", "coder.conv_norm_out."}}) {
      renames.emplace_back(std::regex(from), to);
    }
    return renames;
  }();
  for (const auto& [from, to] : kRenames) result = std::regex_replace(result, from, to);
  return result;
}

}  // namespace gld
