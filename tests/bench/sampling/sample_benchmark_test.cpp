#include "bench/sampling/sample_benchmark.h"

#include "bench/sampling/sample_table.h"
#include "datasets/formats/scene_writer.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/method/plan_errors.h"
#include "infer/request/held_out_scenes.h"
#include "infer/sample/sampling.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <sstream>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::error_of;
using testing::HasSubstr;

using Rows = std::vector<std::map<std::string, std::string>>;

std::vector<std::string> cells(const std::string& line) {
  std::vector<std::string> result(1);
  bool quoted = false;
  for (const char c : line) {
    if (c == '"') {
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      result.emplace_back();
    } else {
      result.back() += c;
    }
  }
  return result;
}

Rows read_rows(const std::filesystem::path& file) {
  std::istringstream text(read_file(file));
  std::string line;
  std::getline(text, line);
  const auto names = cells(line);
  Rows rows;
  while (std::getline(text, line)) {
    const auto values = cells(line);
    EXPECT_EQ(values.size(), names.size());
    rows.emplace_back();
    for (size_t i = 0; i < values.size(); ++i) rows.back()[names[i]] = values[i];
  }
  return rows;
}

// Returns the number of the first row with these cells and this count; NaN without one.
double number(const Rows& rows, const std::map<std::string, std::string>& wanted, int count,
              const std::string& column) {
  for (const auto& row : rows) {
    const bool matches = std::all_of(wanted.begin(), wanted.end(),
                                     [&](const auto& cell) { return row.at(cell.first) == cell.second; });
    if (matches && row.at("count") == std::to_string(count)) return std::stod(row.at(column));
  }
  return std::numeric_limits<double>::quiet_NaN();
}

std::string printed_by(const SampleBenchmarkOptions& options) {
  check_options(options, "test");
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_sample_benchmark(options), 0);
  return testing::internal::GetCapturedStdout();
}

// This runs a small random model on a real scene with given views: every method has a row, errors refer to an adaptive
// solve of the same noise, and they fall with the evaluations.
TEST(SampleBenchmark, MeasuresEveryMethodAgainstTheReference) {
  const test::TemporaryFolder folder;
  const auto bundle = folder.path() / "bundle";
  write_random_bundle(bundle, small_bundle_options(), 5);
  SampleBenchmarkOptions options;
  options.model = bundle.string();
  options.scenes = {(test::test_data() / "scenes" / "gld_layout_5e040cd0758dcc96").string()};
  options.views.sources = {0, 7};
  options.views.targets = {3};
  options.size = "56x56";
  options.counts = {4, 32};
  options.families = {"published", "euler, published", "unipc2, logsnr"};
  options.reference_tolerance = 1e-4;
  options.repeats = 1;
  options.threads = 1;
  options.out = (folder.path() / "run").string();
  EXPECT_THAT(printed_by(options), HasSubstr("a Dormand-Prince solve at tolerance 0.0001"));
  const std::filesystem::path run = options.out;
  for (const char* name : {"config.yaml", "sample.csv", "methods.csv", "sample.md", "sample.svg",
                           "sample.png", "plan_errors.json", "report.json"}) {
    EXPECT_TRUE(std::filesystem::exists(run / name)) << name;
  }
  const Rows rows = read_rows(run / "sample.csv");
  EXPECT_EQ(rows.size(), 8u);  // the reference, the published sampler, and three solvers at two counts
  const auto level0_error = [&](const std::string& solver, const std::string& schedule, int count) {
    return number(rows, {{"solver", solver}, {"schedule", schedule}, {"guidance", "everywhere"}}, count,
                  "level0_error");
  };
  const double few = level0_error("unipc3", "logsnr", 4), many = level0_error("unipc3", "logsnr", 32);
  EXPECT_LT(many, 0.01);
  EXPECT_LT(many, few / 5);
  EXPECT_LT(many, level0_error("euler", "published", 32));
  EXPECT_EQ(rows[0].at("solver"), "reference");
  // Something is fastest, something is nearest, and without weights there is no LPIPS.
  const Rows methods = read_rows(run / "methods.csv");
  EXPECT_EQ(methods.size(), 7u);
  int64_t on_front = 0;
  for (const auto& row : methods) {
    if (row.at("pareto").find("error") == 0) ++on_front;
    EXPECT_EQ(row.at("lpips"), "");
  }
  EXPECT_GE(on_front, 1);
}

