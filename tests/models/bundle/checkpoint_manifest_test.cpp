// Every module, built at the published size on the meta device (names and shapes, no memory), has exactly the tensors
// of the published checkpoint.

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "models/backbones/da3_backbone.h"
#include "models/bundle/bundle.h"
#include "models/bundle/published_backbones.h"
#include "models/decoders/dpt_head.h"
#include "models/weights/weight_loading.h"
#include "tests/support/data_folders.h"

#include <algorithm>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include <torch/nn/module.h>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using Shapes = std::map<std::string, std::vector<int64_t>>;

Shapes manifest(const std::string& file, const std::string& of = "checkpoint_manifests.json") {
  const auto all = nlohmann::json::parse(read_file(test::test_data() / of));
  return all.at(file).get<Shapes>();
}

Shapes backbone_manifest(const std::string& file) { return manifest(file, "backbone_manifests.json"); }

void add(Shapes& shapes, const torch::nn::Module& module, const std::string& prefix) {
  for (const auto& [name, tensor] : named_tensors(module)) {
    EXPECT_TRUE(tensor.is_meta()) << name;
    EXPECT_TRUE(shapes.emplace(prefix + name, tensor.sizes().vec()).second) << name;
  }
}

std::shared_ptr<torch::nn::Module> at_full_size(BundlePart part, const BundleOptions& options) {
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  return make_bundle_module(part, options, meta);
}

void expect_equal(const Shapes& module, const Shapes& published) {
  for (const auto& [name, shape] : published) {
    const auto found = module.find(name);
    if (found == module.end()) {
      ADD_FAILURE() << "the module has no " << name;
    } else {
      EXPECT_EQ(found->second, shape) << name;
    }
  }
  for (const auto& entry : module)
    EXPECT_EQ(published.count(entry.first), 1U) << "not published: " << entry.first;
  EXPECT_GT(published.size(), 150U);
}

// Names are as in the file, of which a few parts stand elsewhere than the rest.
void add_published(Shapes& shapes, const torch::nn::Module& module, const std::string& prefix,
                   const std::vector<std::pair<std::string, std::string>>& elsewhere) {
  Shapes own;
  add(own, module, "");
  for (auto& [name, shape] : own) {
    std::string full = prefix + name;
    for (const auto& [there, here] : elsewhere) {
      if (name.rfind(here, 0) == 0) full = there + name.substr(here.size());
    }
    EXPECT_TRUE(shapes.emplace(full, shape).second) << full;
  }
}

bool is_of_cameras(const std::string& name) {
  return name.rfind("model.cam_dec.", 0) == 0 || name.rfind("model.cam_enc.", 0) == 0;
}

Shapes da3_module(const BundleOptions& options) {
  const auto& backbone = options.backbone.architecture();
  const auto& head = options.geometry_head.architecture();
  Shapes module;
  add_published(module, *at_full_size(BundlePart::backbone(), options), backbone.published_prefix(),
                backbone.published_elsewhere());
  add_published(module, *at_full_size(BundlePart::geometry_head(), options), DptHead::kPrefix,
                head.published_elsewhere());
  return module;
}

TEST(CheckpointManifest, Da3BackboneHeadAndCameras) {
  const auto published = manifest("da3_base.safetensors");
  auto options = released_da3_options();
  options.backbone.as<Da3BackboneOptions>().camera_encoder_depth = 4;
  options.geometry_head.as<DptHeadOptions>().camera_decoder = true;
  check_options(options, "DA3");
  expect_equal(da3_module(options), published);
}

// Bundles of before, and descriptions that leave the cameras out.
TEST(CheckpointManifest, Da3WithoutItsPartsForCameras) {
  auto published = manifest("da3_base.safetensors");
  size_t of_cameras = 0;
  for (auto entry = published.begin(); entry != published.end();) {
    of_cameras += is_of_cameras(entry->first) ? 1 : 0;
    entry = is_of_cameras(entry->first) ? published.erase(entry) : std::next(entry);
  }
  EXPECT_EQ(of_cameras, 74U);
  expect_equal(da3_module(released_da3_options()), published);
}

TEST(CheckpointManifest, RgbDecoder) {
  Shapes module;
  add(module, *at_full_size(BundlePart::rgb_decoder(), released_da3_options()), RgbDecoder::kPrefix);
  expect_equal(module, manifest("gld_da3_rgb_decoder.pt:ema"));
}

