// This takes published files of backbones through gld convert, and tests what each gives, and what is refused by name.
#include "models/bundle/published_backbones.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"
#include "models/backbones/autoencoder_kl.h"
#include "models/backbones/dinov2_backbone.h"
#include "models/bundle/conversion.h"
#include "models/bundle/random_bundle.h"
#include "models/decoders/vggt_heads.h"
#include "tests/models/bundle/renamed_tensors.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <string>

#include <torch/types.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::Tensors;
using test::with_prefix;

class PublishedBackbones : public testing::Test {
 protected:
  std::filesystem::path path(const std::string& name) const { return folder_.path() / name; }

  test::TemporaryFolder folder_;
};

TEST_F(PublishedBackbones, VggtGivesBackboneAndHeads) {
  BundleOptions small;
  load_yaml(small, test::source_root() / "configs/ablations/latents/vggt/model.yaml");
  write_random_bundle(path("vggt"), small, 5);
  const auto vggt = ModelBundle::open(path("vggt"));
  Tensors file = with_prefix(read_all(vggt.file(BundlePart::backbone())), "aggregator.");
  file.merge(read_all(vggt.file(BundlePart::geometry_head())));
  file["track_head.norm.weight"] = torch::zeros({2});
  save_safetensors(path("vggt.safetensors"), file);
  ConversionOptions options;
  options.backbones["vggt"] = path("vggt.safetensors");
  options.description = path("vggt") / "model.yaml";
  options.out = path("out");
  const auto report = convert(options);
  EXPECT_EQ(report["ignored"][0]["names"], "track_head.*");
  const auto written = ModelBundle::open(options.out);
  for (const auto& part : {BundlePart::backbone(), BundlePart::geometry_head()}) {
    const auto before = read_all(vggt.file(part)), after = read_all(written.file(part));
    ASSERT_EQ(before.size(), after.size());
    for (const auto& [name, tensor] : before) EXPECT_TRUE(after.at(name).equal(tensor)) << name;
  }
  // Another part into the same folder needs no description.
  ConversionOptions more;
  more.statistics_level1 = vggt.file(BundlePart::statistics(1));
  more.out = options.out;
  convert(more);
  EXPECT_TRUE(ModelBundle::open(options.out).has(BundlePart::statistics(1)));

  Tensors headless;
  for (const auto& [name, tensor] : file) {
    if (name.rfind("camera_head.", 0) != 0) headless[name] = tensor;
  }
  save_safetensors(path("headless.safetensors"), headless);
  options.backbones["vggt"] = path("headless.safetensors");
  EXPECT_EQ(
      error_of([&] { convert(options); }),
      options.backbones["vggt"] +
          ": expected VGGT's camera_head, tensors camera_head.*, found none; get the whole file, or say "
          "in --description what the model has (dpt_head.camera_head: false).");
  // A head that the description leaves out is left out of a whole file, too.
  BundleOptions without = small;
  without.geometry_head.as<VggtHeadsOptions>().camera_head = false;
  save_bundle_options(path("without"), without);
  ConversionOptions fewer;
  fewer.backbones["vggt"] = path("vggt.safetensors");
  fewer.description = path("without") / "model.yaml";
  fewer.out = path("fewer");
  convert(fewer);
  for (const auto& [name, tensor] :
       read_all(ModelBundle::open(fewer.out).file(BundlePart::geometry_head()))) {
    EXPECT_NE(name.rfind("camera_head.", 0), 0U) << name;
  }
  ConversionOptions mistaken;
  mistaken.backbones["da3"] = path("vggt.safetensors");
  mistaken.out = path("mistaken");
  EXPECT_EQ(
      error_of([&] { convert(mistaken); }),
      mistaken.backbones["da3"] + ": expected weights of DA3, found weights of VGGT; give it as --vggt.");
  EXPECT_FALSE(std::filesystem::exists(path("mistaken")));
}