// Writes random weights in the two files that LPIPS comes in.
void write_random_lpips(const std::filesystem::path& folder) {
  LpipsOptions options;
  options.net = LpipsNet::kSqueeze;
  const Lpips lpips(options, ParameterPlacement{});
  std::map<std::string, torch::Tensor> backbone, heads;
  torch::manual_seed(3);
  for (const auto& parameter : lpips.named_parameters()) {
    const bool head = parameter.key().rfind("lin", 0) == 0;
    (head ? heads : backbone)[parameter.key()] = torch::rand(parameter.value().sizes());
  }
  save_safetensors(folder / "backbone.safetensors", backbone);
  save_safetensors(folder / "heads.safetensors", heads);
}

TEST(SampleBenchmark, SamplesGeneratedScenesAndMeasuresLpips) {
  const test::TemporaryFolder folder;
  const auto bundle = folder.path() / "bundle";
  auto model = small_bundle_options();
  model.trained_sizes = {"56x56"};
  write_random_bundle(bundle, model, 5);
  write_random_lpips(folder.path());
  SampleBenchmarkOptions options;
  options.model = bundle.string();
  options.synthetic = 2;
  options.counts = {2};
  options.guidance_scales = {1, 1.5};
  options.families = {"euler, logsnr"};
  options.reference_evaluations = 8;
  options.repeats = 1;
  options.lpips.lpips_backbone = (folder.path() / "backbone.safetensors").string();
  options.lpips.lpips_heads = (folder.path() / "heads.safetensors").string();
  options.lpips.lpips.net = LpipsNet::kSqueeze;
  options.threads = 1;
  options.out = (folder.path() / "run").string();
  printed_by(options);
  const Rows rows = read_rows(std::filesystem::path(options.out) / "sample.csv");
  ASSERT_EQ(rows.size(), 12u);  // two scenes, two scales, the reference and two solvers
  EXPECT_NE(rows[0].at("scene"), rows[1].at("scene"));
  for (const auto& row : rows) {
    EXPECT_GT(std::stod(row.at("lpips")), 0);
    EXPECT_GT(std::stod(row.at("psnr")), 0);
    EXPECT_GT(std::stod(row.at("sharpness")), 0);
    EXPECT_EQ(row.at("unconditional") == "0", row.at("guidance_scale") == "1");
  }
  // One count has no other to be compared with at equal work.
  for (const auto& row : read_rows(std::filesystem::path(options.out) / "methods.csv"))
    EXPECT_EQ(row.at("wins_at_equal_gflop"), "");
}

MethodRow row_of(const std::string& family, const std::string& name, double cost,
                 const std::vector<double>& errors) {
  MethodRow row;
  row.compared.family = family;
  row.compared.method.name = name;
  row.seconds = cost;
  for (const double error : errors) {
    Sample sample;
    sample.scene = "scene";
    sample.flop = cost;
    sample.level_errors = {{0, error}, {1, 0.0}};
    row.samples.push_back(sample);
  }
  return row;
}

