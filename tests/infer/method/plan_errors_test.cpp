#include "infer/method/plan_errors.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/machine/precision_option.h"
#include "infer/forecast/plan_report.h"
#include "infer/forecast/sampling_plan.h"
#include "infer/method/sample_options.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

SamplingMethod method_of(const std::string& name, int64_t evaluations) {
  SamplingMethod method = quality_method(SamplingQuality::kExact);
  method.name = name;
  method.solver.evaluations = evaluations;
  return method;
}

// Three methods: cheap, middling, dear.
PlanErrors table_of_three() {
  PlanErrors table;
  table.model_hash = "abc";
  table.scenes = 16;
  table.grid = {4, 8, 8};
  table.methods = {{method_of("cheap", 6), 0.1, 0.16, 0.2},
                   {method_of("middling", 12), 0.02, 0.04, 0.05},
                   {method_of("dear", 24), 0.004, 0.008, 0.01}};
  return table;
}

TEST(PlanErrors, TheCheapestWithinTheToleranceIsPicked) {
  const auto table = table_of_three();
  const std::vector<double> flop{1e9, 2e9, 4e9};
  EXPECT_EQ(cheapest_within(table, 1, flop), 0U);
  EXPECT_EQ(cheapest_within(table, 0.2, flop), 0U);  // the bound counts, and may be met exactly
  EXPECT_EQ(cheapest_within(table, 0.19, flop), 1U);
  EXPECT_EQ(cheapest_within(table, 0.01, flop), 2U);
  EXPECT_EQ(cheapest_within(table, 1, {3e9, 2e9, 4e9}), 1U);  // cost is this scene's, not the table's order
  EXPECT_EQ(
      error_of([&] { cheapest_within(table, 0.005, flop); }),
      "--tolerance: expected at least 0.01, the bound of the most exact method that was measured (dear), "
      "found 0.005; raise it, or choose --solver and --evaluations yourself.");
}

TEST(PlanErrors, TheBoundCoversWhatWasMeasuredAndLeavesRoom) {
  const auto over = [](const std::vector<double>& errors, double typical) {
    return std::log(error_bound(errors) / typical);
  };
  // Student's quantiles at 0.001 are 4.50079, 4.14370 and 3.09 of 8, 10 and (nearly) infinitely many degrees of
  // freedom.
  EXPECT_NEAR(over({0.1}, 0.1), 4.50079 * std::sqrt(2.0) * 0.4, 1e-4);
  EXPECT_NEAR(over({0.1, 0.1, 0.1}, 0.1), 4.14370 * std::sqrt(4.0 / 3 * 8 * 0.16 / 10), 1e-4);
  const double e = std::exp(1.0);
  EXPECT_NEAR(over({0.1 / e, 0.1, 0.1 * e}, 0.1), 4.14370 * std::sqrt(4.0 / 3 * (8 * 0.16 + 2) / 10), 1e-4);
  std::vector<double> many;
  many.reserve(4000);
  for (int i = 0; i < 4000; ++i) many.push_back(0.1 * (i % 2 == 0 ? e : 1 / e));
  EXPECT_NEAR(over(many, 0.1), 3.092, 0.01);
  many.push_back(7);
  EXPECT_GE(error_bound(many), 1.25 * 7);  // never below what was seen
  EXPECT_EQ(error_bound({0, 0}), 0);
  EXPECT_LT(error_bound({0, 0.1, 0.1, 0.1, 0.1, 0.1}), 1e7);
}

TEST(PlanErrors, AreReadAsTheyWereWritten) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / kPlanErrorsFile;
  auto table = table_of_three();
  table.methods[1].method.approximate.cascade_encoder_nodes = 6;
  table.methods[1].method.guidance_interval = {0.5, 1};
  write_file_atomically(file, plan_errors_json(table).dump());
  const auto read = read_plan_errors(file);
  EXPECT_EQ(plan_errors_json(read), plan_errors_json(table));
  auto renamed = table.methods[1].method;
  renamed.name = "another name";
  ASSERT_TRUE(errors_of(read, renamed).has_value());
  EXPECT_EQ(errors_of(read, renamed)->bound, 0.05);
  renamed.approximate.cascade_encoder_nodes = 8;
  EXPECT_FALSE(errors_of(read, renamed).has_value());

  EXPECT_THAT(
      error_of([&] { read_plan_errors(folder.path() / "none.json"); }),
      testing::HasSubstr(
          "expected the measured errors of sampling with this model, found no such file; "
          "measure it again: gld bench sample --model BUNDLE --synthetic 16 --write-table --out RUN."));
  for (const char* text : {"{", "{}", "[]", R"({"format": "other"})"}) {
    write_file_atomically(file, text);
    EXPECT_THAT(error_of([&] { read_plan_errors(file); }),
                testing::HasSubstr("expected a table of gld bench sample"))
        << text;
  }
}

