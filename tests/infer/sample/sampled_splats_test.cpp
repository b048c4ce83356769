// gld sample --outputs splats beside gld splat fit --run.
#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/splatting/splat_ply.h"
#include "infer/forecast/splat_forecast.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/error_of.h"
#include "train/splats/splat_command.h"

#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

class SampledSplats : public test::Sampling {};

TEST_F(SampledSplats, AreThoseOfAFitToTheRun) {
  auto asked = with_shipped_model(options("splats"));
  asked.outputs = {"splats"};
  asked.splats.fit.steps = 12;
  asked.splats.fit.density.most_gaussians = 3000;
  asked.seed = 4;
  const auto report = run(asked);
  const std::filesystem::path out = asked.out;
  const GaussianSet set = read_splat_ply(out / kSplatFile);
  EXPECT_EQ(report.at("splats").at("gaussians").at("at_last"), set.size());
  EXPECT_EQ(report.at("splats").at("views"), 4);
  EXPECT_THAT(stage_names(report), testing::Contains(kSplatStage));
  // The plan names the stage and says what it takes.
  const auto& stages = report.at("plan");
  EXPECT_EQ(stages.back().at("stage"), kSplatStage);
  EXPECT_EQ(stages.back().at("evaluations"), 12);
  EXPECT_GT(stages.back().at("predicted_seconds").get<double>(), 0);
  EXPECT_GT(stages.back().at("predicted_peak_bytes").get<int64_t>(), 0);

  SplatCommandOptions fit;
  fit.run = asked.out;
  fit.out = (folder_->path() / "splats_of_run").string();
  fit.side = asked.splats.side;
  fit.fit = asked.splats.fit;
  fit.seed = asked.seed;
  fit.threads = 2;
  testing::internal::CaptureStdout();
  run_splat_fit(fit);
  testing::internal::GetCapturedStdout();
  EXPECT_EQ(read_file(out / kSplatFile), read_file(std::filesystem::path(fit.out) / kSplatFile));
}

TEST_F(SampledSplats, AreLeftOutWhereDepthHasNoPlace) {
  auto asked = options("splats_without_depth");
  asked.outputs = {"image", "splats"};
  asked.splats.fit.steps = 1;
  asked.scale_from = {"camera_poses"};
  const auto report = run(asked);
  // A random model's rays fit no camera.
  const bool has_depth =
      !read_cameras_json(std::filesystem::path(asked.out) / "cameras.json").records[0].depth.empty();
  EXPECT_FALSE(has_depth);
  EXPECT_EQ(std::filesystem::exists(std::filesystem::path(asked.out) / kSplatFile), has_depth);
  EXPECT_EQ(report.at("warnings").dump().find("splats.ply is left out") == std::string::npos, has_depth);
}

TEST_F(SampledSplats, AreRefusedWhereNothingWouldComeOfThem) {
  auto asked = options("never");
  asked.outputs = {"image"};
  asked.named = {"splats.side"};
  EXPECT_EQ(test::error_of([&] { asked.check(); }),
            "--side: expected splats among --outputs, without which nothing looks at it, found none; add it, "
            "or leave --side out.");
}

// Their depth is smaller than they are, and what is to be expected is of the large ones.
TEST_F(SampledSplats, AreFittedToPicturesAsLargeAsPhotographs) {
  SyntheticOptions room;
  room.width = room.height = 224;
  room.frames = 4;
  const auto scene = folder_->path() / "large_room";
  write_scene(make_synthetic_scene(room, 0), "cameras-json", scene);
  auto asked = with_shipped_model(options("large"));
  asked.scene = scene.string();
  asked.outputs = {"splats", "page"};
  asked.splats.fit.steps = 5;
  asked.size = "photographs";
  const auto report = run(asked);
  EXPECT_EQ(report.at("scene").at("width"), 112);
  EXPECT_EQ(report.at("splats").at("steps"), 5);
  EXPECT_THAT(report.at("plan").back().at("reason").get<std::string>(),
              testing::HasSubstr("views of 224x224"));
  const std::filesystem::path out = asked.out;
  EXPECT_TRUE(std::filesystem::exists(out / kDepthCamerasFile));
  EXPECT_GT(read_splat_ply(out / kSplatFile).size(), 0);
  for (const char* folder : {"images", "truth"}) {
    const std::filesystem::path first = *std::filesystem::directory_iterator(out / folder);
    EXPECT_EQ(read_image(first).width, 224) << folder;
  }
}

}  // namespace
}  // namespace gld