TEST(SampleBenchmark, ErrorsAreComparedAtEqualCost) {
  // A second-order method: four times the work, a sixteenth of the error.
  const std::vector<std::pair<double, double>> points{{4, 0.01}, {1, 0.16}, {2, 0.04}};
  EXPECT_NEAR(error_at_cost(points, 2), 0.04, 1e-12);
  EXPECT_NEAR(error_at_cost(points, std::sqrt(2.0)), 0.08, 1e-12);
  EXPECT_NEAR(error_at_cost(points, 8), 0.0025, 1e-12);
  EXPECT_NEAR(error_at_cost(points, 0.5), 0.64, 1e-12);
  std::vector<MethodRow> rows{
      row_of("fewer evaluations", "a", 1, {0.2, 0.12}), row_of("fewer evaluations", "b", 4, {0.01, 0.01}),
      row_of("encoder nodes", "better", 2, {0.03, 0.03}), row_of("encoder nodes", "slower", 2, {0.03, 0.03}),
      row_of("guidance interval", "worse", 2, {0.05, 0.07})};
  rows[3].seconds = 4;  // the same operations, in twice the time
  summarise(rows, {});
  EXPECT_DOUBLE_EQ(rows[0].mean_error, 0.16);
  EXPECT_DOUBLE_EQ(rows[0].largest_error, 0.2);
  EXPECT_EQ(rows[0].error_at_equal_flop, 0);
  EXPECT_NEAR(rows[2].error_at_equal_flop, 0.04, 1e-12);
  EXPECT_NEAR(rows[3].error_at_equal_flop, 0.04, 1e-12);
  EXPECT_NEAR(rows[3].error_at_equal_seconds, 0.01, 1e-12);
  const auto table = method_table(rows).csv();
  EXPECT_THAT(table, testing::HasSubstr(",largest_error,level1_error,level0_error,"));
  EXPECT_THAT(table, testing::ContainsRegex("better.*,this,[0-9.e-]*,this,error\n"));
  EXPECT_THAT(table, testing::ContainsRegex("slower.*,this,[0-9.e-]*,fewer evaluations,\n"));
  EXPECT_THAT(table, testing::ContainsRegex("worse.*,fewer evaluations,[0-9.e-]*,fewer evaluations,\n"));
}

TEST(SampleBenchmark, MeansAreOverScenes) {
  MethodRow row = row_of("fewer evaluations", "a", 1, {0.1, 0.3});
  for (Sample& sample : row.samples) sample.evaluations = 12;
  row.samples[0].quality["ssim"] = 0.25;  // and no psnr
  row.samples[1].quality["ssim"] = 0.75;
  row.samples[0].peak_bytes = 5;
  row.samples[1].peak_bytes = 7;
  row.samples[1].level_errors[1] = 0.5;  // the worst level counts
  std::vector<MethodRow> rows{row};
  summarise(rows, {});
  EXPECT_DOUBLE_EQ(rows[0].mean.level_errors[0], 0.2);
  EXPECT_DOUBLE_EQ(rows[0].mean_error, 0.3);
  EXPECT_DOUBLE_EQ(rows[0].largest_error, 0.5);
  EXPECT_DOUBLE_EQ(rows[0].mean.quality_of("ssim"), 0.5);
  EXPECT_TRUE(std::isnan(rows[0].mean.quality_of("psnr")));
  EXPECT_EQ(rows[0].mean.evaluations, 12);
  EXPECT_EQ(rows[0].mean.peak_bytes, 7);
}

TEST(SampleBenchmark, FrontsAreOfOneGuidanceScale) {
  const auto row = [](double scale, double seconds, double error, double quality) {
    MethodRow made = row_of("encoder nodes", "a", seconds, {error});
    made.compared.guidance_scale = scale;
    made.samples[0].quality["psnr"] = quality;
    return made;
  };
  std::vector<MethodRow> rows{row(1, 1, 0.5, 20), row(1, 2, 0.4, 19), row(1, 3, 0.45, 21), row(2, 9, 0.9, 10),
                              row(1, 0.1, 0.01, 50)};
  rows[4].samples[0].non_finite = 1;
  summarise(rows, {});
  const std::vector<bool> error{true, true, false, true, false}, quality{true, false, true, true, false};
  for (size_t i = 0; i < rows.size(); ++i) {
    EXPECT_EQ(rows[i].on_error_front, error[i]) << i;
    EXPECT_EQ(rows[i].on_quality_front, quality[i]) << i;
  }
}

TEST(SampleBenchmark, BoundsAreCheckedOnTheOtherHalf) {
  std::vector<MethodRow> rows{row_of("f", "calm", 1, {0.1, 0.11, 0.1, 0.11}),
                              row_of("f", "wild", 1, {0.1, 10, 0.1, 0.1})};
  const auto check = check_bounds(rows);
  EXPECT_EQ(check.samples, 8);
  EXPECT_EQ(check.exceeded, 1);
}

