// What gld plan, the memory check and gld doctor say of a sampling.
#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/images/pfm_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/export/ply_file.h"
#include "infer/forecast/doctor.h"
#include "infer/forecast/machine_rates.h"
#include "infer/sample/prepared_sampling.h"
#include "infer/sample/unfinished_latents.h"
#include "models/bundle/random_bundle.h"
#include "models/bundle/trained_views.h"
#include "models/weights/weight_loading.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <limits>

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

namespace gld {
namespace {

class SamplingPlanReport : public test::Sampling {};
using testing::HasSubstr;

TEST_F(SamplingPlanReport, ManyMoreViewsThanTheModelWasTrainedOnAreAWarning) {
  auto asked = options("many_views");
  asked.model = (folder_->path() / "of_three").string();
  write_random_bundle(asked.model, small_bundle_options(), 7);
  const auto few_views = testing::Not(testing::Contains(HasSubstr("The model was trained on scenes")));
  EXPECT_THAT(sampling_plan_report(asked, PlanTiming::kPredicted).warnings, few_views);
  const auto bundle = ModelBundle::open(asked.model);
  note_trained_views(bundle, BundlePart::of(level_model(1)), 1);
  EXPECT_THAT(sampling_plan_report(asked, PlanTiming::kPredicted).warnings,
              testing::Contains("The model was trained on scenes of 1 view, this one has 4."));
  note_trained_views(bundle, BundlePart::of(level_model(1)), 2);
  EXPECT_THAT(sampling_plan_report(asked, PlanTiming::kPredicted).warnings, few_views);
}

TEST_F(SamplingPlanReport, WhatDoesNotFitIsRefusedWithWhatWould) {
  auto asked = options("too_large");
  asked.memory_limit = 0.4;
  asked.views.targets.clear();
  asked.views.path.path = "orbit";
  asked.views.path.frames = 400;
  EXPECT_THAT(
      test::error_of([&] { sample(asked); }),
      testing::ContainsRegex("This takes .* of memory by the forecast and 400.0 MB may be taken; what would "
                             "fit: [0-9]+ views of this size"));
  EXPECT_FALSE(std::filesystem::exists(asked.out));
  EXPECT_THAT(sampling_plan_report(asked, PlanTiming::kPredicted).warnings,
              testing::Contains(HasSubstr("This takes ")));
}

TEST_F(SamplingPlanReport, ThePlanNamesWhatRunsAndWhy) {
  auto asked = options("unused");
  asked.outputs = {"image"};
  const auto text = sampling_plan_report(asked, PlanTiming::kPredicted).text;
  EXPECT_THAT(text, HasSubstr("3 evaluations, 3 with the unconditional branch"));
  EXPECT_THAT(text,
              testing::ContainsRegex("geometry +- +left out +- +no depth, rays or points were asked for"));
  EXPECT_FALSE(std::filesystem::exists(folder_->path() / "unused"));
}

TEST_F(SamplingPlanReport, ThePlanKnowsWhichWeightsAreConverted) {
  auto asked = options("unused");
  const auto folder = folder_->path() / "stored_in_bfloat16";
  std::filesystem::copy(asked.model, folder);
  asked.model = folder.string();
  const auto part = BundlePart::of(level_model(1));
  save_bundle_part(folder, part, named_tensors(*ModelBundle::open(folder).load_generator(level_model(1))),
                   DType::kBFloat16);
  write_file_atomically(ModelBundle::open(folder).file(BundlePart::geometry_head()), "broken");
  asked.outputs = {"image"};  // which needs no geometry head
  const PreparedSampling prepared = prepare(asked);
  const auto converted = plan_request(prepared, asked).converted_bytes;
  EXPECT_GT(converted.at(bundle_part_name(part)), 0);
  EXPECT_EQ(converted.at(bundle_part_name(part)), prepared.bundle.converted_bytes(part));
  EXPECT_EQ(converted.at("backbone"), 0);
  EXPECT_EQ(converted.count("dpt_head"), 0U);
}

TEST_F(SamplingPlanReport, ThePlanDecodesNoPhotograph) {
  const auto scene = folder_->path() / "cut_short";
  std::filesystem::copy(folder_->path() / "scene", scene, std::filesystem::copy_options::recursive);
  for (const auto& entry : std::filesystem::recursive_directory_iterator(scene)) {
    // The header, which tells the size, stays.
    if (entry.path().extension() == ".png") std::filesystem::resize_file(entry.path(), 200);
  }
  auto asked = options("unused");
  asked.scene = scene.string();
  const auto text = sampling_plan_report(asked, PlanTiming::kPredicted).text;
  EXPECT_THAT(text, HasSubstr("2 source and 2 target views at 112x56"));
  EXPECT_THROW(sample(asked), Error);
}

// The photographs are cut short behind the header, which tells the size: whoever decoded one would fail.
std::vector<std::string> undecodable_photographs(const std::filesystem::path& picture,
                                                 const std::filesystem::path& folder, int count) {
  std::filesystem::create_directories(folder);
  const std::string header = read_file(picture).substr(0, 200);
  for (int i = 0; i < count; ++i) write_file_atomically(folder / fmt::format("{:04}.png", i), header);
  return {folder.string()};
}

TEST_F(SamplingPlanReport, ThePlanOfPhotographsReadsTheirSizesAlone) {
  auto asked = options("unused");
  const auto picture = open_scene(asked.scene).frames.front().image_file;
  asked.scene.clear();
  asked.photos.files = undecodable_photographs(picture, folder_->path() / "few_photographs", 5);
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.views.sources = {};
  asked.views.targets = {};
  asked.size = "auto";
  const auto text = sampling_plan_report(asked, PlanTiming::kPredicted).text;
  EXPECT_THAT(text, HasSubstr("5 source and 6 target views at "));
  EXPECT_THAT(text, HasSubstr("gld sample estimates the cameras of the photographs"));
  EXPECT_THAT(text, testing::ContainsRegex("photo cameras .* 5 photographs, whose cameras .* sees"));
  EXPECT_TRUE(sampling_plan_report(asked, PlanTiming::kPredicted).warnings.empty());
  asked.views.sources = {5};
  EXPECT_THAT(test::error_of([&] { sampling_plan_report(asked, PlanTiming::kPredicted); }),
              HasSubstr("--sources: expected frame numbers from 0 to 4"));
}

TEST_F(SamplingPlanReport, PhotographsThatDoNotFitAreRefusedBeforeTheyAreDecoded) {
  auto asked = options("too_many");
  const auto picture = open_scene(asked.scene).frames.front().image_file;
  asked.scene.clear();
  asked.photos.files = undecodable_photographs(picture, folder_->path() / "many_photographs", 3000);
  asked.photos.cameras = PhotoCameraWay::kRays;
  asked.views.sources = {0, 1};
  asked.views.targets = {2};
  asked.memory_limit = 0.4;
  EXPECT_THAT(
      test::error_of([&] { sample(asked); }),
      testing::ContainsRegex("This takes .* of memory by the forecast and 400.0 MB may be taken; what "
                             "would fit: [0-9]+ photographs"));
  EXPECT_FALSE(std::filesystem::exists(asked.out));
}

// Measuring takes seconds, and its loops wait for other programs: once, by the doctor, and kept.
TEST_F(SamplingPlanReport, PlansTakeTheKeptRatesAndMeasureNothing) {
  auto asked = options("kept_rates");
  asked.outputs = {"latents"};
  EXPECT_THAT(sampling_plan_report(asked, PlanTiming::kPredicted).text, HasSubstr("quick estimate"));
  EXPECT_FALSE(std::filesystem::exists(machine_rates_file()));
  MeasuredSpeed measured;
  MachineSpeed& slow = measured.speed;
  slow.multiply_add_peak = slow.matrix_product = slow.linear = slow.attention = slow.loading = 1e6;
  measured.spread = 0.05;
  set_thread_count(1);
  keep_machine_speed(machine_rates_file(), present_rate_key(), measured);
  asked.overwrite = true;
  const auto report = run(asked);
  EXPECT_THAT(printed_, HasSubstr("rates, measured on 1970-01-01 00:00 UTC, repeats within 5 %\n"));
  const auto& level1 = report.at("plan").at(1);
  EXPECT_EQ(level1.at("stage"), "M1");
  EXPECT_NEAR(level1.at("predicted_seconds").get<double>() / (level1.at("tflop").get<double>() * 1e6), 1,
              0.5);
  // It took far less than these rates said, and the next plan knows.
  run(asked);
  EXPECT_THAT(printed_, HasSubstr("and mended by 1 run\n"));
  run(asked);
  const auto mended = kept_machine_speed(machine_rates_file(), present_rate_key());
  ASSERT_TRUE(mended);
  EXPECT_EQ(mended->runs.at(ComputePrecision::kFloat32).size(), 3u);
  EXPECT_LT(mended->speed.float32_stages, 0.5);
  std::filesystem::remove(machine_rates_file());
}

TEST_F(SamplingPlanReport, TheDoctorForecastsForAModel) {
  DoctorOptions asked;
  asked.model = (folder_->path() / "model").string();
  asked.size = "112x56";
  asked.json = true;
  asked.threads = 1;
  const auto report = nlohmann::json::parse(doctor_report(asked).text);
  EXPECT_GT(report.at("machine").at("multiply_add_gflops").get<double>(), 0.1);
  EXPECT_GT(report.at("machine").at("sgemm_gflops").get<double>(), 0.1);
  ASSERT_EQ(report.at("forecast").size(), 6u);
  // On a machine that is busy with other tests they may contradict themselves, and then that is said.
  const std::string rates = report.at("machine").at("rates");
  EXPECT_THAT(rates, HasSubstr("rates measured now"));
  if (rates.find("not kept") != std::string::npos) {
    EXPECT_THAT(rates, HasSubstr("they contradict themselves"));
    EXPECT_FALSE(report.at("complaints").empty());
  }
  MeasuredSpeed kept;
  kept.speed.multiply_add_peak = 4e9;
  kept.speed.matrix_product = kept.speed.linear = kept.speed.attention = kept.speed.loading = 3e9;
  keep_machine_speed(machine_rates_file(), present_rate_key(), kept);
  const auto again = nlohmann::json::parse(doctor_report(asked).text);
  EXPECT_THAT(again.at("machine").at("rates").get<std::string>(), HasSubstr("--measure renews them"));
  EXPECT_EQ(again.at("machine").at("linear_gflops"), 3);
  for (const auto& stage : report.at("forecast")) EXPECT_GT(stage.at("predicted_seconds").get<double>(), 0);
  EXPECT_EQ(again.at("warnings"), nlohmann::json(doctor_report(asked).warnings));
  asked.views = 1000;
  asked.size = "10080x10080";
  asked.json = false;
  EXPECT_THAT(doctor_report(asked).warnings, testing::Contains(HasSubstr("The forecast needs ")));
  asked.sources = asked.views;
  EXPECT_EQ(
      test::error_of([&] { asked.check(); }),
      "--source-views: expected fewer source views than views, found 1000 of 1000; leave at least one target view.");
}

// The geometry stage that a bundle without a head leaves out is no evaluation, and the grid is that of --solver.shift.
TEST_F(SamplingPlanReport, TheDoctorCountsTheEvaluationsOfFlows) {
  auto headless = small_bundle_options();
  headless.geometry_head = GeometryHeadOptions::none();
  DoctorOptions asked;
  asked.model = (folder_->path() / "headless").string();
  write_random_bundle(asked.model, headless, 7);
  asked.size = "112x56";
  asked.json = true;
  asked.threads = 1;
  asked.guidance.guidance_interval = {0.9, 1};
  asked.solver.schedule.schedule = ScheduleKind::kShifted;
  const auto guided = [&] {
    const auto advice =
        nlohmann::json::parse(doctor_report(asked).text).at("advice").at(0).get<std::string>();
    int doubled = 0, evaluations = 0;
    EXPECT_EQ(std::sscanf(advice.c_str(), "Guidance doubles %d of %d", &doubled, &evaluations), 2) << advice;
    EXPECT_EQ(evaluations, 32);
    return doubled;
  };
  const int with_the_models_shift = guided();
  asked.solver.schedule.shift = 1;
  EXPECT_LT(guided(), with_the_models_shift);
}

}  // namespace
}  // namespace gld