TEST_F(PublishedBackbones, ReleasedVggtStatisticsConvert) {
  save_bundle_options(path("out"), released_vggt_options());
  ConversionOptions options;
  options.statistics_level0 = test::test_data() / "stats/vggt/normalization_stats_level0.pt";
  options.statistics_level1 = test::test_data() / "stats/vggt/normalization_stats_level1.pt";
  options.special_statistics_level0 = test::test_data() / "stats/vggt/special_stats_level0.pt";
  options.special_statistics_level1 = test::test_data() / "stats/vggt/special_stats_level1.pt";
  options.out = path("out");
  EXPECT_EQ(convert(options)["parts"].size(), 4U);
  const auto statistics = ModelBundle::open(options.out).load_statistics(level_model(1));
  EXPECT_EQ(statistics.special_tokens, 5);
  EXPECT_EQ(statistics.patches.channels(), 2048);
  EXPECT_EQ(statistics.special->channels(), 2048);
}

TEST_F(PublishedBackbones, DinoNeedsItsRegisters) {
  Dinov2Options dinov2;
  dinov2.sizes.embed_dim = 32;
  dinov2.sizes.num_heads = 2;
  dinov2.sizes.depth = 2;
  dinov2.sizes.pos_embed_grid = 4;
  auto small = single_level_options("small", dinov2);
  for (auto& part : small.generators) {
    part.dit.hidden_size = {32, 32};
    part.dit.depth = {1, 1};
    part.dit.num_heads = {2, 2};
  }
  write_random_bundle(path("dino"), small, 5);
  Tensors file = read_all(ModelBundle::open(path("dino")).file(BundlePart::backbone()));
  save_safetensors(path("dino.safetensors"), file);
  ConversionOptions options;
  options.backbones["dinov2"] = path("dino.safetensors");
  options.description = path("dino") / "model.yaml";
  options.out = path("out");
  EXPECT_EQ(convert(options)["parts"]["backbone"]["tensors"], file.size());
  // What lies there may have been trained on.
  EXPECT_EQ(
      error_of([&] { convert(options); }),
      (path("out") / "backbone.safetensors").string() +
          ": expected no such part in the bundle yet, found one that is there; choose another --out, or add "
          "--overwrite to replace it.");
  options.out = path("other");
  file.erase("register_tokens");
  save_safetensors(path("without.safetensors"), file);
  options.backbones["dinov2"] = path("without.safetensors");
  EXPECT_EQ(error_of([&] { convert(options); }),
            options.backbones["dinov2"] +
                ": expected DINOv2 with registers, a tensor register_tokens, found none; give a model with "
                "registers, or say num_register_tokens: 0, antialias: false and interpolate_offset: 0.1 in "
                "--description.");
}

// A name of a million letters is no tensor of ours, and no reason to run out of stack.
TEST_F(PublishedBackbones, ALongNameIsOneThatNobodyKnows) {
  BundleOptions small;
  load_yaml(small, test::source_root() / "configs/ablations/latents/vae/model.yaml");
  write_random_bundle(path("vae"), small, 5);
  Tensors file = read_all(ModelBundle::open(path("vae")).file(BundlePart::backbone()));
  file["encoder.down.0." + std::string(1'000'000, 'a')] = torch::zeros({1});
  save_safetensors(path("long.safetensors"), file);
  ConversionOptions options;
  options.backbones["autoencoder_kl"] = path("long.safetensors");
  options.description = path("vae") / "model.yaml";
  options.out = path("long");
  EXPECT_NE(error_of([&] { convert(options); }), "");
  EXPECT_FALSE(std::filesystem::exists(path("long") / "model.yaml"));
}

