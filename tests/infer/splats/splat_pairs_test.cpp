#include "infer/splats/splat_pairs.h"

#include "datasets/images/image_file.h"
#include "datasets/splats/splat_picture.h"
#include "datasets/synthetic/synth.h"
#include "gld/base/atomic_file.h"
#include "gld/latents/latent_statistics.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/export/image_export.h"
#include "infer/splats/latent_render.h"
#include "infer/splats/splat_evaluation.h"
#include "models/splats/splatted_scene.h"
#include "tests/models/splats/small_autoencoder.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "train/splats/splat_features.h"

#include <algorithm>
#include <filesystem>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

// What a command says on standard output is not looked at.
template <class Run>
void quietly(const Run& run) {
  testing::internal::CaptureStdout();
  run();
  testing::internal::GetCapturedStdout();
}

template <class Options>
void make_small(Options& options, const ModelBundle& bundle, const std::filesystem::path& out) {
  options.model = bundle.folder().string();
  options.out = out.string();
  options.synthetic = 2;
  options.generator.frames = 9;
  options.generator.width = options.generator.height = 64;
  options.side = 64;
  options.held_out = 2;
  options.threads = 1;
  options.fit.steps = 20;
  options.fit.density.most_gaussians = 2000;
}

class SplatPairs : public testing::Test {
 protected:
  SplatPairs() : bundle_(test::write_small_autoencoder(folder_.path() / "bundle", true)) {
    make_small(options_, bundle_, folder_.path() / "run");
  }
  std::filesystem::path file(int64_t scene) const {
    const std::string number = "00000" + std::to_string(scene);
    return folder_.path() / "run" / "pairs" / (number + "_synthetic_0_" + number + ".safetensors");
  }
  // Makes the refiner's network predict 0.
  void silence_refiner() const {
    const auto file = bundle_.file(BundlePart::refiner());
    const auto notes = WeightFile::open(file)->metadata();
    auto tensors = read_all(file);
    for (const char* name : {"conv_out.weight", "conv_out.bias"})
      tensors.at(name) = torch::zeros_like(tensors.at(name));
    save_safetensors(file, tensors, notes);
  }
  TemporaryFolder folder_;
  ModelBundle bundle_;
  SplatPairsOptions options_;
};

TEST_F(SplatPairs, KeepWhatGaussiansShowBesideTheTruth) {
  quietly([&] { run_splat_pairs(options_); });
  const SplattedScene scene = read_splatted_scene(file(1));
  EXPECT_EQ(scene.fitted, 7);
  EXPECT_EQ(scene.held_out(), 2);
  EXPECT_EQ(scene.pictures.size(2), 64);
  EXPECT_EQ(scene.encoded.size(2), 8);
  EXPECT_EQ(scene.tag.statistics, "of the model");
  // What is encoded is the pictures' own latent.
  const auto again =
      LatentEncoding(bundle_)(scene.pictures.to(torch::kFloat32) / 255, {0}).front().pictures[8];
  EXPECT_LT((tensor_of(again) - scene.encoded[8].to(torch::kFloat32)).abs().max().item<double>(), 0.05);
  // Colours of the held-out views, encoded, are nearer to these views' latents than to each other's.
  const auto away = [&](int64_t colours, int64_t view) {
    return (scene.colours[colours].to(torch::kFloat32) - scene.encoded[7 + view].to(torch::kFloat32))
        .square()
        .mean()
        .item<double>();
  };
  EXPECT_FALSE(scene.colours.equal(scene.splatted));
  EXPECT_LT(away(0, 0), away(0, 1));
  EXPECT_LT(away(1, 1), away(1, 0));
  EXPECT_GT(away(0, 0), 0);
  const auto report = nlohmann::json::parse(read_file(folder_.path() / "run/report.json"));
  EXPECT_GT(report.at("encoded_colours_error").at("mean").get<double>(), 0);
  const double error = report.at("latent_error").at("mean").get<double>();
  EXPECT_GT(error, 0);
  EXPECT_LT(error, 1.5);
}