TEST(SamplingMethod, AFileOfTimesSaysHowManyEvaluations) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "times.txt";
  const auto write_times = [&](int count) {
    std::string text;
    for (int i = 0; i < count; ++i) text += std::to_string(1 - static_cast<double>(i) / (count - 1)) + "\n";
    write_file_atomically(file, text);
  };
  SamplingMethod method;
  method.solver.schedule.schedule = ScheduleKind::kFile;
  method.solver.schedule.schedule_file = file.string();
  const BundleOptions bundle;
  for (const auto& [solver, stages] : {std::pair<SolverKind, int64_t>{SolverKind::kEuler, 1},
                                       {SolverKind::kHeun, 2},
                                       {SolverKind::kMidpoint, 2}}) {
    method.solver.solver = solver;
    for (const int count : {2, 3, 101}) {
      write_times(count);
      for (const auto& settings : flow_settings(method, {}, bundle).solvers) {
        EXPECT_EQ(settings.evaluations, stages * (count - 1));
      }
    }
    EXPECT_THAT(method_text(method),
                testing::HasSubstr(std::to_string(100 * stages) + " evaluations a level"));
  }
}

TEST(SamplingMethod, QualitiesAreWhatTheTableSays) {
  EXPECT_EQ(method_text(quality_method(SamplingQuality::kPublished)),
            "euler on published, 49 evaluations a level");
  EXPECT_EQ(method_text(quality_method(SamplingQuality::kExact)), "unipc3 on logsnr, 16 evaluations a level");
  EXPECT_EQ(method_text(quality_method(SamplingQuality::kFast)), "unipc3 on logsnr, 6 evaluations a level");

  SamplingMethod read;
  const auto fast = quality_method(SamplingQuality::kFast);
  load_yaml_text(read, to_yaml(fast), "text");
  EXPECT_TRUE(same_method(read, fast));

  BundleOptions bundle;
  bundle.generator(level_model(1)).time_shift.evaluation = 4;
  GuidanceOptions guidance;
  guidance.guidance_scale = 2;
  const auto settings = flow_settings(fast, guidance, bundle);
  EXPECT_EQ(settings.solvers[0].schedule.shift, 4);
  EXPECT_EQ(settings.guidance.guidance_scale, 2);
  EXPECT_EQ(settings.guidance.guidance_interval, fast.guidance_interval);
}

SampleOptions asked_for() {
  SampleOptions options;
  options.scene = "scene";
  options.views.sources = {0, 3};
  options.views.targets = {1};
  options.out = "run";
  return options;
}

TEST(SampleOptions, QualityAndToleranceSpeakAlone) {
  auto options = asked_for();
  options.quality = SamplingQuality::kFast;
  options.check();
  options.guidance.guidance_scale = 3;  // what is sampled, not how
  options.no_skip = {"encoder_reuse"};
  options.named = {"quality", "guidance.guidance_scale"};
  options.check();
  options.named.emplace_back("solver.evaluations");  // as by --evaluations 16, the default
  EXPECT_EQ(
      error_of([&] { options.check(); }),
      "--quality: expected no other option beside it that decides how to sample, found 'solver.evaluations'; "
      "leave out one of the two.");
  options.named.clear();
  options.approximate.cascade_encoder_nodes = 6;  // as from a file
  EXPECT_THAT(error_of([&] { options.check(); }), testing::HasSubstr("'approximate.cascade_encoder_nodes'"));
  options.approximate.cascade_encoder_nodes = 0;
  options.tolerance = 0.1;
  EXPECT_THAT(error_of([&] { options.check(); }),
              testing::HasSubstr("--quality: expected no other option beside it that decides how to sample, "
                                 "found 'tolerance'"));
  options.quality = SamplingQuality::kOptions;
  options.check();
  options.guidance.guidance_interval = {0.9, 1};
  EXPECT_THAT(
      error_of([&] { options.check(); }),
      testing::HasSubstr("--tolerance: expected no other option beside it that decides how to sample, "
                         "found 'guidance.guidance_interval'"));
}

TEST(SampleOptions, TheMethodIsWhatTheOptionsSay) {
  auto options = asked_for();
  options.solver.evaluations = 9;
  options.guidance.guidance_interval = {0.2, 1};
  options.approximate.cascade_encoder_nodes = 5;
  const auto method = options.method();
  EXPECT_EQ(
      method_text(method),
      "unipc3 on logsnr, 9 evaluations a level; guidance from t = 1 to 0.2; cascade encoder at 5 flow times");
  options.quality = SamplingQuality::kPublished;
  EXPECT_EQ(options.method().solver.evaluations, 49);
}