// diffusers' names and the original ones, in which attention is a convolution, give the same.
TEST_F(PublishedBackbones, AutoencodersUnderBothNames) {
  BundleOptions small;
  load_yaml(small, test::source_root() / "configs/ablations/latents/vae/model.yaml");
  write_random_bundle(path("vae"), small, 5);
  const Tensors file = read_all(ModelBundle::open(path("vae")).file(BundlePart::backbone()));
  const auto replace = [](std::string text, const std::string& from, const std::string& to) {
    const auto at = text.find(from);
    return at == std::string::npos ? text : text.replace(at, from.size(), to);
  };
  Tensors original;
  for (const auto& entry : file) {
    std::string name = entry.first;
    torch::Tensor tensor = entry.second;
    if (name.find("attentions") != std::string::npos && tensor.dim() == 2)
      tensor = tensor.view({tensor.size(0), tensor.size(1), 1, 1});
    for (int stage = 0; stage < 4; ++stage) {
      name =
          replace(name, "up_blocks." + std::to_string(stage) + ".", "UP." + std::to_string(3 - stage) + ".");
    }
    for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
             {"UP", "up"},
             {"down_blocks", "down"},
             {"mid_block.resnets.0", "mid.block_1"},
             {"mid_block.resnets.1", "mid.block_2"},
             {"mid_block.attentions.0.group_norm", "mid.attn_1.norm"},
             {"mid_block.attentions.0.to_out.0", "mid.attn_1.proj_out"},
             {"mid_block.attentions.0.to_", "mid.attn_1."},
             {"resnets", "block"},
             {"conv_shortcut", "nin_shortcut"},
             {"downsamplers.0", "downsample"},
             {"upsamplers.0", "upsample"},
             {"conv_norm_out", "norm_out"}}) {
      name = replace(name, from, to);
    }
    original["first_stage_model." + name] = tensor.contiguous();
  }
  // What else lies in whole checkpoints of Stable Diffusion and SDXL, as it is or inside a trainer's state_dict.
  for (const char* name : {"cond_stage_model.logit_scale", "model.diffusion_model.out.2.bias",
                           "alphas_cumprod_prev", "betas", "sqrt_alphas_cumprod", "denoiser.sigmas"}) {
    original[name] = torch::zeros({1});
  }
  save_safetensors(path("diffusers.safetensors"), file);
  save_safetensors(path("original.safetensors"), original);
  save_safetensors(path("trainer.safetensors"), with_prefix(original, "state_dict."));
  for (const char* name : {"diffusers", "original", "trainer"}) {
    ConversionOptions options;
    options.backbones["autoencoder_kl"] = path(std::string(name) + ".safetensors");
    options.description = path("vae") / "model.yaml";
    options.out = path(std::string("from_") + name);
    convert(options);
    const auto written = read_all(ModelBundle::open(options.out).file(BundlePart::backbone()));
    ASSERT_EQ(written.size(), file.size()) << name;
    for (const auto& [tensor_name, tensor] : file)
      EXPECT_TRUE(written.at(tensor_name).equal(tensor)) << name << ' ' << tensor_name;
  }
}

// Both have the same names and shapes: only who converts knows which it is.
TEST_F(PublishedBackbones, SdxlsAutoencoderHasItsOwnScale) {
  EXPECT_EQ(published_backbone("autoencoder_kl").options().backbone.as<AutoencoderKlOptions>().scaling_factor,
            0.18215);
  EXPECT_EQ(
      published_backbone("sdxl_autoencoder").options().backbone.as<AutoencoderKlOptions>().scaling_factor,
      0.13025);
}

