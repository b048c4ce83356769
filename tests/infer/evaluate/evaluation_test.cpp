#include "infer/evaluate/evaluation.h"

#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/metrics/energy_score.h"
#include "gld/metrics/image_metrics.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/evaluate/scene_evaluation.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/request/scene_request.h"
#include "infer/sample/sampling.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/csv_cells.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/refining_bundle.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::csv_cells;
using testing::HasSubstr;

TEST(EvaluationOptions, SamplesAreDrawnAsGldSampleDrawsThem) {
  const EvaluationOptions options;
  const SampleOptions sample;
  EXPECT_TRUE(same_method(options.sampling_method(), sample.method()));
  EXPECT_GE(options.sampling_method().solver.evaluations, 16);
  EXPECT_EQ(to_json(options.guidance), to_json(sample.guidance));
  EvaluationOptions other;
  other.solver.evaluations = 5;
  EXPECT_EQ(other.sampling_method().solver.evaluations, 5);
}

TEST(EvaluationOptions, RefuseToEvaluateNothing) {
  EvaluationOptions options;
  options.synthetic = 0;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "gld eval: expected scenes, found none; give --scenes DIR or --synthetic N.");
  options.synthetic = 1;
  options.views.most_sources = 4;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "views.most_sources: expected fewer sources than views, found 4; leave at least one target.");
  options.views.most_sources = 2;
  options.lpips.lpips_heads = "heads.pth";
  EXPECT_THAT(test::error_of([&] { options.check(); }), HasSubstr("only the heads"));
}

// One random model and one drawn scene for all tests.
class Evaluation : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TemporaryFolder();
    auto model = small_bundle_options();
    model.trained_sizes = {"56x56"};
    write_random_bundle(folder_->path() / "model", model, 7);
    SyntheticOptions synthetic;
    synthetic.seed = 5;
    synthetic.frames = 6;
    synthetic.width = synthetic.height = 56;
    write_scene(make_synthetic_scene(synthetic, 0), "cameras-json", folder_->path() / "scenes" / "room");
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }

  static EvaluationOptions options(const std::string& run) {
    EvaluationOptions options;
    options.model = (folder_->path() / "model").string();
    options.scenes = {(folder_->path() / "scenes").string()};
    options.synthetic = 0;
    options.solver.evaluations = 4;
    options.views.shortest_interval = options.views.longest_interval = 1;
    options.threads = 1;
    options.seed = 11;
    options.out = (folder_->path() / run).string();
    return options;
  }

  // It runs without progress on the terminal.
  static std::string run(const EvaluationOptions& options) {
    testing::internal::CaptureStderr();
    std::string text = evaluate(options);
    testing::internal::GetCapturedStderr();
    return text;
  }

  static nlohmann::json report(const EvaluationOptions& options) {
    return nlohmann::json::parse(read_file(std::filesystem::path(options.out) / "report.json"));
  }

  static test::TemporaryFolder* folder_;
};
test::TemporaryFolder* Evaluation::folder_ = nullptr;

TEST_F(Evaluation, SamplesAreRefinedByModelsThatCan) {
  auto asked = options("refined");
  asked.refine = true;
  EXPECT_TRUE(asked.sampling_method().refine);
  EXPECT_EQ(test::error_of([&] { evaluate(asked); }),
            "--refine: expected a model with a refiner of samples, found none in " +
                small_bundle_options().name +
                "; train one with gld train sample-refiner, or leave --refine out.");
  EXPECT_FALSE(std::filesystem::exists(asked.out));
  auto model = test::small_refining_bundle_options();
  model.trained_sizes = {"56x56"};
  write_random_bundle(folder_->path() / "refining", model, 7);
  asked.model = (folder_->path() / "refining").string();
  auto plain = asked;
  plain.refine = false;
  plain.out = (folder_->path() / "not_refined").string();
  run(asked);
  run(plain);
  const auto psnr = [&](const EvaluationOptions& of, const char* column) {
    return report(of).at("means").at(column).at("mean").get<double>();
  };
  EXPECT_NE(psnr(asked, "sample_psnr"), psnr(plain, "sample_psnr"));
  EXPECT_EQ(psnr(asked, "mean_prediction_psnr"), psnr(plain, "mean_prediction_psnr"));
  std::filesystem::remove(folder_->path() / "refining/refiner.safetensors");
  asked.out = (folder_->path() / "missing").string();
  EXPECT_THAT(test::error_of([&] { evaluate(asked); }),
              HasSubstr("expected a file refiner.safetensors, found none"));
}