TEST(SampleOptions, OnAGpuPrecisionsAreFloat32AndBfloat16) {
  auto options = asked_for();
  options.device = "cuda:0";
  options.precision = PrecisionChoice::kBFloat16;
  EXPECT_NO_THROW(options.check());
  options.tolerance = 0.1;
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "--tolerance: expected --precision float32 on the device cuda:0, where no error of another one was "
      "measured, found bfloat16; leave one of the two out.");
  options.tolerance = 0;
  options.precision = PrecisionChoice::kInt8;
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "--precision: expected float32 or bfloat16 on the device cuda:0, found int8; use --device cpu, which has "
      "kernels for it.");
  EXPECT_EQ(precision_text(ComputePrecision::kBFloat16, options.device), "bfloat16 on cuda:0");
  EXPECT_EQ(precision_text(ComputePrecision::kFloat32, options.device), "float32");
}

TEST(PlannedRuns, CountWhatTheSavingsLeave) {
  DitOptions level1, cascade;
  cascade.conditioning = DitConditioning::kDeeperLevel;
  PlanRequest request;
  request.grid = {4, 8, 8};
  request.flow = flow_settings(method_of("twenty", 20), GuidanceOptions(), BundleOptions());
  FlowSettings& flow = request.flow;
  EXPECT_EQ(planned_runs(cascade, flow.solvers[1], flow).condition_encoder, 40);
  flow.approximate.cascade_encoder_nodes = 6;
  const auto nodes = planned_runs(cascade, flow.solvers[1], flow);
  EXPECT_EQ(nodes.condition_encoder, 12);
  EXPECT_EQ(nodes.velocity_decoder, 40);
  EXPECT_EQ(planned_runs(level1, flow.solvers[0], flow).condition_encoder, 40);
  flow.guidance.guidance_scale = 1;
  EXPECT_EQ(planned_runs(cascade, flow.solvers[1], flow).condition_encoder, 6);
  EXPECT_EQ(planned_runs(level1, flow.solvers[0], flow).condition_encoder, 20);
}

TEST(PlannedRuns, TheReportPutsTheActualBesideThePredicted) {
  SamplingPlan plan;
  PlannedStage stage;
  stage.name = "M1";
  stage.seconds = 2;
  stage.peak_bytes = 1'000'000'000;
  plan.stages = {stage};
  StageRecord record;
  record.name = "M1";
  record.seconds = 3;
  record.peak_bytes = 500'000'000;
  const auto json = plan_json(plan, {record});
  EXPECT_EQ(json.at(0).at("seconds_over_predicted"), 1.5);
  EXPECT_EQ(json.at(0).at("peak_over_predicted"), 0.5);
  EXPECT_EQ(actual_text(plan, {record}),
            "the planned stages took 3.0 s (predicted 2.0 s) and at most 500.0 MB (predicted 1.00 GB)\n");
  EXPECT_FALSE(plan_json(plan, {}).at(0).contains("seconds"));

  // On a GPU its memory is what was predicted, and no time is.
  record.device_bytes = 750'000'000;
  plan.stages[0].seconds = 0;
  const auto on_device = plan_json(plan, {record}).at(0);
  EXPECT_EQ(on_device.at("peak_over_predicted"), 0.75);
  EXPECT_EQ(on_device.at("device_bytes"), 750'000'000);
  EXPECT_TRUE(on_device.at("seconds_over_predicted").is_null());
  EXPECT_TRUE(on_device.at("predicted_seconds").is_null());
  EXPECT_TRUE(predicted_seconds_json(plan).is_null());
  EXPECT_EQ(actual_text(plan, {record}),
            "the planned stages took 3.0 s and at most 750.0 MB of the GPU's memory (predicted 1.00 GB)\n");
  // What the processor computes beside it is the host's memory, and no part of that.
  PlannedStage fit = stage;
  fit.name = "splats";
  fit.of_products = false;
  plan.stages.push_back(fit);
  StageRecord of_fit;
  of_fit.name = "splats";
  of_fit.peak_bytes = 2'000'000'000;
  of_fit.device_bytes = 1000;
  EXPECT_EQ(plan_json(plan, {record, of_fit}).at(1).at("peak_over_predicted"), 2);
  EXPECT_THAT(actual_text(plan, {record, of_fit}),
              testing::HasSubstr("at most 750.0 MB of the GPU's memory"));
}

}  // namespace
}  // namespace gld
