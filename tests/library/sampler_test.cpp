#include "library/sampler.h"

#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using sampler::SampleCallbacks;
using sampler::SampleProgress;
using sampler::SampleRequest;
using sampler::SamplerError;
using testing::HasSubstr;

std::string tiny_model() { return (test::source_root() / "configs/tiny").string(); }

Scene drawn_room() {
  SyntheticOptions options;
  options.seed = 910002;
  options.frames = 4;
  return make_synthetic_scene(options, 0);
}

sampler::PinholeCamera camera_of(const Camera& camera) {
  sampler::PinholeCamera made;
  made.width = camera.width;
  made.height = camera.height;
  made.focal_x = camera.intrinsics(0, 0);
  made.focal_y = camera.intrinsics(1, 1);
  made.centre_x = camera.intrinsics(0, 2);
  made.centre_y = camera.intrinsics(1, 2);
  for (size_t i = 0; i < 16; ++i) {
    made.world_from_camera[i] =
        camera.world_from_camera.matrix()(static_cast<int>(i / 4), static_cast<int>(i % 4));
  }
  return made;
}

// Frames 0 and 3 are given, 1 is asked for.
SampleRequest request_of(const Scene& scene) {
  SampleRequest request;
  request.model = tiny_model();
  for (const size_t source : {0, 3}) {
    const Image image = scene.frames[source].image();
    request.sources.push_back({{image.width, image.height, {image.rgb.begin(), image.rgb.end()}},
                               camera_of(scene.frames[source].camera)});
  }
  request.targets.push_back(camera_of(scene.frames[1].camera));
  request.seed = 5;
  request.options = {{"solver.evaluations", "2"}, {"photograph_use.generate_complete", "true"}};
  return request;
}

std::string message_of(const SampleRequest& request) {
  try {
    sampler::sample(request);
  } catch (const SamplerError& error) {
    return error.what();
  }
  return "no error";
}

TEST(SamplerLibrary, MakesThePicturesOfTheProgram) {
  const Scene scene = drawn_room();
  const auto result = sampler::sample(request_of(scene));
  ASSERT_TRUE(result.has_value());
  ASSERT_EQ(result->views.size(), 1U);
  EXPECT_EQ(result->sources.size(), 2U);
  EXPECT_FALSE(result->verdict.empty());
  EXPECT_GT(result->seconds, 0);

  const test::TemporaryFolder folder;
  write_scene(scene, "cameras-json", folder.path() / "scene");
  const auto out = folder.path() / "out", log = folder.path() / "log";
  ASSERT_EQ(
      run_program({GLD_PROGRAM, "sample", "--model", tiny_model(), "--scene",
                   (folder.path() / "scene").string(), "--sources", "0,3", "--targets", "1", "--seed", "5",
                   "--evaluations", "2", "--generate-complete", "--outputs", "image", "--out", out.string()},
                  log, "test"),
      0)
      << read_file(log);
  const Image by_program = read_image(out / "images/view_02.png");
  const sampler::Picture& picture = result->views[0].picture;
  ASSERT_EQ(picture.width, by_program.width);
  EXPECT_TRUE(
      std::equal(picture.rgb.begin(), picture.rgb.end(), by_program.rgb.begin(), by_program.rgb.end()));
  EXPECT_NEAR(result->views[0].camera.focal_x, scene.frames[1].camera.intrinsics(0, 0), 1e-9);
}

TEST(SamplerLibrary, StopsWithinAStepWhereItsCallerSaysSo) {
  auto request = request_of(drawn_room());
  request.options[0].second = "12";
  std::vector<int64_t> steps;
  SampleCallbacks callbacks;
  callbacks.progress = [&](const SampleProgress& progress) {
    steps.push_back(progress.step);
    EXPECT_EQ(progress.steps, 12);
    return progress.step < 3;
  };
  EXPECT_FALSE(sampler::sample(request, callbacks).has_value());
  EXPECT_THAT(steps, testing::ElementsAre(0, 1, 2, 3));
}