TEST_F(Evaluation, ReportsSamplesAndMeanPredictionSideBySide) {
  const auto asked = options("both");
  const std::string text = run(asked);
  const auto found = report(asked);
  const auto& means = found.at("means");
  const double sample = means.at("sample_psnr").at("mean"),
               mean = means.at("mean_prediction_psnr").at("mean");
  EXPECT_GT(std::abs(sample - mean), 0.01);
  EXPECT_FALSE(means.contains("psnr"));
  for (const char* name : {"sample_ssim", "sample_sharpness", "mean_prediction_sharpness",
                           "psnr_nearest_source", "reconstruction_psnr", "depth_abs_rel_median_scaled"}) {
    EXPECT_EQ(means.at(name).at("scenes"), 1) << name;
  }
  // Absent, with the reason, and not 0.
  const auto& lpips = means.at("sample_lpips");
  EXPECT_TRUE(lpips.at("mean").is_null());
  EXPECT_EQ(lpips.at("absent").at("no LPIPS weights were given (--lpips-backbone, --lpips-heads)"), 1);
  EXPECT_THAT(text, HasSubstr("lpips: absent in 1 of 1 scenes"));
  EXPECT_THAT(found.at("methods").at("sample").at("method").get<std::string>(), HasSubstr("4 evaluations"));
  EXPECT_TRUE(std::filesystem::exists(std::filesystem::path(asked.out) / "sheets" / "room.png"));
}

TEST_F(Evaluation, SolverAndGuidanceAreTheSamplesAlone) {
  auto asked = options("one_evaluation");
  asked.solver.evaluations = 1;
  asked.guidance.guidance_scale = 1;
  run(asked);
  const auto one = report(asked).at("means");
  // A sample of one evaluation without guidance is the prediction of the mean.
  EXPECT_EQ(one.at("sample_psnr").at("mean"), one.at("mean_prediction_psnr").at("mean"));
  asked = options("guided");
  asked.guidance.guidance_scale = 3;
  run(asked);
  const auto guided = report(asked).at("means");
  EXPECT_NE(guided.at("sample_psnr").at("mean"), one.at("sample_psnr").at("mean"));
  EXPECT_EQ(guided.at("mean_prediction_psnr").at("mean"), one.at("mean_prediction_psnr").at("mean"));
}

