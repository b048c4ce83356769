// This takes every latent space of configs/ablations/latents from nothing to samples and their evaluation, with two
// steps a stage.
#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/tensors/torch_version.h"
#include "infer/evaluate/evaluation.h"
#include "infer/forecast/doctor.h"
#include "infer/forecast/machine_rates.h"
#include "infer/sample/sampling.h"
#include "models/bundle/bundle.h"
#include "models/bundle/inspection.h"
#include "models/bundle/random_bundle.h"
#include "models/cost/cost_model.h"
#include "models/weights/weight_loading.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/stages/feature_stages.h"
#include "train/stages/latent_stages.h"

#include <cstdlib>
#include <memory>
#include <string>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using testing::HasSubstr;

std::filesystem::path description(const std::string& latent) {
  return test::source_root() / "configs/ablations/latents" / latent / "model.yaml";
}

// The geometric ones with level 0 generated, so that their heads have all levels; VGGT with its camera and register
// tokens generated beside the patches, as the release has it.
const std::string kWholeDa3 = "da3_whole", kJoint = "vggt_joint";

BundleOptions described(const std::string& latent) {
  BundleOptions options;
  load_yaml(options, description(latent.substr(0, latent.find('_'))));
  if (latent == kWholeDa3 || latent == kJoint) {
    options.generators.front().generator = level_model(0);
    options.boundary_level = 0;
    options.decoded_levels.clear();
    options.rgb_decoder.in_channels = 4 * options.backbone.level_channels();
  }
  if (latent == kJoint) {
    DitOptions& dit = options.generators.front().dit;
    dit.num_special_tokens = options.backbone.leading_tokens();
    dit.hidden_size = {160, 128};
  }
  check_options(options, latent);
  return options;
}

class LatentSpaces : public testing::TestWithParam<std::string> {
 protected:
  // The machine's rates, which the doctor would measure for half a minute, are made up: how long its forecast says that
  // a stage takes is not what this is about.
  static void SetUpTestSuite() {
    cache_ = std::make_unique<test::TemporaryFolder>();
    ::setenv("XDG_CACHE_HOME", cache_->path().c_str(), 1);
    MeasuredSpeed measured;
    MachineSpeed& speed = measured.speed;
    speed.multiply_add_peak = speed.matrix_product = speed.linear = speed.attention = speed.loading = 1e11;
    set_thread_count(1);
    keep_machine_speed(machine_rates_file(), present_rate_key(), measured);
  }
  static void TearDownTestSuite() { cache_.reset(); }

  template <class Options>
  Options stage(const std::string& model, const std::string& out) const {
    Options options;
    options.model = path(model).string();
    options.out = path(out).string();
    options.threads = 1;
    options.data = test::small_data();
    options.data.synthetic.width = options.data.synthetic.height = 112;
    options.loop = test::two_steps();
    options.data.validation_scenes = 1;
    options.loop.micro_batches = 1;
    options.loop.validate_every = 2;
    return options;
  }
  std::filesystem::path path(const std::string& name) const { return folder_.path() / name; }

  static inline std::unique_ptr<test::TemporaryFolder> cache_;
  test::TemporaryFolder folder_;
};

