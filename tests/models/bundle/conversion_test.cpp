#include "models/bundle/conversion.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/tensors/weight_tensors.h"
#include "models/backbones/da3_backbone.h"
#include "models/bundle/published_backbones.h"
#include "models/bundle/random_bundle.h"
#include "models/decoders/dpt_head.h"
#include "tests/models/bundle/renamed_tensors.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/pickle_text.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <map>
#include <string>
#include <tuple>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::PickleText;
using test::Tensors;
using test::with_prefix;

// Writes a PyTorch file of nested state_dicts, the way the published training saves one.
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
    da3.merge(with_prefix(part(BundlePart::geometry_head()), DptHead::kPrefix));
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
  options_.store = StoredPrecision::kFloat16;
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

// The release's dpt_decoder.pt replaces tensors of the head, and the others stay.
TEST_F(Conversion, AReplacedHeadTakesThePlaceOfTheBackbones) {
  const Tensors head = part(BundlePart::geometry_head());
  Tensors replaced;
  for (const auto& [name, tensor] : head) {
    if (name.rfind("scratch.output_conv2.", 0) == 0) replaced["decoder." + name] = tensor + 1;
  }
  replaced["pred.norm.bias"] = head.at("norm.bias") + 2;
  write_file_atomically(path("dpt_decoder.pt"), checkpoint({{"model", replaced}}));
  options_.dpt_decoder = path("dpt_decoder.pt");
  const auto report = convert(options_);
  EXPECT_EQ(report["parts"]["dpt_head"]["replaced"], replaced.size());
  const auto written = read_all(ModelBundle::open(options_.out).file(BundlePart::geometry_head()));
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

// DA3's published file has parts for cameras at other places than the rest: in the bundle they are parts of its
// backbone and of its head, where the description has them.
TEST_F(Conversion, TakesTheCamerasOfADa3FileWhereTheModelHasThem) {
  BundleOptions bundle = small_bundle_options();
  bundle.backbone.as<Da3BackboneOptions>().camera_encoder_depth = 2;
  bundle.backbone.as<Da3BackboneOptions>().camera_encoder_heads = 4;
  bundle.geometry_head.as<DptHeadOptions>().camera_decoder = true;
  write_random_bundle(path("seeing"), bundle, 5);
  Tensors file;
  for (const auto& [part, prefix, here] :
       {std::tuple(BundlePart::backbone(), std::string("model.backbone.pretrained."),
                   std::string("cam_enc.")),
        std::tuple(BundlePart::geometry_head(), std::string(DptHead::kPrefix), std::string("cam_dec."))}) {
    for (const auto& [name, tensor] : read_all(ModelBundle::open(path("seeing")).file(part))) {
      file[(name.rfind(here, 0) == 0 ? "model." : prefix) + name] = tensor;
    }
  }
  save_safetensors(path("cameras.safetensors"), file);
  ConversionOptions options;
  options.backbones["da3"] = path("cameras.safetensors");
  options.description = path("seeing") / "model.yaml";
  options.out = path("converted");
  EXPECT_TRUE(convert(options)["ignored"].empty());
  for (const BundlePart& part : {BundlePart::backbone(), BundlePart::geometry_head()}) {
    const auto written = read_all(ModelBundle::open(options.out).file(part));
    const auto expected = read_all(ModelBundle::open(path("seeing")).file(part));
    ASSERT_EQ(written.size(), expected.size());
    for (const auto& [name, tensor] : expected) EXPECT_TRUE(written.at(name).equal(tensor)) << name;
  }

  // A description without them leaves them out, and says so.
  options.description = original() / "model.yaml";
  options.out = path("blind");
  const auto report = convert(options);
  ASSERT_EQ(report["ignored"].size(), 2U);
  EXPECT_EQ(report["ignored"][0]["names"], "model.cam_dec.*");
  EXPECT_EQ(report["ignored"][1]["reason"], "DA3's camera encoder, which the model's description leaves out");
  EXPECT_EQ(
      read_all(ModelBundle::open(options.out).file(BundlePart::backbone())).count("cam_enc.token_norm.bias"),
      0U);

  // A file without them cannot make a model that has them.
  options.backbones["da3"] = path("da3.safetensors");
  options.description = path("seeing") / "model.yaml";
  options.out = path("neither");
  EXPECT_EQ(
      error_of([&] { convert(options); }),
      path("da3.safetensors").string() +
          ": expected DA3's camera encoder, tensors model.cam_enc.*, found none; get the whole file, or say in "
          "--description what the model has (backbone.camera_encoder_depth: 0).");

  // Without a description the file decides.
  auto released = released_da3_options();
  const auto& da3 = published_backbone("da3");
  da3.take_optional_parts(*WeightFile::open(path("cameras.safetensors")), released);
  EXPECT_EQ(released.backbone.as<Da3BackboneOptions>().camera_encoder_depth, 4);
  EXPECT_TRUE(released.geometry_head.architecture().decodes_cameras());
  da3.take_optional_parts(*WeightFile::open(original() / "backbone.safetensors"), released);
  EXPECT_FALSE(released.backbone.architecture().takes_cameras());
  EXPECT_FALSE(released.geometry_head.architecture().decodes_cameras());
}

// What RAE_DA3 of the published program made of a head and a dpt_decoder.pt that PyTorch wrote; the reference case is
// what that head then predicts.
TEST_F(Conversion, TheReplacedHeadIsThePublishedProgramsOne) {
  const auto reference = test::test_data() / "reference_cases" / "dpt_head_da3_replaced";
  BundleOptions bundle = small_bundle_options();
  const auto config = nlohmann::json::parse(read_file(reference / "case.json"))["config"];
  auto& head = bundle.geometry_head.as<DptHeadOptions>();
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
  const Tensors written = with_prefix(
      read_all(ModelBundle::open(options.out).file(BundlePart::geometry_head())), DptHead::kPrefix);
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
          ": expected no tensor beside the model's own, found the unexpected tensor ema.s_projector.scale; check "
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
  options_.store = StoredPrecision::kFloat16;
  auto large = part(BundlePart::of(level_model(1)));
  large["s_projector.bias"] = torch::full({128}, -70000.0F);
  EXPECT_EQ(refusal(large),
            where +
                ": tensor ema.s_projector.bias: expected numbers that fit float16, found 70000; "
                "choose --store bfloat16 or float32.");
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
  EXPECT_EQ(
      error_of([&] { options.check(); }),
      "gld convert: expected at least one file to convert, found none; give --release, --da3, --level1, ... "
      "(see gld convert --help).");
  options.out.clear();
  EXPECT_EQ(error_of([&] { options.check(); }),
            "--out: expected a folder to write into, found nothing; add for example --out models/gld.");
}

}  // namespace
}  // namespace gld