// The same scene, views and noise go through `gld sample`: they give the same latents to the bit, the same depth scale,
// and the same PSNR up to the eight bits of a picture.
TEST_F(Evaluation, SamplesAreThoseOfGldSample) {
  const auto asked = options("as_sampled");
  const auto bundle = ModelBundle::open(asked.model);
  const Scene found = open_scene(folder_->path() / "scenes" / "room");
  const SampleKey key = held_out_key(asked.synthetic_seed, 0);
  const SamplingScene scene = load_held_out_scene(found, asked.views, key, bundle.options());
  EvaluationModels models;
  models.bundle = bundle.options();
  models.models = kept_bundle_models(bundle, torch::kCPU);
  const FlowSettings settings = flow_settings(asked.sampling_method(), asked.guidance, bundle.options());
  const EvaluatedScene evaluated = evaluate_scene(models, scene, settings, {asked.seed});

  const SampledViews views = held_out_sample(found, asked.views, key);
  SampleOptions sampled;
  sampled.model = asked.model;
  sampled.scene = (folder_->path() / "scenes" / "room").string();
  sampled.views.sources.assign(views.frames.begin(), views.frames.begin() + views.num_sources);
  sampled.views.targets.assign(views.frames.begin() + views.num_sources, views.frames.end());
  sampled.solver.evaluations = asked.solver.evaluations;
  sampled.outputs = {"image", "depth", "points", "latents"};
  sampled.seed = asked.seed;
  sampled.threads = 1;
  sampled.out = (folder_->path() / "sampled").string();
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  sample(sampled);
  testing::internal::GetCapturedStdout();
  testing::internal::GetCapturedStderr();
  const std::filesystem::path out = sampled.out;
  const auto latents = read_all(*WeightFile::open((out / "latents.safetensors").string()));
  EXPECT_TRUE(torch::equal(latents.at("level0"), evaluated.sample.latents.at(0)));
  EXPECT_TRUE(torch::equal(latents.at("level1"), evaluated.sample.latents.at(1)));
  EXPECT_FALSE(torch::equal(latents.at("level1"), evaluated.mean_prediction.latents.at(1)));
  const auto written = nlohmann::json::parse(read_file(out / "report.json"));
  double psnr = 0;
  for (const auto& view : written.at("against_truth")) psnr += view.at("psnr").get<double>() / 2;
  EXPECT_NEAR(evaluated.evaluation.number("sample_psnr").value, psnr, 0.01);
  // Depth without scaling is there exactly where gld sample knows the scale.
  const bool scale_known = written.contains("depth_scale");
  EXPECT_EQ(evaluated.evaluation.number("depth_abs_rel_unscaled").absent.empty(), scale_known);
}

// Two generated scenes of a random model.
class EvaluationProtocol : public Evaluation {
 protected:
  static EvaluationOptions rooms(const std::string& run) {
    EvaluationOptions asked = options(run);
    asked.scenes.clear();
    asked.synthetic = 2;
    asked.generator.frames = 8;
    asked.generator.width = asked.generator.height = 56;
    asked.solver.evaluations = 2;
    return asked;
  }
  static std::string file(const EvaluationOptions& options, const std::string& name) {
    return read_file(std::filesystem::path(options.out) / name);
  }
};

TEST_F(EvaluationProtocol, ResumeGoesOnWithTheNextScene) {
  auto killed = rooms("killed");
  run(killed);
  const std::string csv = file(killed, "eval.csv"), targets = file(killed, "targets.csv");
  EXPECT_EQ(std::count(targets.begin(), targets.end(), '\n'), 1 + 2 * 2);
  // As a killed run leaves it: the first scene is there.
  const std::filesystem::path out = killed.out;
  for (const char* name : {"eval.csv", "targets.csv", "report.json", "scenes/000001.json"}) {
    ASSERT_TRUE(std::filesystem::remove(out / name)) << name;
  }
  const auto kept = out / "scenes" / "000000.json";
  const auto written = std::filesystem::last_write_time(kept);
  killed.resume = true;
  run(killed);
  EXPECT_EQ(file(killed, "eval.csv"), csv);
  EXPECT_EQ(std::filesystem::last_write_time(kept), written);  // not measured again
  // A damaged record is, whether that shows by itself or not.
  const std::string text = read_file(kept);
  std::string other = text;
  other.replace(other.find("\"samples\": ") + 11, 1, "9");
  ASSERT_NE(other, text);
  for (const std::string& damaged : {other, text.substr(0, text.size() / 2), std::string("[1]")}) {
    write_file_atomically(kept, damaged);
    run(killed);
    EXPECT_EQ(file(killed, "eval.csv"), csv);
    EXPECT_EQ(read_file(kept), text);
  }
  // Another option would make other numbers.
  killed.seed = 12;
  EXPECT_EQ(
      test::error_of([&] { evaluate(killed); }),
      "--resume: expected the options of the run, which has seed 11, found 12; leave it as it was, or begin again "
      "with --overwrite.");
  killed.overwrite = true;
  EXPECT_THAT(test::error_of([&] { killed.check(); }), HasSubstr("--resume, --overwrite"));
}