// The whole run on a small random model, whose table then serves --tolerance.
TEST(SampleBenchmark, MeasuresATableThatToleranceUses) {
  const test::TemporaryFolder folder;
  const auto model = folder.path() / "model";
  auto bundle = small_bundle_options();
  bundle.trained_sizes = {"56x56"};
  write_random_bundle(model, bundle, 5);
  SampleBenchmarkOptions options;
  options.model = model.string();
  options.synthetic = 2;
  options.counts = {4, 8};
  options.families = {"published", "euler, logsnr", "guidance interval"};
  options.reference_evaluations = 16;
  options.repeats = 1;
  options.threads = 2;
  options.write_table = true;
  options.out = (folder.path() / "run").string();
  options.families.emplace_back("encoder node");
  const std::string refused = error_of([&] { run_sample_benchmark(options); });
  EXPECT_THAT(refused, testing::StartsWith("--families: expected kinds of methods ('published', "));
  EXPECT_THAT(refused, HasSubstr("'euler, logsnr', "));
  EXPECT_THAT(refused, testing::EndsWith("), found 'encoder node'; did you mean 'encoder nodes'?"));
  options.families.back() = "euler";
  const std::string cut = error_of([&] { run_sample_benchmark(options); });
  EXPECT_THAT(cut, testing::EndsWith("), found 'euler'; give a name with a comma by --set "
                                     "\"families=['euler, logsnr']\"."));
  options.families.pop_back();
  const auto text = printed_by(options);
  EXPECT_THAT(text, HasSubstr("| published"));
  EXPECT_THAT(text, HasSubstr("wins_at_equal_seconds"));
  const auto table = read_plan_errors(model / kPlanErrorsFile);
  EXPECT_EQ(table.scenes, 2);
  EXPECT_EQ(table.grid.views, 4);
  double four = 0, eight = 0;
  for (const auto& entry : table.methods) {
    EXPECT_GE(entry.bound, entry.largest);
    EXPECT_EQ(entry.method.solver.solver == SolverKind::kUniPc3, entry.method.name != "published");
    if (entry.method.name == "4 evaluations") four = entry.mean;
    if (entry.method.name == "8 evaluations") eight = entry.mean;
  }
  EXPECT_EQ(table.methods.size(), 5U);  // other solvers are not offered
  EXPECT_LT(eight, four);

  SampleOptions asked;
  asked.model = model.string();
  SyntheticOptions room;
  room.seed = 3;
  room.frames = 6;
  room.width = room.height = 56;
  const auto scene = folder.path() / "scene";
  write_scene(make_synthetic_scene(room, 0), "cameras-json", scene);
  asked.scene = scene.string();
  asked.views.sources = {0, 3};
  asked.views.targets = {1, 2};
  asked.outputs = {"latents"};
  asked.threads = 1;
  asked.out = (folder.path() / "sample").string();
  asked.tolerance = 5;
  const auto plan = sampling_plan_report(asked, PlanTiming::kPredicted).text;
  EXPECT_THAT(plan,
              HasSubstr("measured methods with an error below --tolerance 5; relative latent error at most"));
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  sample(asked);
  testing::internal::GetCapturedStderr();
  EXPECT_THAT(testing::internal::GetCapturedStdout(), HasSubstr("below --tolerance 5"));
  const auto report = nlohmann::json::parse(read_file(std::filesystem::path(asked.out) / "report.json"));
  EXPECT_LE(report.at("sampling").at("error_estimate").at("largest_expected").get<double>(), 5);
  for (const auto& stage : report.at("plan")) {
    if (stage.at("stage") != "M1" && stage.at("stage") != "cascade") continue;
    EXPECT_GT(stage.at("seconds_over_predicted").get<double>(), 0);
    const auto& flow = report.at("flows").at(stage.at("stage") == "M1" ? 0 : 1);
    EXPECT_EQ(flow.at("condition_encoder_runs"), stage.at("condition_encoder_runs"));
    EXPECT_EQ(flow.at("velocity_decoder_runs"), stage.at("velocity_decoder_runs"));
  }

  asked.guidance.guidance_scale = 3;
  EXPECT_THAT(
      error_of([&] { sampling_plan_report(asked, PlanTiming::kPredicted); }),
      HasSubstr("--tolerance: expected a guidance scale of at most 1.5, with which errors were measured, "
                "found 3"));
  asked.guidance.guidance_scale = 1.5;
  write_random_bundle(model, bundle, 6);
  EXPECT_THAT(error_of([&] { sampling_plan_report(asked, PlanTiming::kPredicted); }),
              HasSubstr("expected errors measured with this bundle's weights, found those of other weights"));
  std::filesystem::remove(model / kPlanErrorsFile);
  EXPECT_THAT(error_of([&] { sampling_plan_report(asked, PlanTiming::kPredicted); }),
              HasSubstr("expected the measured errors of sampling with this model, found no such file"));
}