TEST_F(SplatPairs, GoOnBehindTheScenesThatAreThere) {
  quietly([&] { run_splat_pairs(options_); });
  const std::string first = read_file(file(0)), second = read_file(file(1));
  auto tensors = read_all(file(1));
  const auto notes = WeightFile::open(file(1))->metadata();
  tensors.erase("colours");
  save_safetensors(file(1), tensors, notes);
  options_.resume = true;
  EXPECT_THAT(
      error_of([&] { run_splat_pairs(options_); }),
      HasSubstr("expected a tensor colours, found none; delete the file and go on with --resume, or make "
                "all anew with --overwrite."));
  std::filesystem::remove(file(1));
  const auto written = std::filesystem::last_write_time(file(0));
  options_.resume = true;
  quietly([&] { run_splat_pairs(options_); });
  EXPECT_EQ(std::filesystem::last_write_time(file(0)), written);
  EXPECT_EQ(read_file(file(0)), first);
  EXPECT_EQ(read_file(file(1)), second);
}

TEST_F(SplatPairs, OfFoldersKeepToTheRun) {
  SynthOptions rooms;
  rooms.scene.scene_count = 1;
  rooms.scene.frames = 6;
  rooms.scene.width = rooms.scene.height = 64;
  rooms.threads = 1;
  for (const char* name : {"a", "b"}) {
    rooms.out = (folder_.path() / name).string();
    quietly([&] { run_synth(rooms); });
  }
  options_.scenes = {(folder_.path() / "a").string(), (folder_.path() / "b").string()};
  quietly([&] { run_splat_pairs(options_); });
  // One name in both, two files.
  const auto files = splatted_scene_files(folder_.path() / "run" / "pairs");
  ASSERT_EQ(files.size(), 2U);
  EXPECT_EQ(read_splatted_scene(files[0]).name, read_splatted_scene(files[1]).name);
  options_.resume = true;
  options_.held_out = 1;
  EXPECT_THAT(error_of([&] { run_splat_pairs(options_); }), HasSubstr("held_out"));
}

TEST_F(SplatPairs, NeedStatisticsAndOneLevel) {
  std::filesystem::remove(bundle_.file(BundlePart::statistics(0)));
  EXPECT_THAT(error_of([&] { run_splat_pairs(options_); }),
              HasSubstr("expected statistics of level 0, which its latents are normalised by, found none"));
  options_.resume = options_.overwrite = true;
  EXPECT_THAT(error_of([&] { options_.check(); }),
              HasSubstr("--resume, --overwrite: expected one of the two"));
}

TEST_F(SplatPairs, AnEvaluationMeasuresWhatTheRefinerMakes) {
  SplatEvaluationOptions evaluation;
  make_small(evaluation, bundle_, folder_.path() / "eval");
  evaluation.consistency_model = (test::source_root() / "configs" / "tiny").string();
  quietly([&] { run_splat_evaluation(evaluation); });
  const auto with = nlohmann::json::parse(read_file(folder_.path() / "eval/report.json")).at("means");
  for (const char* column : {"refined_psnr", "refined_ssim", "refined_sharpness", "refined_error",
                             "high_band", "refined_high_band", "refined_seconds", "refined_random_features",
                             "refined_met3r_like", "rgb_met3r_like", "encoded_colours_met3r_like",
                             "encoded_colours_high_band", "encoded_colours_sharpness"})
    EXPECT_GT(with.at(column).at("mean").get<double>(), 0) << column;
  // Random weights change latents.
  EXPECT_NE(with.at("refined_error").at("mean"), with.at("latent_error").at("mean"));
  // Where the network says nothing, what was given is what is made.
  evaluation.consistency_model.clear();
  silence_refiner();
  evaluation.out = (folder_.path() / "silent").string();
  quietly([&] { run_splat_evaluation(evaluation); });
  const auto silent = nlohmann::json::parse(read_file(folder_.path() / "silent/report.json")).at("means");
  EXPECT_EQ(silent.at("refined_error"), silent.at("latent_error"));
  EXPECT_EQ(silent.at("refined_psnr"), silent.at("decoded_psnr"));
  test::repair_colours(bundle_);
  evaluation.out = (folder_.path() / "colours").string();
  quietly([&] { run_splat_evaluation(evaluation); });
  const auto colours = nlohmann::json::parse(read_file(folder_.path() / "colours/report.json")).at("means");
  EXPECT_EQ(colours.at("refined_error"), colours.at("encoded_colours_error"));
  EXPECT_EQ(colours.at("refined_psnr"), colours.at("encoded_colours_psnr"));
  EXPECT_NE(colours.at("refined_psnr"), colours.at("decoded_psnr"));
  std::filesystem::remove(bundle_.file(BundlePart::refiner()));
  evaluation.out = (folder_.path() / "without").string();
  quietly([&] { run_splat_evaluation(evaluation); });
  const auto without = nlohmann::json::parse(read_file(folder_.path() / "without/report.json")).at("means");
  EXPECT_FALSE(without.contains("refined_psnr"));
  EXPECT_EQ(without.at("decoded_psnr"), with.at("decoded_psnr"));
}