TEST_F(EvaluationProtocol, NumbersAreMeansOverSamplesAndTargets) {
  auto asked = rooms("samples");
  asked.synthetic = 1;
  asked.samples = 2;
  asked.poses = PoseEstimator::kNone;
  run(asked);
  std::istringstream text(file(asked, "targets.csv"));
  std::string line;
  std::getline(text, line);
  const auto header = csv_cells(line);
  const auto column =
      static_cast<size_t>(std::find(header.begin(), header.end(), "sample_psnr") - header.begin());
  double sum = 0;
  std::vector<double> values;
  while (std::getline(text, line)) values.push_back(std::stod(csv_cells(line)[column]));
  ASSERT_EQ(values.size(), 4U);  // 2 samples, 2 targets
  for (const double value : values) sum += value / 4;
  EXPECT_NE(values[0], values[2]);
  const auto means = report(asked).at("means");
  EXPECT_NEAR(means.at("sample_psnr").at("mean").get<double>(), sum, 1e-5);
  EXPECT_EQ(means.at("ate").at("absent").at("no poses were asked for (--poses none)"), 1);
  EXPECT_TRUE(means.at("ate").at("mean").is_null());
}

// Of all samples together; of what is predicted without chance the distance.
TEST_F(EvaluationProtocol, EnergyScoresAreOfAllSamplesTogether) {
  auto asked = rooms("energy");
  asked.synthetic = 1;
  asked.samples = 3;
  asked.pictures = 0;
  asked.poses = PoseEstimator::kNone;
  run(asked);
  const auto found = report(asked);
  const auto mean = [&](const std::string& name) {
    return found.at("means").at(name).at("mean").get<double>();
  };

  const auto bundle = ModelBundle::open(asked.model);
  const auto dataset = held_out_dataset({}, asked.generator, asked.synthetic_seed, 1);
  const SamplingScene scene = load_held_out_scene(dataset->scene(0), asked.views,
                                                  held_out_key(asked.synthetic_seed, 0), bundle.options());
  EvaluationModels models;
  models.bundle = bundle.options();
  models.models = kept_bundle_models(bundle, torch::kCPU);
  models.photographs = photograph_use_of(asked.photograph_use, bundle);
  const FlowSettings settings = flow_settings(asked.sampling_method(), asked.guidance, bundle.options());
  std::vector<torch::Tensor> samples;
  std::vector<double> distances;
  for (const int64_t seed : {11, 1'000'011, 2'000'011}) {
    const EvaluatedScene one = evaluate_scene(models, scene, settings, {seed});
    samples.push_back(one.sample.images);
    // Of one sample it is its distance, which its PSNR is too.
    distances.push_back(one.evaluation.number("sample_energy_score").value);
  }
  const auto truth = stacked(scene.true_images);
  EXPECT_NEAR(mean("sample_energy_score"), energy_score(truth, torch::stack(samples)).mean().item<double>(),
              1e-9);
  EXPECT_NEAR(mean("sample_energy_score_features"),
              energy_score_of_features(truth, torch::stack(samples)).mean().item<double>(), 1e-9);
  EXPECT_LT(mean("sample_energy_score"), (distances[0] + distances[1] + distances[2]) / 3);
  EXPECT_EQ(found.at("energy_score").at("samples"), 3);
  const auto colours = stacked(scene.source_images).mean({0, 2, 3}, true).expand_as(truth);
  EXPECT_NEAR(mean("energy_score_mean_color"),
              torch::pow(10.0, psnr(truth, colours) / -20).mean().item<double>(), 1e-6);
  // One row a target, in those of the first sample.
  std::istringstream text(file(asked, "targets.csv"));
  std::string line;
  std::getline(text, line);
  const auto header = csv_cells(line);
  const auto column =
      static_cast<size_t>(std::find(header.begin(), header.end(), "sample_energy_score") - header.begin());
  ASSERT_LT(column, header.size());
  std::vector<bool> filled;
  while (std::getline(text, line)) filled.push_back(!csv_cells(line).at(column).empty());
  EXPECT_EQ(filled, (std::vector<bool>{true, true, false, false, false, false}));
}

