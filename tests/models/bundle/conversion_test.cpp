#include "models/bundle/conversion.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"
#include "models/backbones/autoencoder_kl.h"
#include "models/backbones/dinov2_backbone.h"
#include "models/bundle/published_backbones.h"
#include "models/bundle/random_bundle.h"
#include "models/decoders/vggt_heads.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/pickle_text.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <map>
#include <string>

#include <torch/types.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::PickleText;
using Tensors = std::map<std::string, torch::Tensor>;

// A PyTorch file of nested state_dicts, the way the published training saves one.
std::string checkpoint(const std::map<std::string, Tensors>& dictionaries) {
  PickleText pickle;
  std::map<std::string, std::string> storages;
  pickle.op('}').op('(');
  for (const auto& [dictionary, tensors] : dictionaries) {
    pickle.text(dictionary).empty_ordered_dictionary().op('(');
    for (const auto& [name, tensor] : tensors) {
      const std::string key = std::to_string(storages.size());
      const auto values = tensor.to(torch::kFloat32).contiguous();
      storages[key] = {static_cast<const char*>(values.data_ptr()),
                       static_cast<size_t>(values.numel()) * sizeof(float)};
      pickle.text(name).tensor(key, values.numel(), 0, values.sizes().vec(),
                               row_major_strides(values.sizes().vec()));
    }
    pickle.op('u');
  }
  pickle.text("train_steps").integer(70000).op('u');
  return test::torch_zip(pickle.stopped(), storages);
}

Tensors with_prefix(const Tensors& tensors, const std::string& prefix) {
  Tensors renamed;
  for (const auto& [name, tensor] : tensors) renamed[prefix + name] = tensor;
  return renamed;
}

Tensors negated(const Tensors& tensors) {
  Tensors other;
  for (const auto& [name, tensor] : tensors) other[name] = -tensor;
  return other;
}

// The published files of a small model, made from a random bundle.
class Conversion : public testing::Test {
 protected:
  void SetUp() override {
    write_random_bundle(original(), small_bundle_options(), 3);
    Tensors da3 =
        with_prefix(part(BundlePart::backbone()), BackboneOptions().architecture().published_prefix());
    da3.merge(with_prefix(part(BundlePart::dpt_head()), DptHead::kPrefix));
    da3["model.cam_dec.fc_t.bias"] = torch::zeros({3});
    save_safetensors(path("da3.safetensors"), da3);
    const Tensors decoder = with_prefix(part(BundlePart::rgb_decoder()), RgbDecoder::kPrefix);
    write_file_atomically(path("decoder.pt"), checkpoint({{"ema", decoder}, {"model", negated(decoder)}}));
    const Tensors level1 = part(BundlePart::of(level_model(1)));
    write_file_atomically(
        path("level1.pt"),
        checkpoint({{"ema", level1}, {"model", negated(level1)}, {"opt", {{"exp_avg", torch::zeros({2})}}}}));
    write_file_atomically(path("cascade.pt"), checkpoint({{"ema", part(BundlePart::of(cascade(1, 0)))}}));
    options_.backbones["da3"] = path("da3.safetensors");
    options_.rgb_decoder = path("decoder.pt");
    options_.level1 = path("level1.pt");
    options_.cascade = path("cascade.pt");
    options_.statistics_level0 = original() / "statistics_level0.safetensors";
    options_.statistics_level1 = original() / "statistics_level1.safetensors";
    options_.description = original() / "model.yaml";
    options_.out = path("out");
  }

  std::filesystem::path path(const std::string& name) const { return folder_.path() / name; }
  std::filesystem::path original() const { return path("original"); }
  Tensors part(BundlePart part) const { return read_all(ModelBundle::open(original()).file(part)); }

  test::TemporaryFolder folder_;
  ConversionOptions options_;
};

TEST_F(Conversion, GivesTheBundleThatTheFilesCameFrom) {
  const auto report = convert(options_);
  EXPECT_EQ(ModelBundle::open(options_.out).content_hash(), ModelBundle::open(original()).content_hash());
  EXPECT_EQ(report["parts"].size(), 7U);
  EXPECT_EQ(report["missing"].size(), 0U);
  EXPECT_EQ(report["parts"]["level1"]["selection"], "ema.");
  std::map<std::string, int64_t> ignored;
  for (const auto& entry : report["ignored"]) ignored[entry["names"]] += entry["tensors"].get<int64_t>();
  EXPECT_EQ(ignored.at("model.cam_dec.*"), 1);
  EXPECT_EQ(ignored.at("opt.*"), 1);
  EXPECT_EQ(ignored.at("model.*"), static_cast<int64_t>(part(BundlePart::of(level_model(1))).size() +
                                                        part(BundlePart::rgb_decoder()).size()));
  EXPECT_NE(conversion_text(report).find("left out           1 tensors opt.* of " + options_.level1 +
                                         ": state of the optimiser\n"),
            std::string::npos);
  EXPECT_EQ(nlohmann::json::parse(read_file(path("out") / "conversion.json"))["parts"].size(), 7U);
}