TEST_P(LatentSpaces, TrainsSamplesAndEvaluates) {
  const BundleOptions model = described(GetParam());
  const bool geometry = model.has_geometry();
  const bool vggt = geometry && model.backbone.architecture().kind() == "vggt";
  save_bundle_options(path("empty"), model);
  auto backbone = stage<TrainBackboneOptions>("empty", "backbone");
  backbone.objective.pixel_weights = {1.0};
  train_backbone(backbone, {});
  std::string newest = "backbone/model";
  if (model.has_rgb_decoder()) {
    auto decoder = stage<TrainDecoderOptions>(newest, "decoder");
    decoder.objective.adversarial.convolutional.channels = 8;
    train_decoder(decoder, {});
    newest = "decoder/model";
  } else {
    EXPECT_EQ(test::error_of([&] { train_decoder(stage<TrainDecoderOptions>(newest, "decoder"), {}); }),
              "train decoder: expected a model with an RGB decoder, found one whose backbone decodes images "
              "itself; train both halves with gld train backbone.");
  }
  StatsOptions stats;
  stats.model = path(newest).string();
  stats.out = path("stats").string();
  stats.threads = 1;
  stats.scene_count = 3;
  stats.data = test::small_data();
  stats.data.synthetic.width = stats.data.synthetic.height = 112;
  compute_statistics(stats);
  auto level = stage<TrainLevelOptions>("stats/model", "level");
  level.level = model.level_set().boundary;
  train_level(level, {});
  const auto bundle = ModelBundle::open(path("level/model"));
  for (const BundlePart& part : bundle_parts(bundle.options()))
    EXPECT_TRUE(bundle.has(part)) << bundle_part_name(part);
  EXPECT_EQ(inspect(path("level/model"))["missing"].size(), 0U);

  SyntheticOptions synthetic;
  synthetic.frames = 4;
  synthetic.width = synthetic.height = 112;
  write_scene(make_synthetic_scene(synthetic, 0), "cameras-json", path("scene"));
  SampleOptions asked;
  asked.model = path("level/model").string();
  asked.scene = path("scene").string();
  asked.views.sources = {0, 3};
  asked.views.targets = {1, 2};
  asked.solver.evaluations = 2;
  asked.threads = 1;
  asked.out = path("sample").string();
  if (!geometry) {
    EXPECT_EQ(
        test::error_of([&] { sample(asked); }),
        std::string("--outputs: expected image or latents of a model ") +
            (model.geometry_head.exists() ? "that does not generate all levels, which its geometry head takes"
                                          : "without a geometry head") +
            ", found depth, rays or points of " + asked.model +
            "; add --outputs image, or --geometry-model DIR to have a geometry model look at the "
            "generated images.");
    write_random_bundle(path("geometry"), small_bundle_options(), 3);
    asked.geometry_model = path("geometry").string();
  }
  asked.outputs = {"image", "depth", "rays", "points"};
  asked.points.lifting = PointLifting::kPointMaps;
  if (!vggt) {
    EXPECT_EQ(
        test::error_of([&] { sample(asked); }),
        fmt::format("--points.lifting: expected cameras or rays of a model whose head predicts no points, "
                    "found point_maps of {}; choose another, or --geometry-model DIR with a head that does "
                    "(VGGT's).",
                    ModelBundle::open(geometry ? asked.model : asked.geometry_model).options().name));
    asked.points.lifting = PointLifting::kCameras;
  }
  testing::internal::CaptureStdout();
  sample(asked);
  testing::internal::GetCapturedStdout();
  const auto report = nlohmann::json::parse(read_file(path("sample/report.json")));
  EXPECT_THAT(sampling_plan_report(asked, PlanTiming::kPredicted).text, HasSubstr("RGB decoding"));
  EXPECT_EQ(report.contains("geometry"), !geometry);
  if (vggt) {
    EXPECT_EQ(report["points"]["lifted_by"], "point_maps");
  }
  if (!geometry) {
    EXPECT_EQ(report["geometry"]["from"], "the generated images");
  }
  for (const char* file : {"images/view_02.png", "depth/view_03.pfm", "rays/view_02.npz", "points.ply"}) {
    EXPECT_TRUE(std::filesystem::exists(path("sample") / file)) << file;
  }

  if (!geometry) {
    // The images are decoded for the geometry model, whoever asked for them.
    asked.outputs = {"depth"};
    asked.out = path("depth_alone").string();
    testing::internal::CaptureStdout();
    sample(asked);
    testing::internal::GetCapturedStdout();
    EXPECT_TRUE(std::filesystem::exists(path("depth_alone/depth/view_03.pfm")));
  }

  EXPECT_EQ(std::filesystem::exists(path("sample/rays/point_maps.safetensors")), vggt);

  EvaluationOptions evaluation;
  evaluation.model = asked.model;
  evaluation.out = path("eval").string();
  evaluation.synthetic = 2;
  evaluation.pictures = 0;
  evaluation.solver.evaluations = 2;
  evaluation.threads = 1;
  evaluate(evaluation);
  const auto evaluated = nlohmann::json::parse(read_file(path("eval/report.json")));
  EXPECT_EQ(evaluated["means"]["sample_psnr"]["scenes"], 2);
  EXPECT_EQ(evaluated["protocol"]["poses_from"],
            geometry ? "the model's own geometry head"
            : model.geometry_head.exists()
                ? "nothing: the model does not generate all levels, which its geometry head takes"
                : "nothing: the model has no geometry head that sees cameras");

  DoctorOptions doctor;
  doctor.model = asked.model;
  doctor.size = "112x112";
  doctor.threads = 1;
  EXPECT_THAT(doctor_report(doctor).text, HasSubstr("RGB decoding"));
}

INSTANTIATE_TEST_SUITE_P(Miniatures, LatentSpaces,
                         testing::Values("da3", kWholeDa3, "vggt", kJoint, "dinov2", "vae", "taef2"));

TEST(LatentSpaceConfigurations, HaveEqualDits) {
  const BundleOptions first = described("da3");
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  const auto parameters = [&](const BundleOptions& options) {
    int64_t count = 0;
    for (const auto& item : named_tensors(DitDh(options.generators.front().dit, meta)))
      count += item.second.numel();
    return count;
  };
  for (const char* latent : {"vggt", "dinov2", "vae", "taef2"}) {
    const BundleOptions options = described(latent);
    EXPECT_EQ(options.generators.size(), first.generators.size()) << latent;
    EXPECT_EQ(parameters(options), parameters(first)) << latent;
    const auto grid = options.backbone.grid_of(4, 112, 112);
    EXPECT_EQ(dit_cost(options.generators.front().dit, grid).flop(),
              dit_cost(first.generators.front().dit, first.backbone.grid_of(4, 112, 112)).flop())
        << latent;
  }
}

TEST(LatentSpaceConfigurations, RefuseADitOfOtherChannels) {
  BundleOptions options = described("vae");
  apply_setting(options, "backbone.latent_channels=4");
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "level0.in_channels: expected 16, the channels of the backbone's levels, found 128; change one of "
      "them.");
}

}  // namespace
}  // namespace gld