// A solver that evaluates the model several times a step, or rejects steps, is stopped before its next evaluation.
TEST(SamplerLibrary, IsCancelledWithinAnEvaluation) {
  const Scene scene = drawn_room();
  for (const char* solver : {"rk4", "dp54"}) {
    auto request = request_of(scene);
    const bool adaptive = std::string(solver) == "dp54";
    request.options[0] = adaptive ? std::pair<std::string, std::string>{"solver.tolerance", "1e-4"}
                                  : std::pair<std::string, std::string>{"solver.evaluations", "12"};
    request.options.push_back({"solver.solver", solver});
    bool began = false;
    int64_t asked = 0, steps = 0;
    SampleCallbacks callbacks;
    callbacks.progress = [&](const SampleProgress& progress) {
      began = true;
      steps = std::max(steps, progress.step);
      return true;
    };
    callbacks.cancelled = [&] { return began && ++asked > 3; };
    EXPECT_FALSE(sampler::sample(request, callbacks).has_value()) << solver;
    EXPECT_EQ(asked, 4) << solver;
    EXPECT_EQ(steps, 0) << solver << " had ended its first step";
  }
}

TEST(SamplerLibrary, PrintsNothing) {
  const Scene scene = drawn_room();
  const test::TemporaryFolder folder;
  SampleRequest of_photographs;
  of_photographs.model = tiny_model();
  of_photographs.path_views = 1;
  of_photographs.options = {{"solver.evaluations", "1"}};
  for (const size_t frame : {0, 1, 3}) {
    const auto file = folder.path() / ("photograph" + std::to_string(frame) + ".png");
    write_png(file, scene.frames[frame].image());
    of_photographs.photographs.push_back(file.string());
  }
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  sampler::sample(request_of(scene));
  const std::string said = message_of(of_photographs);
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "");
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  EXPECT_EQ(said, "no error");
}

TEST(SamplerLibrary, ShowsWhatItWouldEndWith) {
  auto request = request_of(drawn_room());
  request.options[0].second = "4";
  std::vector<std::string> stages;
  SampleCallbacks callbacks;
  callbacks.preview_every = 2;
  callbacks.preview = [&](const std::string& stage, const std::vector<sampler::Picture>& views) {
    stages.push_back(stage);
    ASSERT_EQ(views.size(), 1U);
    EXPECT_EQ(views[0].width, 112);
    EXPECT_EQ(views[0].rgb.size(), size_t{3} * 112 * 112);
  };
  ASSERT_TRUE(sampler::sample(request, callbacks).has_value());
  EXPECT_EQ(stages.size(), 2U) << "half way through M1 and the cascade";
}

TEST(SamplerLibrary, SaysWhatIsWrongInASentence) {
  const Scene scene = drawn_room();
  EXPECT_THAT(message_of(SampleRequest()),
              HasSubstr("expected either photographs, or sources and targets, found nothing"));
  auto request = request_of(scene);
  request.photographs = {"a.jpg"};
  EXPECT_THAT(message_of(request), HasSubstr("found both"));
  request = request_of(scene);
  request.model = "/nowhere";
  EXPECT_THAT(message_of(request), HasSubstr("/nowhere"));
  request = request_of(scene);
  request.sources[1].picture.rgb.pop_back();
  EXPECT_THAT(message_of(request),
              HasSubstr("source_1: expected a picture of at least 2x2 pixels with 3 bytes for each"));
  request = request_of(scene);
  request.sources[0].camera.width = 64;
  EXPECT_THAT(message_of(request),
              HasSubstr("source_0: expected a picture of the camera's size, 64x112, found 112x112"));
  request = request_of(scene);
  request.options = {{"outputs", "[depth]"}};
  EXPECT_THAT(message_of(request), HasSubstr("that write no file, found outputs; leave it out"));
  request.options = {{"solver.evaluatoins", "3"}};
  EXPECT_THAT(message_of(request), HasSubstr("solver.evaluations"));
}

}  // namespace
}  // namespace gld