TEST(SampleBenchmark, EveryMethodIsThereOnce) {
  BundleOptions bundle;
  const auto methods = compared_methods({6, 16, 49}, {ComputePrecision::kInt8}, 1.5, bundle);
  std::vector<std::string> names, families;
  for (const auto& compared : methods) {
    names.push_back(compared.method.name);
    families.push_back(compared.family);
    for (const auto& other : methods)
      EXPECT_EQ(same_method(compared.method, other.method), &compared == &other) << other.method.name;
  }
  for (const char* family :
       {"published", "fewer evaluations", "euler, published", "euler, logsnr", "dpmpp2m, logsnr",
        "unipc2, logsnr", "encoder nodes", "guidance interval", "int8"}) {
    EXPECT_THAT(families, testing::Contains(family));
  }
  std::sort(names.begin(), names.end());
  EXPECT_EQ(std::unique(names.begin(), names.end()), names.end());
  // Refined samples are there to be looked at: their distance from a converged solve bounds nothing.
  EXPECT_THAT(families, testing::Not(testing::Contains("refined")));
  auto refining = bundle;
  refining.refiner.degraded = DegradedLatents::kGenerated;
  refining.refiner.channels = {32, 32};
  std::vector<std::string> refined;
  for (const auto& compared : compared_methods({6}, {}, 1.5, refining)) {
    if (compared.family != "refined") continue;
    refined.push_back(compared.method.name);
    EXPECT_TRUE(compared.method.refine);
    EXPECT_FALSE(compared.is_offered());
  }
  EXPECT_THAT(refined, testing::ElementsAre("4 evaluations, refined", "6 evaluations, refined",
                                            "8 evaluations, refined"));
  // Without guidance there is no interval of it.
  for (const auto& compared : compared_methods({6}, {}, 1, bundle)) {
    EXPECT_NE(compared.family, "guidance interval");
  }
  // A cascade with special tokens has no nodes to choose.
  bundle.generator(cascade(1, 0)).dit.num_special_tokens = 5;
  for (const auto& compared : compared_methods({6, 16}, {}, 1.5, bundle)) {
    EXPECT_EQ(compared.method.approximate.cascade_encoder_nodes, 0) << compared.method.name;
  }
}

TEST(SampleBenchmark, RefusesWhatItCannotCompare) {
  SampleBenchmarkOptions options;
  options.out = "run";
  EXPECT_EQ(error_of([&] { options.check(); }),
            "--scenes, --synthetic: expected either folders of scenes or a number of generated scenes, found "
            "neither; add for example --synthetic 4.");
  options.synthetic = 4;
  options.counts = {8, 8};
  EXPECT_EQ(
      error_of([&] { options.check(); }),
      "--counts: expected each number once, in rising order, found 8 before 8; write for example 8,16.");
  options.counts = {8, 16};
  options.check();
  options.lpips.lpips_heads = "heads.pth";
  EXPECT_EQ(error_of([&] { options.check(); }),
            "--lpips-backbone, --lpips-heads: expected both files, or neither, found only the heads; "
            "give both files.");
}

}  // namespace
}  // namespace gld