TEST_F(SplatPairs, RendersShowLatentsAndWhatTheRefinerMakesOfThem) {
  const auto scenes = folder_.path() / "rooms";
  SynthOptions rooms;
  rooms.scene.scene_count = 1;
  rooms.scene.frames = 6;
  rooms.scene.width = rooms.scene.height = 64;
  rooms.threads = 1;
  rooms.out = scenes.string();
  quietly([&] { run_synth(rooms); });
  SplatCommandOptions fit;
  fit.scene = (std::filesystem::directory_iterator(scenes / "scenes"))->path().string();
  fit.out = (folder_.path() / "fit").string();
  fit.side = 64;
  fit.threads = 1;
  fit.fit.steps = 20;
  fit.fit.density.most_gaussians = 2000;
  fit.features = {"0"};
  fit.model = bundle_.folder().string();
  quietly([&] { run_splat_fit_with_features(fit); });
  SplatRenderOptions render;
  render.splats = fit.out;
  render.model = fit.model;
  render.threads = 1;
  render.path.frames = 2;
  const auto picture = [&](SplatShown shown, const char* name) {
    render.show = shown;
    render.out = (folder_.path() / name).string();
    quietly([&] { run_splat_render_with_latents(render); });
    return read_image(std::filesystem::path(render.out) / "images" / (view_name(0, 2) + ".png"));
  };
  const Image colours = picture(SplatShown::kColours, "colours"),
              latents = picture(SplatShown::kLatents, "latents"),
              refined = picture(SplatShown::kRefined, "refined");
  EXPECT_EQ(latents.width, colours.width);
  EXPECT_NE(latents.rgb, colours.rgb);
  EXPECT_NE(refined.rgb, latents.rgb);
  silence_refiner();
  EXPECT_EQ(picture(SplatShown::kRefined, "silent").rgb, latents.rgb);
  test::repair_colours(bundle_);
  const Image repaired = picture(SplatShown::kRefined, "repaired");
  // The colours of the picture, through the autoencoder, whose random layers amplify the rounding to 8 bits.
  const auto encoded = LatentEncoding(bundle_)(tensor_of(splat_image_of(colours)).unsqueeze(0), {0}).front();
  const auto decoded = LatentDecoding(bundle_)({encoded.raw(encoded.pictures.front()).unsqueeze(0)})[0];
  const auto away_from = [&](const torch::Tensor& picture) {
    return (tensor_of(splat_image_of(repaired)) - picture.clamp(0, 1)).abs().mean().item<double>();
  };
  EXPECT_LT(away_from(decoded), 0.03);
  EXPECT_GT(away_from(tensor_of(splat_image_of(latents))), 0.2);

  render.out = (folder_.path() / "no").string();
  std::filesystem::remove(bundle_.file(BundlePart::refiner()));
  EXPECT_THAT(error_of([&] { run_splat_render_with_latents(render); }),
              HasSubstr("expected a refiner with weights, found none; train one with gld train refiner"));

  const auto features = std::filesystem::path(fit.out) / "features.safetensors";
  const auto notes = WeightFile::open(features)->metadata();
  auto tensors = read_all(features);
  const auto error_with = [&](const std::string& name, const torch::Tensor& tensor) {
    auto changed = tensors;
    changed[name] = tensor;
    save_safetensors(features, changed, notes);
    return error_of([&] { run_splat_render_with_latents(render); });
  };
  const auto given = tensors.at("level0.features").clone();
  EXPECT_THAT(error_with("level0.features", given / 0),
              HasSubstr("expected finite numbers in level0.features, found NaN or infinity"));
  EXPECT_THAT(error_with("level0.features", given.slice(0, 1)), HasSubstr("expected features of"));
  EXPECT_THAT(error_with("level0.mean", torch::zeros({2})),
              HasSubstr("expected level0.mean of shape (4), Float, 0 being any, found [2], Float"));
  std::filesystem::remove(features);
  EXPECT_THAT(error_of([&] { run_splat_render_with_latents(render); }),
              HasSubstr("expected features beside the Gaussians, features.safetensors, found none"));
  render.splats += "/splats.ply";
  render.cameras = fit.out;
  EXPECT_THAT(error_of([&] { run_splat_render_with_latents(render); }),
              HasSubstr("--show: expected colours of a file of Gaussians, which has no latents"));
}

}  // namespace
}  // namespace gld