// The corrected command finds what the mistaken one found.
TEST_F(PublishedBackbones, ARefusedConversionLeavesNothingBehind) {
  BundleOptions small;
  load_yaml(small, test::source_root() / "configs/ablations/latents/dinov2/model.yaml");
  write_random_bundle(path("dinov2"), small, 5);
  const auto bundle = ModelBundle::open(path("dinov2"));
  Tensors torn = read_all(bundle.file(BundlePart::backbone()));
  torn.erase("blocks.0.norm1.weight");
  save_safetensors(path("torn.safetensors"), torn);
  ConversionOptions mistaken;
  mistaken.statistics_level0 = bundle.file(BundlePart::statistics(0));
  mistaken.backbones["dinov2"] = path("torn.safetensors");
  mistaken.description = path("dinov2") / "model.yaml";
  mistaken.out = path("out");
  EXPECT_THAT(error_of([&] { convert(mistaken); }), testing::HasSubstr("blocks.0.norm1.weight"));
  EXPECT_FALSE(std::filesystem::exists(path("out")));
  std::filesystem::create_directory(path("out"));
  write_file_atomically(path("out") / "notes.txt", "mine");
  EXPECT_THROW(convert(mistaken), Error);
  EXPECT_TRUE(std::filesystem::exists(path("out") / "notes.txt"));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(path("out")), {}), 1);
}

TEST_F(PublishedBackbones, WhatAFileHoldsIsNamedWhereverItIsGiven) {
  save_safetensors(path("vggt.safetensors"), {{"aggregator.camera_token", torch::zeros({1})}});
  save_safetensors(path("statistics.safetensors"), {{"mean", torch::zeros({4})}, {"var", torch::ones({4})}});
  ConversionOptions options;
  options.out = path("out");
  options.level1 = path("vggt.safetensors");
  EXPECT_EQ(error_of([&] { convert(options); }),
            options.level1 + ": expected weights of M1, found weights of VGGT; give it as --vggt.");
  options.level1 = path("statistics.safetensors");
  EXPECT_EQ(error_of([&] { convert(options); }),
            options.level1 +
                ": expected weights of M1, found latent statistics; give it as --statistics-level0 or "
                "--statistics-level1.");
  save_safetensors(path("hugging.safetensors"), {{"embeddings.cls_token", torch::zeros({1})}});
  ConversionOptions dinov2;
  dinov2.out = path("out");
  dinov2.backbones["dinov2"] = path("hugging.safetensors");
  EXPECT_EQ(
      error_of([&] { convert(dinov2); }),
      path("hugging.safetensors").string() +
          ": expected weights of DINOv2, found DINOv2 under Hugging Face's names, which are not read: give the "
          "original .pth.");
  EXPECT_FALSE(std::filesystem::exists(path("out")));
}

TEST_F(PublishedBackbones, TinyAutoencodersComeInTwoFiles) {
  BundleOptions small;
  load_yaml(small, test::source_root() / "configs/ablations/latents/taef2/model.yaml");
  write_random_bundle(path("taef2"), small, 5);
  const Tensors both = read_all(ModelBundle::open(path("taef2")).file(BundlePart::backbone()));
  for (const std::string half : {"encoder", "decoder"}) {
    Tensors file;
    for (const auto& [name, tensor] : both) {
      if (name.rfind(half + ".", 0) == 0) file[name.substr(half.size() + 1)] = tensor;
    }
    save_safetensors(path(half + ".safetensors"), file);
  }
  ConversionOptions options;
  options.backbones["tiny_autoencoder_encoder"] = path("encoder.safetensors");
  options.backbones["tiny_autoencoder_decoder"] = path("decoder.safetensors");
  options.description = path("taef2") / "model.yaml";
  options.out = path("out");
  EXPECT_EQ(convert(options)["parts"]["backbone"]["tensors"], both.size());
  const auto written = read_all(ModelBundle::open(options.out).file(BundlePart::backbone()));
  for (const auto& [name, tensor] : both) EXPECT_TRUE(written.at(name).equal(tensor)) << name;
  options.backbones["tiny_autoencoder_decoder"] = path("encoder.safetensors");
  EXPECT_EQ(error_of([&] { convert(options); }),
            options.backbones["tiny_autoencoder_decoder"] +
                ": expected weights of the decoder of a tiny autoencoder, found weights of the encoder of a "
                "tiny autoencoder; give it as --tiny-autoencoder-encoder.");
}

}  // namespace
}  // namespace gld
