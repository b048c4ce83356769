#include "infer/sample/sampling.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/page/run_report.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/export/ply_file.h"
#include "infer/page/report_command.h"
#include "models/bundle/random_bundle.h"
#include "models/bundle/view_unit_file.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::Sampling;
using testing::HasSubstr;

// A random model's rays fit no camera, so its depth has no place in the scene.
TEST_F(Sampling, SaysWhereAModelIsNotShownThePhotographs) {
  BundleOptions options_of_model = small_bundle_options();
  options_of_model.generator(level_model(1)).dit.warped_sources = 2;
  const auto model = folder_->path() / "warping_model";
  write_random_bundle(model, options_of_model, 7);
  auto asked = options("warping");
  asked.model = model.string();
  asked.outputs = {"image"};
  asked.photograph_use.source_depth =
      PhotographOptions::DepthChoice::kModel;  // photographs would tell the scale
  const auto report = run(asked);
  EXPECT_THAT(stage_names(report), testing::Contains("source warp"));
  EXPECT_THAT(
      report.at("warnings").dump(),
      HasSubstr(
          "The model was not shown the source photographs in the target views, as it is trained to be: the "
          "unit of the source views' depth is not known ("));
  auto alone = asked;
  alone.views.sources = {0};
  alone.out = (folder_->path() / "warping_alone").string();
  EXPECT_THAT(run(alone).value("warnings", nlohmann::json::array()).dump(),
              testing::Not(HasSubstr("was not shown the source photographs")));
}

TEST_F(Sampling, WritesEverythingThatIsAskedFor) {
  auto asked = options("everything");
  asked.outputs = {"image", "depth", "rays", "points", "latents", "page"};
  const auto report = run(asked);
  const std::filesystem::path out = asked.out;
  for (const char* file : {"config.yaml", "report.json", "contact_sheet.png", "cameras.json", "points.ply",
                           "latents.safetensors", "images/view_02.png", "images/view_03.png",
                           "depth/view_02.png", "depth/view_02.pfm", "depth/view_02_preview.png",
                           "rays/view_03.npz", "truth/view_02.png", "report.html"}) {
    EXPECT_TRUE(std::filesystem::is_regular_file(out / file)) << file;
  }
  EXPECT_FALSE(std::filesystem::exists(out / "images" / "view_00.png"));  // sources are not generated
  // The run folder is a scene again, with all four views.
  const Scene written = open_scene(out);
  ASSERT_EQ(written.frames.size(), 4u);
  EXPECT_EQ(written.frames[0].image().width, 112);
  // Depth is written with cameras that it belongs to; a random model's rays may fit none.
  EXPECT_EQ(written.frames[3].has_depth(),
            report.contains("depth_scale") || report.contains("pose_alignment"));
  const Image image = read_image(out / "images" / "view_02.png");
  EXPECT_EQ(image.width, 112);
  EXPECT_EQ(image.height, 56);
  EXPECT_EQ(report.at("flows").at(0).at("function_evaluations"), 3);
  EXPECT_EQ(report.at("flows").at(1).at("with_unconditional_branch"), 3);
  EXPECT_EQ(report.at("against_truth").size(), 2u);
  EXPECT_EQ(report.at("model").at("hash").get<std::string>().size(), 64u);
  EXPECT_THAT(printed_, HasSubstr("2 source and 2 target views at 112x56"));
  EXPECT_THAT(printed_, HasSubstr((out / "contact_sheet.png").string()));
  EXPECT_THAT(printed_, HasSubstr((out / "report.html").string()));
  // Every doubt stands below the box.
  for (const std::string& doubt : doubts_of_run(nlohmann::ordered_json(report))) {
    EXPECT_GT(printed_.find("in doubt: " + doubt + "\n"), printed_.find("report.html")) << doubt;
    EXPECT_THAT(printed_, HasSubstr("in doubt: " + doubt + "\n"));
  }
}