TEST(CheckpointManifest, Da3Dits) {
  const auto options = released_da3_options();
  Shapes level1, released_cascade;
  add(level1, *at_full_size(BundlePart::of(level_model(1)), options), "");
  expect_equal(level1, manifest("gld_da3_level1.pt:ema"));
  add(released_cascade, *at_full_size(BundlePart::of(cascade(1, 0)), options), "");
  expect_equal(released_cascade, manifest("gld_da3_cascade.pt:ema"));
}

TEST(CheckpointManifest, VggtDits) {
  const BundleOptions options = released_vggt_options();
  Shapes level1, released_cascade;
  add(level1, *at_full_size(BundlePart::of(level_model(1)), options), "");
  expect_equal(level1, manifest("gld_vggt_level1.pt:ema"));
  add(released_cascade, *at_full_size(BundlePart::of(cascade(1, 0)), options), "");
  expect_equal(released_cascade, manifest("gld_vggt_cascade.pt:ema"));
}

TEST(CheckpointManifest, VggtBackboneAndHeads) {
  const auto options = released_vggt_options();
  check_options(options, "VGGT");
  Shapes module;
  add(module, *at_full_size(BundlePart::backbone(), options),
      options.backbone.architecture().published_prefix());
  add(module, *at_full_size(BundlePart::geometry_head(), options), "");
  expect_equal(module, backbone_manifest("vggt_1b"));
}

TEST(CheckpointManifest, BackbonesOfOneLevel) {
  const auto backbone_of = [](const std::string& option) {
    const auto options = published_backbone(option).options();
    check_options(options, option);
    Shapes shapes;
    add(shapes, *at_full_size(BundlePart::backbone(), options), "");
    return shapes;
  };
  expect_equal(backbone_of("dinov2"), backbone_manifest("dinov2_vitb14_reg4"));
  expect_equal(backbone_of("autoencoder_kl"), backbone_manifest("autoencoder_kl_sd"));
  Shapes halves;
  for (const std::string half : {"encoder", "decoder"}) {
    const std::string prefix = half + ".";
    for (const auto& [name, shape] : backbone_manifest("taef2_" + half)) halves[prefix + name] = shape;
  }
  expect_equal(backbone_of("tiny_autoencoder_encoder"), halves);
}

// Names as CompVis wrote them, and diffusers in its first versions.
TEST(CheckpointManifest, OriginalNamesOfAutoencoders) {
  for (const auto& [original, name] : std::map<std::string, std::string>{
           {"encoder.down.0.block.1.norm1.weight", "encoder.down_blocks.0.resnets.1.norm1.weight"},
           {"encoder.down.1.block.0.nin_shortcut.weight",
            "encoder.down_blocks.1.resnets.0.conv_shortcut.weight"},
           {"encoder.down.2.downsample.conv.bias", "encoder.down_blocks.2.downsamplers.0.conv.bias"},
           {"encoder.mid.block_1.conv1.weight", "encoder.mid_block.resnets.0.conv1.weight"},
           {"encoder.mid.attn_1.norm.weight", "encoder.mid_block.attentions.0.group_norm.weight"},
           {"decoder.mid.attn_1.q.weight", "decoder.mid_block.attentions.0.to_q.weight"},
           {"decoder.mid.attn_1.proj_out.bias", "decoder.mid_block.attentions.0.to_out.0.bias"},
           {"decoder.up.3.block.2.conv2.bias", "decoder.up_blocks.0.resnets.2.conv2.bias"},
           {"decoder.up.1.upsample.conv.weight", "decoder.up_blocks.2.upsamplers.0.conv.weight"},
           {"decoder.norm_out.weight", "decoder.conv_norm_out.weight"},
           {"decoder.conv_out.weight", "decoder.conv_out.weight"},
           {"decoder.mid_block.attentions.0.query.weight", "decoder.mid_block.attentions.0.to_q.weight"},
           {"encoder.mid_block.attentions.0.proj_attn.bias", "encoder.mid_block.attentions.0.to_out.0.bias"},
           {"encoder.conv_norm_out.bias", "encoder.conv_norm_out.bias"},
           {"quant_conv.weight", "quant_conv.weight"}}) {
    EXPECT_EQ(diffusers_autoencoder_name(original, 4), name);
    EXPECT_EQ(backbone_manifest("autoencoder_kl_sd").count(name), 1U) << name;
  }
}

}  // namespace
}  // namespace gld
