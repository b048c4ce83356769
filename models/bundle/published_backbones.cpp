#include "models/bundle/published_backbones.h"

#include "gld/base/error.h"
#include "models/backbones/autoencoder_kl.h"
#include "models/backbones/dinov2_backbone.h"
#include "models/backbones/tiny_autoencoder.h"

#include <algorithm>
#include <regex>
#include <utility>

namespace gld {
namespace {

bool starts_with(const std::string& text, const std::string& beginning) {
  return text.compare(0, beginning.size(), beginning) == 0;
}

bool has_signature(const WeightFile& file, const std::string& signature) {
  const auto& entries = file.entries();
  return std::any_of(entries.begin(), entries.end(),
                     [&](const TensorEntry& entry) { return starts_with(entry.name, signature); });
}

std::string autoencoder_name(const std::string& name, const BundleOptions& bundle) {
  const auto& options = bundle.backbone.as<AutoencoderKlOptions>();
  return diffusers_autoencoder_name(name, static_cast<int64_t>(options.block_out_channels.size()));
}

PublishedBackbone tiny_half(const std::string& half, const std::string& signature) {
  PublishedBackbone published;
  published.option = "tiny_autoencoder_" + half;
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
  da3.name = "DA3";
  da3.kind = "da3";
  da3.signature = "model.backbone.pretrained.";
  da3.with_head = true;
  da3.ignored = {{"model.cam_dec.*", "DA3's pose decoder, which GLD does not use"},
                 {"model.cam_enc.*", "DA3's pose encoder, which GLD does not use"}};
  da3.options = released_da3_options;
  table.push_back(std::move(da3));

  PublishedBackbone vggt;
  vggt.option = "vggt";
  vggt.name = "VGGT";
  vggt.kind = "vggt";
  vggt.signature = "aggregator.";
  vggt.with_head = true;
  vggt.ignored = {{"track_head.*", "VGGT's head for point tracks, which GLD does not use"}};
  vggt.options = released_vggt_options;
  table.push_back(std::move(vggt));

  PublishedBackbone dinov2;
  dinov2.option = "dinov2";
  dinov2.name = "DINOv2";
  dinov2.kind = "dinov2";
  dinov2.signature = "cls_token";
  dinov2.options = [] { return single_level_options("DINOv2-Base with registers", Dinov2Options()); };
  table.push_back(std::move(dinov2));

  PublishedBackbone autoencoder;
  autoencoder.option = "autoencoder_kl";
  autoencoder.name = "an AutoencoderKL";
  autoencoder.kind = "autoencoder_kl";
  autoencoder.signature = "quant_conv.";
  autoencoder.outer_prefixes = {"first_stage_model."};
  autoencoder.ignored = {{"loss.*", "the losses it was trained with"},
                         {"model_ema*", "another copy of the weights"},
                         {"model.diffusion_model.*", "Stable Diffusion's own network"},
                         {"cond_stage_model.*", "Stable Diffusion's text encoder"},
                         {"conditioner.*", "Stable Diffusion's text encoders"}};
  autoencoder.renamed = autoencoder_name;
  autoencoder.options = [] {
    return single_level_options("Stable Diffusion's autoencoder", AutoencoderKlOptions());
  };
  table.push_back(std::move(autoencoder));

  table.push_back(tiny_half("encoder", "1.conv.0."));
  table.push_back(tiny_half("decoder", "19."));
  return table;
}

}  // namespace

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

void require_published(const WeightFile& file, const std::string& option) {
  const auto& wanted = published_backbone(option);
  const auto matches = [&](const PublishedBackbone& entry) {
    if (has_signature(file, entry.signature)) return true;
    return std::any_of(
        entry.outer_prefixes.begin(), entry.outer_prefixes.end(),
        [&](const std::string& prefix) { return has_signature(file, prefix + entry.signature); });
  };
  if (matches(wanted)) return;
  std::string flag, name = "weights of another model";
  for (const auto& entry : published_backbones()) {
    if (!matches(entry)) continue;
    name = "weights of " + entry.name;
    flag = entry.option;
    break;
  }
  std::replace(flag.begin(), flag.end(), '_', '-');
  fail({file.path().string(), "weights of " + wanted.name, name,
        flag.empty() ? "check that the file is the one meant" : "give it as --" + flag});
}

std::string diffusers_autoencoder_name(const std::string& name, int64_t stages) {
  std::smatch match;
  static const std::regex kStage(R"((encoder\.down|decoder\.up)\.(\d+)\.(.*))");
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