TEST_F(Sampling, ThePageIsMadeAgainFromTheFolderAlone) {
  auto asked = options("page");
  asked.outputs = {"image", "page"};
  const auto report = run(asked);
  const std::filesystem::path out = asked.out;
  const std::string page = read_file(out / "report.html");
  EXPECT_THAT(page, HasSubstr("<meta name=\"gld:model\" content=\"" +
                              report.at("model").at("hash").get<std::string>()));
  EXPECT_THAT(page, HasSubstr("This run has no point cloud"));
  // Where a run lies is nobody's business; what makes it again is.
  EXPECT_THAT(page, testing::Not(HasSubstr(folder_->path().string())));
  EXPECT_THAT(report.at("command_line").get<std::string>(), HasSubstr("gld sample --model "));
  EXPECT_THAT(report.at("command_line").get<std::string>(), HasSubstr(" --outputs image,page"));
  EXPECT_THAT(report.at("command_line").get<std::string>(), testing::EndsWith(" --out runs/again"));
  write_run_page(out, PageOptions());
  EXPECT_EQ(read_file(out / "report.html"), page);
  asked = options("without_page");
  asked.outputs = {"image"};
  run(asked);
  EXPECT_FALSE(std::filesystem::exists(folder_->path() / "without_page" / "report.html"));
  EXPECT_FALSE(std::filesystem::exists(folder_->path() / "without_page" / "truth"));
}

// The shipped model's ray origins do not tell the scale, and nothing else is asked. Then files belong to each other,
// and what was given is not lost.
TEST_F(Sampling, WithoutAScaleCamerasAndDepthAreOfOneUnit) {
  auto asked = with_shipped_model(options("no_scale"));
  asked.outputs = {"image", "depth", "points"};
  asked.scale_from = {"camera_poses"};
  const auto report = run(asked);
  const std::filesystem::path out = asked.out;
  ASSERT_FALSE(report.contains("depth_scale"));
  EXPECT_THAT(report.at("warnings").dump(), HasSubstr("The scale of the predicted depth is not known ("));
  EXPECT_THAT(printed_, HasSubstr("its scale is not known"));
  const CameraList written = read_cameras_json(out / "cameras.json");
  const CameraList given = read_cameras_json(out / "given_cameras.json");
  EXPECT_FALSE(written.metric);
  EXPECT_TRUE(given.metric);  // the drawn scene is in metres
  const Scene scene = open_scene(folder_->path() / "scene");
  ASSERT_EQ(written.records.size(), 4U);
  for (const auto& record : given.records) EXPECT_EQ(record.depth, "");
  EXPECT_EQ(given.records[1].camera.world_from_camera.matrix(),
            scene.frames[3].camera.world_from_camera.matrix());
  EXPECT_NE(written.records[1].depth, "");
  // The model's cameras, of which those of the rays are a copy in its own frame.
  asked = with_shipped_model(options("no_scale_rays"));
  asked.outputs = {"image", "depth", "rays", "points"};
  asked.scale_from = {"camera_poses"};
  run(asked);
  const CameraList predicted =
      read_cameras_json(std::filesystem::path(asked.out) / "rays" / "predicted_cameras.json");
  const auto distance = [](const CameraList& list) {
    return (list.records[0].camera.world_from_camera.translation() -
            list.records[3].camera.world_from_camera.translation())
        .norm();
  };
  EXPECT_NEAR(distance(written), distance(predicted), 1e-9);
  EXPECT_EQ(written.records[3].camera.intrinsics, predicted.records[3].camera.intrinsics);
}

// A single source of a scene in metres has the unit that the model guesses of it, with its error.
TEST_F(Sampling, ASingleSourceHasAGuessedUnit) {
  auto asked = options("alone");
  asked.model = (test::source_root() / "configs/tiny").string();
  asked.size = "112x112";
  asked.outputs = {"depth"};
  asked.views.sources = {0};
  const auto report = run(asked);
  ASSERT_EQ(report.at("depth_scale_estimates").size(), 1U);
  ASSERT_TRUE(report.contains("depth_scale"));
  const auto& scale = report.at("depth_scale");
  EXPECT_EQ(scale.at("estimator"), "usual_unit");
  // As sure as the unit, or less where the views beside it change what the head sees of the source.
  const ModelBundle bundle = ModelBundle::open(asked.model);
  const double deviation = read_single_view_unit(bundle)->log_deviation;
  EXPECT_LT(deviation, 0.7 * bundle.options().single_source_unit_deviation);
  EXPECT_GE(std::log(scale.at("interval").at(1).get<double>() / scale.at("scale").get<double>()),
            2 * deviation);
  EXPECT_THAT(report.at("warnings").dump(), HasSubstr("in a unit that the model guesses: "));
  asked.overwrite = true;
  asked.outputs = {"image"};
  EXPECT_THAT(run(asked).at("verdict").at("sentence").get<std::string>(),
              HasSubstr("the model guesses it (16 % nearer or 19 % farther would not surprise)"));
  asked.outputs = {"depth"};
  asked.scale_from = {"sparse_points"};
  const auto untold = run(asked);
  EXPECT_FALSE(untold.contains("depth_scale"));
  EXPECT_TRUE(untold.at("depth_scale_estimates").empty());
}