// What the decoder alone makes of the pictures that a generated part has to beat.
TEST_F(EvaluationProtocol, TheFillGoesThroughTheDecoder) {
  auto asked = rooms("through_decoder");
  // Photographs are matched without the head, which a random model has no use for.
  asked.photograph_use.source_depth = PhotographOptions::DepthChoice::kStereo;
  asked.pictures = 0;
  run(asked);
  const auto means = report(asked).at("means");
  const auto& fill = means.at("fill_psnr");
  const auto& reconstructed = means.at("reconstructed_fill_psnr");
  EXPECT_EQ(fill.at("scenes"), reconstructed.at("scenes"));
  EXPECT_EQ(fill.value("absent", nlohmann::json()), reconstructed.value("absent", nlohmann::json()));
  // Without depth that photographs agree on both are absent, and so is every pixel that they show.
  const bool carried = fill.at("scenes").get<int64_t>() > 0;
  if (carried) {
    EXPECT_NE(fill.at("mean"), reconstructed.at("mean"));
  }
  for (const char* metric : {"psnr_seen", "energy_score_seen", "energy_score_features_seen"}) {
    for (const char* predictor : {"sample_", "fill_", "reconstructed_fill_"}) {
      const auto& column = means.at(std::string(predictor) + metric);
      EXPECT_EQ(column.at("scenes").get<int64_t>() > 0, carried) << predictor << metric;
    }
  }
  // One source's depth has no unit that its photograph tells: nothing is carried and nothing decoded.
  asked.views.views = 3;
  asked.source_counts = {1};
  asked.views.most_sources = 1;
  asked.overwrite = true;
  run(asked);
  const auto of_one = report(asked).at("means");
  EXPECT_EQ(of_one.at("reconstructed_fill_psnr").at("scenes"), 0);
  EXPECT_EQ(of_one.at("reconstructed_fill_psnr").at("absent"), of_one.at("fill_psnr").at("absent"));
}

TEST_F(EvaluationProtocol, ScenesOfOneNameAreToldApart) {
  SyntheticOptions generator;
  generator.frames = 8;
  generator.width = generator.height = 56;
  for (const int64_t number : {0, 1}) {
    write_scene(make_synthetic_scene(generator, number), "cameras-json",
                folder_->path() / "twins" / std::to_string(number) / "room");
  }
  auto asked = rooms("twins_evaluated");
  asked.synthetic = 0;
  asked.scenes = {(folder_->path() / "twins").string()};
  run(asked);
  const std::string csv = file(asked, "eval.csv");
  EXPECT_THAT(csv, HasSubstr("\nroom,"));
  EXPECT_THAT(csv, HasSubstr("\nroom_2,"));
  EXPECT_THAT(file(asked, "targets.csv"), HasSubstr("\nroom_2,"));
}

