#include "infer/evaluate/evaluation.h"

#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/metrics/metric_list.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/evaluate/evaluation_report.h"
#include "infer/evaluate/scene_evaluation.h"
#include "infer/evaluate/scene_record.h"
#include "infer/pipeline/bundle_models.h"
#include "infer/sample/sampling.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using testing::HasSubstr;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// A scene whose columns have these values; the others are absent.
SceneEvaluation scene_with(const std::string& name, const std::map<std::string, double>& values) {
  SceneEvaluation scene;
  scene.scene = name;
  for (const EvaluationColumn& column : evaluation_columns()) {
    const auto found = values.find(column.name);
    scene.numbers.push_back(found == values.end() ? SceneNumber{kNaN, "it was not measured"}
                                                  : SceneNumber{found->second, ""});
  }
  return scene;
}

SceneEvaluation scene(const std::string& name, double sample_psnr) {
  return scene_with(name, {{"sample_psnr", sample_psnr},
                           {"mean_prediction_psnr", 21.0},
                           {"psnr_nearest_source", 14.0},
                           {"psnr_mean_source", 15.5},
                           {"psnr_mean_color", 19.0},
                           {"sample_sharpness", 0.5}});
}

std::vector<std::string> cells(const std::string& line) {
  std::vector<std::string> result;
  std::istringstream text(line + ",");
  for (std::string cell; std::getline(text, cell, ',');) result.push_back(cell);
  return result;
}

TEST(EvaluationReport, HasBothPredictionsOfEveryMetricOfImages) {
  std::vector<std::string> names;
  for (const EvaluationColumn& column : evaluation_columns()) names.push_back(column.name);
  for (const Metric& metric : image_metric_list()) {
    for (const std::string& name : {"sample_" + metric.name, "mean_prediction_" + metric.name,
                                    metric.name + "_nearest_source", "reconstruction_" + metric.name}) {
      EXPECT_THAT(names, testing::Contains(name));
    }
  }
  for (const char* name :
       {"psnr_mean_source", "psnr_mean_color", "depth_abs_rel_unscaled", "rotation_error"}) {
    EXPECT_THAT(names, testing::Contains(name));
  }
  EXPECT_THAT(names, testing::Not(testing::Contains("psnr")));
}

TEST(EvaluationReport, TheTableLeavesAbsentNumbersEmpty) {
  auto first = scene("room_1", 18.25);
  const std::string csv = evaluation_csv({first});
  std::istringstream text(csv);
  std::string header, row;
  std::getline(text, header);
  std::getline(text, row);
  const auto names = cells(header), values = cells(row);
  ASSERT_EQ(values.size(), names.size());
  std::map<std::string, std::string> by_name;
  for (size_t i = 0; i < names.size(); ++i) by_name[names[i]] = values[i];
  EXPECT_EQ(by_name.at("scene"), "room_1");
  EXPECT_EQ(by_name.at("sample_psnr"), "18.250000");
  EXPECT_EQ(by_name.at("mean_prediction_psnr"), "21.000000");
  EXPECT_EQ(by_name.at("depth_abs_rel_unscaled"), "");
  EXPECT_EQ(by_name.at("sample_beats_mean_source"), "1");
  EXPECT_EQ(by_name.at("sample_beats_mean_color"), "0");
}

TEST(EvaluationReport, CountsWhereSamplesBeatTheTrivialPredictors) {
  const auto summary = evaluation_summary({scene("a", 18.0), scene("b", 20.0), scene("c", 13.0)});
  EXPECT_EQ(summary.at("better_than_every_trivial"), 1);
  EXPECT_EQ(summary.at("sample_beats").at("nearest_source"), 2);
  EXPECT_EQ(summary.at("sample_beats").at("mean_source"), 2);
  EXPECT_EQ(summary.at("sample_beats").at("mean_color"), 1);
  EXPECT_EQ(summary.at("best_trivial_predictor"), "psnr_mean_color");
  EXPECT_NEAR(summary.at("sample_margin_over_best_trivial_db").get<double>(), 17 - 19, 1e-12);
  EXPECT_NEAR(summary.at("mean_prediction_margin_over_best_trivial_db").get<double>(), 2, 1e-12);
  EXPECT_THAT(evaluation_text(summary), HasSubstr("better than every trivial predictor in 1 of 3 scenes"));
}

TEST(EvaluationReport, AMeanSaysWhatItIsOf) {
  auto perfect = scene("b", std::numeric_limits<double>::infinity());
  const auto summary = evaluation_summary({scene("a", 18.0), perfect, scene("c", 20.0)});
  const auto& psnr = summary.at("means").at("sample_psnr");
  EXPECT_NEAR(psnr.at("mean").get<double>(), 19.0, 1e-12);
  EXPECT_NEAR(psnr.at("deviation").get<double>(), 1, 1e-12);
  EXPECT_EQ(psnr.at("scenes"), 2);
  EXPECT_EQ(psnr.at("infinite"), 1);
  EXPECT_EQ(psnr.at("unit"), "dB");
  EXPECT_EQ(psnr.at("better"), "higher");
  const auto& depth = summary.at("means").at("depth_abs_rel_unscaled");
  EXPECT_TRUE(depth.at("mean").is_null());
  EXPECT_EQ(depth.at("scenes"), 0);
  EXPECT_EQ(depth.at("absent").at("it was not measured"), 3);
  EXPECT_THAT(evaluation_text(summary), HasSubstr("absent in 3 of 3 scenes, it was not measured"));
}

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