TEST_F(Conversion, TakesTheOtherCopy) {
  options_.cascade.clear();
  options_.weights = CheckpointWeights::kModel;
  convert(options_);
  const auto bundle = ModelBundle::open(options_.out);
  EXPECT_TRUE(read_all(bundle.file(BundlePart::of(level_model(1))))
                  .at("s_projector.bias")
                  .equal(-part(BundlePart::of(level_model(1))).at("s_projector.bias")));
  EXPECT_FALSE(bundle.has(BundlePart::of(cascade(1, 0))));
}

TEST_F(Conversion, StoresHalfPrecisionButNeverOfStatistics) {
  options_.precision = StoredPrecision::kFloat16;
  convert(options_);
  const auto bundle = ModelBundle::open(options_.out);
  for (const auto& entry : WeightFile::open(bundle.file(BundlePart::of(level_model(1))))->entries()) {
    EXPECT_EQ(entry.dtype, DType::kFloat16) << entry.name;
  }
  const auto statistics = read_all(bundle.file(BundlePart::statistics(1)));
  EXPECT_TRUE(statistics.at("mean").equal(part(BundlePart::statistics(1)).at("mean")));
  EXPECT_EQ(statistics.at("mean").scalar_type(), torch::kFloat32);
}

TEST_F(Conversion, AddsPartsToAnExistingBundle) {
  auto first = options_;
  first.level1.clear();
  first.cascade.clear();
  EXPECT_EQ(convert(first)["missing"].dump(), R"(["level1","cascade"])");
  auto second = options_;
  second.backbones.clear();
  second.rgb_decoder.clear();
  second.statistics_level0.clear();
  // A part that is there is not taken away without a word.
  EXPECT_EQ(
      error_of([&] { convert(second); }),
      (path("out") / "statistics_level1.safetensors").string() +
          ": expected no such part in the bundle yet, found one that is there; choose another --out, or add "
          "--overwrite to replace it.");
  second.statistics_level1.clear();
  EXPECT_EQ(convert(second)["missing"].size(), 0U);
  EXPECT_EQ(ModelBundle::open(options_.out).content_hash(), ModelBundle::open(original()).content_hash());
}

TEST_F(Conversion, RealStatisticsConvert) {
  ConversionOptions options;
  options.statistics_level1 = test::test_data() / "stats/da3/normalization_stats_level1.pt";
  options.out = path("released");
  const auto report = convert(options);
  EXPECT_EQ(report["parts"]["statistics_level1"]["elements"], 3072);
  EXPECT_EQ(report["ignored"][0]["names"], "std");
  EXPECT_EQ(ModelBundle::open(options.out).options().rgb_decoder.num_layers, 28);
  options.statistics_level1 = test::test_data() / "stats/vggt/normalization_stats_level1.pt";
  options.overwrite = true;
  EXPECT_EQ(error_of([&] { convert(options); }),
            options.statistics_level1 +
                ": expected 1536 channels, found 2048; check that the file belongs to this backbone.");
}