// Depth that was measured tells the scale when it is asked; a scene without has none to ask.
TEST_F(Sampling, MeasuredDepthOfASourceTellsTheScaleWhenAsked) {
  auto asked = options("measured");
  asked.outputs = {"depth"};
  asked.scale_from = {"source_depth"};
  const auto report = run(asked);
  ASSERT_EQ(report.at("depth_scale_estimates").size(), 1U);
  EXPECT_EQ(report.at("depth_scale_estimates").at(0).at("estimator"), "source_depth");
  // By names as by numbers.
  const Scene scene = open_scene(asked.scene);
  asked.views.sources = {FrameChoice(scene.frames[0].name), FrameChoice(scene.frames[3].name)};
  asked.overwrite = true;
  EXPECT_EQ(run(asked).at("depth_scale_estimates"), report.at("depth_scale_estimates"));
  EXPECT_EQ(
      test::error_of([&] { apply_setting(asked, "views.sources=[0, '', 3]"); }),
      "--sources: expected frame numbers or names, found nothing between two commas; remove one of them.");
  asked.scale_from = {"source_depths"};
  EXPECT_EQ(
      test::error_of([&] { asked.check(); }),
      "--scale-from: expected camera_poses, photographs, sparse_points, source_depth, usual_unit, found "
      "'source_depths'; did you mean 'source_depth'?");
}

TEST_F(Sampling, ThePointCloudFollowsItsOptions) {
  auto asked = options("points");
  asked.outputs = {"points"};
  asked.points.max_points = 50;
  asked.points.confidence_quantile = 0;
  auto report = run(asked);
  EXPECT_LE(report.at("points").at("written").get<int64_t>(), 50);
  EXPECT_GT(report.at("points").at("written").get<int64_t>(), 0);
  EXPECT_EQ(report.at("points").at("low_confidence"), 0);
  asked = options("points_by_rays");
  asked.outputs = {"points"};
  asked.points.lifting = PointLifting::kRays;
  EXPECT_EQ(run(asked).at("points").at("lifted_by"), "rays");
  EXPECT_TRUE(std::filesystem::is_regular_file(std::filesystem::path(asked.out) / "points.ply"));
  const auto described = describe_options(asked);
  EXPECT_TRUE(std::any_of(described.begin(), described.end(),
                          [](const auto& option) { return option.key == "points.max_points"; }));
}

TEST_F(Sampling, OnlyWhatIsAskedForRuns) {
  auto asked = options("image_only");
  asked.outputs = {"image"};
  asked.guidance.guidance_scale = 1;
  const auto report = run(asked);
  EXPECT_THAT(stage_names(report),
              testing::ElementsAre("source encoding", "M1", "cascade", "propagation", "RGB decoding",
                                   "hashing the model", "leave one out", "writing", "contact sheet"));
  for (const auto& flow : report.at("flows")) {
    EXPECT_EQ(flow.at("with_unconditional_branch"), 0);
    EXPECT_EQ(flow.at("velocity_decoder_runs"), 3);
  }
  EXPECT_FALSE(std::filesystem::exists(std::filesystem::path(asked.out) / "depth"));

  asked = options("latents_only");
  asked.outputs = {"latents"};
  const auto without_pictures = run(asked);
  EXPECT_THAT(stage_names(without_pictures),
              testing::ElementsAre("source encoding", "M1", "cascade", "hashing the model", "writing",
                                   "contact sheet"));
  EXPECT_FALSE(without_pictures.contains("verdict"));
}