TEST(EvaluationReport, AnIntervalIsDrawnOverScenesAndAbsentForOne) {
  const auto three = evaluation_summary({scene("a", 18.0), scene("b", 19.0), scene("c", 23.0)}).at("means");
  const auto& interval = three.at("sample_psnr").at("interval_95");
  EXPECT_GE(interval.at(0).get<double>(), 18);
  EXPECT_LT(interval.at(0).get<double>(), 20);
  EXPECT_GT(interval.at(1).get<double>(), 20);
  EXPECT_LE(interval.at(1).get<double>(), 23);
  EXPECT_FALSE(three.at("sample_psnr").contains("confidence_95"));  // one interval
  EXPECT_TRUE(
      evaluation_summary({scene("a", 18.0)}).at("means").at("sample_psnr").at("interval_95").at(0).is_null());
}

TEST(EvaluationReport, ARowATargetLeavesOutWhatIsOfTheScene) {
  auto measured = scene("a, \"b\"", 18.0);
  measured.samples = 2;
  measured.sources = {"f0"};
  measured.targets = {"f1", "f2"};
  const auto& columns = evaluation_columns();
  for (size_t i = 0; i < columns.size(); ++i) {
    if (columns[i].name == "sample_psnr") measured.numbers[i].of_targets = {{17, kNaN}, {18, 19}};
    if (columns[i].name == "mean_prediction_psnr") measured.numbers[i].of_targets = {{20, 21}};
  }
  EXPECT_EQ(targets_csv({measured}),
            "scene,sources,sample,target,sample_psnr,mean_prediction_psnr\n"
            "\"a, \"\"b\"\"\",1,0,f1,17.000000,20.000000\n"
            "\"a, \"\"b\"\"\",1,0,f2,,21.000000\n"
            "\"a, \"\"b\"\"\",1,1,f1,18.000000,\n"
            "\"a, \"\"b\"\"\",1,1,f2,19.000000,\n");
}

TEST(EvaluationReport, PicturesAreOfMetricsThatSeveralScenesHave) {
  std::vector<std::string> names;
  for (const auto& picture : metric_pictures({scene("a", 18.0), scene("b", 19.0)}))
    names.push_back(picture.name);
  EXPECT_THAT(names, testing::Contains("psnr"));
  EXPECT_THAT(names, testing::Not(testing::Contains("ate")));  // absent in both
  EXPECT_TRUE(metric_pictures({scene("a", 18.0)}).empty());
}

TEST(SceneRecord, ReadsBackEqual) {
  auto measured = scene("a", std::numeric_limits<double>::infinity());
  measured.samples = 3;
  measured.sources = {"f0", "f9"};
  measured.targets = {"f1"};
  measured.numbers[0].of_targets = {{1.0 / 3}, {kNaN}, {-std::numeric_limits<double>::infinity()}};
  measured.numbers[0].absent_samples = 1;
  const auto text = scene_record(measured).dump();
  const auto found = scene_from_record(nlohmann::json::parse(text), "here");
  EXPECT_EQ(scene_record(found).dump(), text);
  EXPECT_EQ(found.number("sample_psnr").value, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(std::isnan(found.number("ate").value));
  EXPECT_EQ(found.number("ate").absent, "it was not measured");
  EXPECT_THAT(test::error_of([] { scene_from_record(nlohmann::json::parse("{}"), "scenes/0.json"); }),
              HasSubstr("scenes/0.json: expected a scene that gld eval has measured"));
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

  // Without progress on the terminal.
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

// The same scene, views and noise through `gld sample`: the same latents to the bit, the same depth scale, and the same
// PSNR up to the eight bits of a picture.
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
  const auto header = cells(line);
  const auto column =
      static_cast<size_t>(std::find(header.begin(), header.end(), "sample_psnr") - header.begin());
  double sum = 0;
  std::vector<double> values;
  while (std::getline(text, line)) values.push_back(std::stod(cells(line)[column]));
  ASSERT_EQ(values.size(), 4U);  // 2 samples, 2 targets
  for (const double value : values) sum += value / 4;
  EXPECT_NE(values[0], values[2]);
  const auto means = report(asked).at("means");
  EXPECT_NEAR(means.at("sample_psnr").at("mean").get<double>(), sum, 1e-5);
  EXPECT_EQ(means.at("ate").at("absent").at("no poses were asked for (--poses none)"), 1);
  EXPECT_TRUE(means.at("ate").at("mean").is_null());
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
  // What every scene has, whatever the sources.
  for (const char* name : {"pck_level0", "pck_level3", "pseudo_depth_abs_rel", "met3r_like_true_geometry",
                           "reconstruction_level0_psnr"}) {
    EXPECT_EQ(found.at("means").at(name).at("scenes"), 2) << name;
  }
  EXPECT_TRUE(std::filesystem::exists(std::filesystem::path(asked.out) / "plots" / "psnr.png"));
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
    const auto row = cells(line);
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