TEST_F(Conversion, VggtGivesBackboneAndHeads) {
  BundleOptions small;
  load_yaml(small, test::source_root() / "configs/ablations/latents/vggt/model.yaml");
  write_random_bundle(path("vggt"), small, 5);
  const auto vggt = ModelBundle::open(path("vggt"));
  Tensors file = with_prefix(read_all(vggt.file(BundlePart::backbone())), "aggregator.");
  file.merge(read_all(vggt.file(BundlePart::dpt_head())));
  file["track_head.norm.weight"] = torch::zeros({2});
  save_safetensors(path("vggt.safetensors"), file);
  ConversionOptions options;
  options.backbones["vggt"] = path("vggt.safetensors");
  options.description = path("vggt") / "model.yaml";
  options.out = path("out");
  const auto report = convert(options);
  EXPECT_EQ(report["ignored"][0]["names"], "track_head.*");
  const auto written = ModelBundle::open(options.out);
  for (const auto& part : {BundlePart::backbone(), BundlePart::dpt_head()}) {
    const auto before = read_all(vggt.file(part)), after = read_all(written.file(part));
    ASSERT_EQ(before.size(), after.size());
    for (const auto& [name, tensor] : before) EXPECT_TRUE(after.at(name).equal(tensor)) << name;
  }
  // Another part into the same folder needs no description.
  ConversionOptions more;
  more.statistics_level0 = vggt.file(BundlePart::statistics(0));
  more.out = options.out;
  convert(more);
  EXPECT_TRUE(ModelBundle::open(options.out).has(BundlePart::statistics(0)));

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
  without.dpt_head.as<VggtHeadsOptions>().camera_head = false;
  save_bundle_options(path("without"), without);
  ConversionOptions fewer;
  fewer.backbones["vggt"] = path("vggt.safetensors");
  fewer.description = path("without") / "model.yaml";
  fewer.out = path("fewer");
  convert(fewer);
  for (const auto& [name, tensor] : read_all(ModelBundle::open(fewer.out).file(BundlePart::dpt_head()))) {
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

TEST_F(Conversion, ReleasedVggtStatisticsConvert) {
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

TEST_F(Conversion, DinoNeedsItsRegisters) {
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
  file.erase("register_tokens");
  save_safetensors(path("without.safetensors"), file);
  options.backbones["dinov2"] = path("without.safetensors");
  EXPECT_EQ(error_of([&] { convert(options); }),
            options.backbones["dinov2"] +
                ": expected DINOv2 with registers, a tensor register_tokens, found none; give a model with "
                "registers, or say num_register_tokens: 0, antialias: false and interpolate_offset: 0.1 in "
                "--description.");
}

// diffusers' names and the original ones, in which attention is a convolution, give the same.
TEST_F(Conversion, AutoencodersUnderBothNames) {
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
TEST_F(Conversion, SdxlsAutoencoderHasItsOwnScale) {
  EXPECT_EQ(published_backbone("autoencoder_kl").options().backbone.as<AutoencoderKlOptions>().scaling_factor,
            0.18215);
  EXPECT_EQ(
      published_backbone("sdxl_autoencoder").options().backbone.as<AutoencoderKlOptions>().scaling_factor,
      0.13025);
}

// The corrected command finds what the mistaken one found.
TEST_F(Conversion, ARefusedConversionLeavesNothingBehind) {
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

TEST_F(Conversion, WhatAFileHoldsIsNamedWhereverItIsGiven) {
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

TEST_F(Conversion, TinyAutoencodersComeInTwoFiles) {
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

// The release's dpt_decoder.pt replaces tensors of the head, and the others stay.
TEST_F(Conversion, AReplacedHeadTakesThePlaceOfTheBackbones) {
  const Tensors head = part(BundlePart::dpt_head());
  Tensors replaced;
  for (const auto& [name, tensor] : head) {
    if (name.rfind("scratch.output_conv2.", 0) == 0) replaced["decoder." + name] = tensor + 1;
  }
  replaced["pred.norm.bias"] = head.at("norm.bias") + 2;
  write_file_atomically(path("dpt_decoder.pt"), checkpoint({{"model", replaced}}));
  options_.dpt_decoder = path("dpt_decoder.pt");
  const auto report = convert(options_);
  EXPECT_EQ(report["parts"]["dpt_head"]["replaced"], replaced.size());
  const auto written = read_all(ModelBundle::open(options_.out).file(BundlePart::dpt_head()));
  ASSERT_EQ(written.size(), head.size());
  for (const auto& [name, tensor] : head) {
    const double added = name == "norm.bias" ? 2 : name.rfind("scratch.output_conv2.", 0) == 0 ? 1 : 0;
    EXPECT_TRUE(written.at(name).equal(added == 0 ? tensor : tensor + added)) << name;
  }
  write_file_atomically(path("empty.pt"), checkpoint({{"model", {{"other", torch::zeros({1})}}}}));
  options_.dpt_decoder = path("empty.pt");
  options_.overwrite = true;
  EXPECT_EQ(error_of([&] { convert(options_); }),
            options_.dpt_decoder +
                ": expected tensors model.decoder.* or model.pred.*, found none; give the release's "
                "dpt_decoder.pt.");
}

// What RAE_DA3 of the published program made of a head and a dpt_decoder.pt that PyTorch wrote; the reference case is
// what that head then predicts.
TEST_F(Conversion, TheReplacedHeadIsThePublishedProgramsOne) {
  const auto reference = test::test_data() / "reference_cases" / "dpt_head_da3_replaced";
  BundleOptions bundle = small_bundle_options();
  const auto config = nlohmann::json::parse(read_file(reference / "case.json"))["config"];
  auto& head = bundle.dpt_head.as<DptHeadOptions>();
  ASSERT_EQ(head.dim_in, config["dim_in"]);
  head.features = config["features"];
  head.out_channels = config["out_channels"].get<std::vector<int64_t>>();
  head.aux_pyramid_levels = config["aux_pyramid_levels"];
  head.aux_out1_conv_num = config["aux_out1_conv_num"];
  save_bundle_options(path("description"), bundle);
  Tensors da3 =
      with_prefix(part(BundlePart::backbone()), BackboneOptions().architecture().published_prefix());
  da3.merge(with_prefix(read_all(test::test_data() / "dpt_decoder" / "head.safetensors"), DptHead::kPrefix));
  save_safetensors(path("da3.safetensors"), da3);
  ConversionOptions options;
  options.backbones["da3"] = path("da3.safetensors");
  options.dpt_decoder = test::test_data() / "dpt_decoder" / "dpt_decoder.pt";
  options.description = path("description") / "model.yaml";
  options.out = path("replaced");
  convert(options);
  const Tensors expected = read_all(reference / "weights.safetensors");
  const Tensors written =
      with_prefix(read_all(ModelBundle::open(options.out).file(BundlePart::dpt_head())), DptHead::kPrefix);
  ASSERT_EQ(written.size(), expected.size());
  for (const auto& [name, tensor] : expected) {
    EXPECT_TRUE(written.at(name).to(torch::kFloat32).equal(tensor.to(torch::kFloat32))) << name;
  }
}

TEST_F(Conversion, IsStrict) {
  const auto refusal = [&](const Tensors& level1) {
    write_file_atomically(path("level1.pt"), checkpoint({{"ema", level1}}));
    auto only = options_;
    only.backbones.clear();
    only.overwrite = true;
    return error_of([&] { convert(only); });
  };
  const std::string where = path("level1.pt").string();
  auto missing = part(BundlePart::of(level_model(1)));
  missing.erase("s_projector.bias");
  EXPECT_EQ(refusal(missing),
            where +
                ": expected a tensor named ema.s_projector.bias, found none; check that the "
                "configuration belongs to these weights.");
  auto unexpected = part(BundlePart::of(level_model(1)));
  unexpected["s_projector.scale"] = torch::zeros({1});
  EXPECT_EQ(
      refusal(unexpected),
      where +
          ": expected no tensor beside the model's own, found the unexpected tensor s_projector.scale; check "
          "that the configuration belongs to these weights (the model's nearest tensor is "
          "s_projector.bias).");
  auto misshapen = part(BundlePart::of(level_model(1)));
  misshapen["s_projector.bias"] = torch::zeros({3});
  EXPECT_EQ(refusal(misshapen), where +
                                    ": tensor ema.s_projector.bias: expected shape (128), found (3); "
                                    "check that the configuration belongs to these weights.");
  auto broken = part(BundlePart::of(level_model(1)));
  broken["s_projector.bias"] = torch::full({128}, std::numeric_limits<float>::quiet_NaN());
  EXPECT_EQ(refusal(broken),
            where +
                ": tensor ema.s_projector.bias: expected finite numbers, found NaN or infinity; get "
                "the file again, its weights are broken.");
  options_.precision = StoredPrecision::kFloat16;
  auto large = part(BundlePart::of(level_model(1)));
  large["s_projector.bias"] = torch::full({128}, -70000.0F);
  EXPECT_EQ(refusal(large),
            where +
                ": tensor ema.s_projector.bias: expected numbers that fit float16, found 70000; "
                "choose --precision bf16 or fp32.");
  write_file_atomically(path("level1.pt"), checkpoint({{"ema", part(BundlePart::of(level_model(1)))},
                                                       {"extra", {{"w", torch::zeros({1})}}}}));
  options_.overwrite = true;
  EXPECT_EQ(
      error_of([&] { convert(options_); }),
      where +
          ": expected only tensors of the model, found the unexpected tensor extra.w; check that the file is "
          "the one meant and that --weights chooses the right copy.");
}

TEST_F(Conversion, NeedsAFileAndAFolder) {
  ConversionOptions options;
  options.out = "somewhere";
  EXPECT_EQ(error_of([&] { options.check(); }),
            "gld convert: expected at least one file to convert, found none; give --da3, --level1, ... (see "
            "gld convert --help).");
  options.out.clear();
  EXPECT_EQ(error_of([&] { options.check(); }),
            "--out: expected a folder to write into, found nothing; add for example --out models/gld.");
}

}  // namespace
}  // namespace gld
