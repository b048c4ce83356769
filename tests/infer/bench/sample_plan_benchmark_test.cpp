#include "infer/bench/sample_plan_benchmark.h"

#include "datasets/formats/scene_writer.h"
#include "gld/base/atomic_file.h"
#include "infer/bench/sample_plan_table.h"
#include "infer/method/plan_errors.h"
#include "infer/sample/sampling.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::error_of;
using testing::HasSubstr;

PlanRow row_of(const std::string& family, const std::string& name, double flop,
               const std::vector<double>& errors) {
  PlanRow row;
  row.variant.family = family;
  row.variant.method.name = name;
  for (const double error : errors) {
    PlanSample sample;
    sample.flop = flop;
    sample.shallowest_error = error;
    row.samples.push_back(sample);
  }
  return row;
}

TEST(SamplePlanBenchmark, WantsEachCountOnce) {
  SamplePlanBenchmarkOptions options;
  options.out = "run";
  options.counts = {8, 8};
  EXPECT_EQ(
      error_of([&] { options.check(); }),
      "--counts: expected each number once, in rising order, found 8 before 8; write for example 8,16.");
  options.counts = {8, 16};
  options.check();
}

TEST(SamplePlanBenchmark, ErrorsAreComparedAtEqualWork) {
  // A second-order method: four times the work, a sixteenth of the error.
  const std::vector<std::pair<double, double>> points{{4, 0.01}, {1, 0.16}, {2, 0.04}};
  EXPECT_NEAR(error_at_flop(points, 2), 0.04, 1e-12);
  EXPECT_NEAR(error_at_flop(points, std::sqrt(2.0)), 0.08, 1e-12);
  EXPECT_NEAR(error_at_flop(points, 8), 0.0025, 1e-12);
  EXPECT_NEAR(error_at_flop(points, 0.5), 0.64, 1e-12);
  std::vector<PlanRow> rows{row_of("fewer evaluations", "a", 1, {0.2, 0.12}),
                            row_of("fewer evaluations", "b", 4, {0.01, 0.01}),
                            row_of("encoder nodes", "better", 2, {0.03, 0.03}),
                            row_of("M1 encoder reuse", "worse", 2, {0.05, 0.07})};
  summarise(rows);
  EXPECT_DOUBLE_EQ(rows[0].mean_error, 0.16);
  EXPECT_DOUBLE_EQ(rows[0].largest_error, 0.2);
  EXPECT_EQ(rows[0].error_of_fewer_evaluations, 0);
  const auto table = plan_row_table(rows).csv();
  EXPECT_THAT(table, testing::ContainsRegex("better.*this\n"));
  EXPECT_THAT(table, testing::ContainsRegex("worse.*fewer evaluations\n"));
}

TEST(SamplePlanBenchmark, BoundsAreCheckedOnTheOtherHalf) {
  const auto calm = row_of("f", "calm", 1, {0.1, 0.11, 0.1, 0.11});
  const auto wild = row_of("f", "wild", 1, {0.1, 10, 0.1, 0.1});
  const auto check = check_bounds({calm, wild});
  EXPECT_EQ(check.samples, 8);
  EXPECT_EQ(check.exceeded, 1);
}

// The whole run on a small random model, whose table then serves --tolerance.
TEST(SamplePlanBenchmark, MeasuresATableThatToleranceUses) {
  const test::TemporaryFolder folder;
  const auto model = folder.path() / "model";
  auto bundle = small_bundle_options();
  bundle.trained_sizes = {"56x56"};
  write_random_bundle(model, bundle, 5);
  SamplePlanBenchmarkOptions options;
  options.model = model.string();
  options.synthetic = 2;
  options.generator.width = options.generator.height = 56;
  options.counts = {4, 8};
  options.families = {"published", "visible pairs", "fast"};
  options.reference_evaluations = 16;
  options.repeats = 1;
  options.threads = 2;
  options.write_table = true;
  options.out = (folder.path() / "run").string();
  options.families.emplace_back("encoder node");
  EXPECT_EQ(error_of([&] { run_sample_plan_benchmark(options); }),
            "--families: expected kinds of methods, found 'encoder node'; did you mean 'encoder nodes'?");
  options.families.pop_back();
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_sample_plan_benchmark(options), 0);
  const auto text = testing::internal::GetCapturedStdout();
  EXPECT_THAT(text, HasSubstr("| published"));
  EXPECT_THAT(text, HasSubstr("wins_at_equal_flop"));
  const std::filesystem::path run = options.out;
  for (const char* name : {"config.yaml", "sample_plan.csv", "samples.csv", "sample_plan.md",
                           "sample_plan.svg", "sample_plan.png", "plan_errors.json", "report.json"}) {
    EXPECT_TRUE(std::filesystem::exists(run / name)) << name;
  }
  const auto table = read_plan_errors(model / kPlanErrorsFile);
  EXPECT_EQ(table.scenes, 2);
  EXPECT_EQ(table.grid.views, 4);
  double four = 0, eight = 0;
  for (const auto& entry : table.methods) {
    EXPECT_GE(entry.bound, entry.largest);
    if (entry.method.name == "4 evaluations") four = entry.mean;
    if (entry.method.name == "8 evaluations") eight = entry.mean;
  }
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

TEST(SamplePlanBenchmark, EveryVariantIsThereOnce) {
  BundleOptions bundle;
  const auto variants = plan_variants({6, 16}, bundle);
  std::vector<std::string> names, families;
  for (const auto& variant : variants) {
    names.push_back(variant.method.name);
    families.push_back(variant.family);
  }
  for (const char* family : {"published", "fewer evaluations", "encoder nodes", "M1 encoder reuse",
                             "guidance interval", "guidance dropped", "visible pairs", "balanced", "fast"}) {
    EXPECT_THAT(families, testing::Contains(family));
  }
  std::sort(names.begin(), names.end());
  EXPECT_EQ(std::unique(names.begin(), names.end()), names.end());
  // A cascade with special tokens has no nodes to choose.
  bundle.generator(cascade(1, 0)).dit.num_special_tokens = 5;
  for (const auto& variant : plan_variants({6, 16}, bundle)) {
    EXPECT_EQ(variant.method.approximate.cascade_encoder_nodes, 0) << variant.method.name;
  }
}

}  // namespace
}  // namespace gld