TEST_F(EvaluationProtocol, EveryNumberOfSourcesIsReported) {
  auto asked = rooms("counts");
  asked.views.views = 5;
  asked.source_counts = {2, 1};
  asked.poses = PoseEstimator::kDa3;
  const std::string text = run(asked);
  const auto found = report(asked);
  EXPECT_EQ(found.at("by_sources").at("1").at("scenes"), 2);
  EXPECT_EQ(found.at("means"), found.at("by_sources").at("2").at("means"));
  EXPECT_THAT(text, HasSubstr("## 1 sources"));
  const std::string csv = file(asked, "eval.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 5);
  EXPECT_EQ(found.at("protocol").at("poses"), "da3");
  // Every scene has these, whatever the sources.
  for (const char* name : {"pck_level0", "pck_level3", "pseudo_depth_abs_rel", "met3r_like_true_geometry",
                           "reconstruction_level0_psnr"}) {
    EXPECT_EQ(found.at("means").at(name).at("scenes"), 2) << name;
  }
  EXPECT_TRUE(std::filesystem::exists(std::filesystem::path(asked.out) / "plots" / "psnr.png"));
}

// A cascade is also asked what it makes of the true deeper level, M1, which is given no deeper level, is not.
TEST_F(EvaluationProtocol, LatentsAreComparedLevelByLevel) {
  auto asked = rooms("latents");
  asked.model = (test::source_root() / "configs" / "tiny").string();
  asked.generator.width = asked.generator.height = 112;
  asked.synthetic = 1;
  asked.poses = PoseEstimator::kNone;
  asked.photograph_use.generate_complete = true;
  run(asked);
  const auto means = report(asked).at("means");
  const auto mean = [&](const std::string& name) { return means.at(name).at("mean").get<double>(); };
  for (const char* of : {"sample", "mean_prediction"}) {
    for (const char* level : {"0", "1"}) {
      const double error = mean(std::string(of) + "_latent_error_level" + level);
      EXPECT_TRUE(error > 0.1 && error < 1.2) << of << level << ' ' << error;
    }
  }
  EXPECT_GT(mean("from_true_levels_latent_error_level0"), 0.05);
  EXPECT_NE(mean("from_true_levels_latent_error_level0"), mean("mean_prediction_latent_error_level0"));
  const auto why = [&](const char* name) { return means.at(name).at("absent").items().begin().key(); };
  EXPECT_EQ(why("from_true_levels_latent_error_level1"), "level 1 is not predicted");
  EXPECT_EQ(why("sample_latent_error_level2"), "level 2 is not predicted");
}

TEST_F(EvaluationProtocol, QueriesAndKeysOfEveryBlockAreMatched) {
  auto asked = rooms("attention");
  asked.attention_times = {0.9, 0.5};
  run(asked);
  const auto model = small_bundle_options();
  int64_t blocks = 0;
  for (const auto& part : model.generators) blocks += part.dit.encoder_blocks() + part.dit.decoder_blocks();
  std::istringstream text(file(asked, "attention_pck.csv"));
  std::string line;
  std::getline(text, line);
  EXPECT_EQ(line, "stage,block,part,time,pck,low_95,high_95,scenes");
  int64_t rows = 0;
  while (std::getline(text, line)) {
    const auto row = csv_cells(line);
    EXPECT_EQ(row.at(7), "2") << line;
    EXPECT_GE(std::stod(row.at(4)), 0) << line;
    EXPECT_LE(std::stod(row.at(4)), 100) << line;
    ++rows;
  }
  EXPECT_EQ(rows, 2 * blocks);
}

// Its images can be measured all the same.
TEST_F(EvaluationProtocol, AModelWithoutACameraHeadHasNoGeometry) {
  BundleOptions blind;
  load_yaml(blind, test::source_root() / "configs/ablations/latents/vggt/model.yaml");
  apply_setting(blind, "dpt_head.camera_head=false");
  auto asked = rooms("no_camera_head");
  asked.model = (folder_->path() / "no_camera_head_model").string();
  write_random_bundle(asked.model, blind, 7);
  asked.generator.width = asked.generator.height = 112;
  asked.solver.evaluations = 1;
  run(asked);
  EXPECT_EQ(report(asked).at("means").at("sample_psnr").at("scenes"), 2);
  EXPECT_THAT(report(asked).dump(), HasSubstr("the model has no geometry head that sees cameras"));
  asked.pose_model = asked.model;
  asked.overwrite = true;
  EXPECT_EQ(test::error_of([&] { evaluate(asked); }),
            "--pose-model: expected a bundle with a geometry head that sees cameras, found " + asked.model +
                ", which has none; choose a DA3 or VGGT model.");
}

TEST_F(EvaluationProtocol, VggtsPosesNeedItsCameraHead) {
  auto asked = rooms("vggt");
  asked.poses = PoseEstimator::kVggt;
  EXPECT_THAT(test::error_of([&] { evaluate(asked); }),
              HasSubstr("--poses vggt: expected a model with VGGT's camera head"));
}

}  // namespace
}  // namespace gld