// preview.png is there while the flows run, has the target views side by side, and goes when the pictures are there.
TEST_F(Sampling, ThePreviewIsThereUntilThePicturesAre) {
  auto asked = options("preview");
  asked.preview = 1;
  asked.solver.evaluations = 12;
  const std::filesystem::path file = std::filesystem::path(asked.out) / "preview.png";
  std::atomic<bool> ended{false};
  Image seen;
  std::thread watcher([&] {
    while (!ended && seen.width == 0) {
      try {
        if (std::filesystem::exists(file)) seen = read_image(file);
      } catch (const Error&) {
        continue;  // gone between the two
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
  });
  EXPECT_NO_THROW(run(asked));
  ended = true;
  watcher.join();
  EXPECT_EQ(seen.width, 2 * 112);
  EXPECT_EQ(seen.height, 56);
  EXPECT_FALSE(std::filesystem::exists(file));
  EXPECT_TRUE(std::filesystem::exists(std::filesystem::path(asked.out) / "images" / "view_02.png"));
}

TEST_F(Sampling, TheSameCommandGivesTheSameBytes) {
  auto first = options("first"), second = options("second"), other = options("other");
  other.seed = 1;
  for (const auto* asked : {&first, &second, &other}) run(*asked);
  const auto bytes = [&](const SampleOptions& asked, const char* file) {
    return read_file(std::filesystem::path(asked.out) / file);
  };
  for (const char* file : {"images/view_02.png", "depth/view_03.pfm", "points.ply", "cameras.json"}) {
    EXPECT_TRUE(bytes(first, file) == bytes(second, file)) << file;
  }
  EXPECT_FALSE(bytes(first, "images/view_02.png") == bytes(other, "images/view_02.png"));
}

TEST_F(Sampling, GuidanceOutsideItsIntervalCostsNothing) {
  auto asked = options("interval");
  asked.outputs = {"latents"};
  asked.guidance.guidance_interval = {0.99, 1};
  const auto report = run(asked);
  EXPECT_EQ(report.at("flows").at(0).at("with_unconditional_branch"), 1);  // the first evaluation, at t = 1
}

TEST_F(Sampling, ExactSavingsChangeNothingBeyondRounding) {
  auto with = options("with_savings"), without = options("without_savings");
  for (auto* asked : {&with, &without}) asked->outputs = {"latents"};
  without.no_skip = exact_saving_names();
  run(with);
  run(without);
  const auto latent = [](const SampleOptions& asked) {
    return read_all(std::filesystem::path(asked.out) / "latents.safetensors").at("level0");
  };
  const auto expected = latent(without);
  const double difference = (latent(with) - expected).abs().max().item<double>();
  EXPECT_LT(difference, 1e-5 * expected.abs().max().item<double>());
  EXPECT_EQ(
      test::error_of([&] {
        without.no_skip = {"prope_tables"};
        without.savings();
      }),
      "--no-skip: expected one of camera_embedding_once, source_embedding_once, shared_noisy_embedding, "
      "cascade_input_once, encoder_reuse, time_rows_once, prope_tables_once, unconditional_constants, "
      "combined_last_linear, found 'prope_tables'; write 'prope_tables_once'.");
}

TEST_F(Sampling, ThePublishedQualityIsTheReleasesSampler) {
  const auto asked = options("unused");
  SampleOptions published = asked;
  published.quality = SamplingQuality::kPublished;
  BundleOptions bundle;
  bundle.generator(level_model(1)).time_shift.evaluation = 31.18;
  const auto resolved = [&](const SampleOptions& options) {
    return flow_settings(options.method(), options.guidance, bundle).solvers[0];
  };
  const SolverOptions solver = resolved(published);
  const auto times = solver_times(solver);
  ASSERT_EQ(times.size(), 50u);
  EXPECT_DOUBLE_EQ(times.front(), 1);
  // t = 0.001 shifted by 31.18, and the time before it: DESIGN.md section 4, "Flow".
  EXPECT_NEAR(times[49], 0.030, 5e-4);
  EXPECT_NEAR(times[48], 0.405, 5e-4);
  EXPECT_EQ(solver.solver, SolverKind::kEuler);
  bundle.generator(level_model(1)).time_shift.evaluation = 5;
  EXPECT_EQ(resolved(asked).schedule.shift, 5);
}

TEST_F(Sampling, AnOrbitNeedsNoTargetFrames) {
  auto asked = options("orbit");
  asked.views.targets.clear();
  asked.views.path.path = "orbit";
  asked.views.path.frames = 3;
  asked.outputs = {"image"};
  const auto report = run(asked);
  EXPECT_EQ(report.at("scene").at("views").size(), 5u);
  EXPECT_FALSE(report.contains("against_truth"));
}

}  // namespace
}  // namespace gld
