// What gld sample writes, with the shipped model, is what gld export reads.
#include "cli/commands.h"
#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "gld/base/configuration.h"
#include "infer/run_export/finished_run.h"
#include "tests/infer/run_export/gltf_file.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/error_of.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using ::testing::HasSubstr;

using ExportCommand = test::Sampling;

struct Ended {
  int status = 0;
  std::string out;
  std::string errors;
};

Ended ended_of(const std::vector<std::string>& arguments) {
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  Ended ended;
  ended.status = run_command_line(all_commands(), arguments);
  ended.out = ::testing::internal::GetCapturedStdout();
  ended.errors = ::testing::internal::GetCapturedStderr();
  return ended;
}

TEST_F(ExportCommand, TakesARunOfGldSample) {
  SampleOptions sampled = with_shipped_model(options("run"));
  const auto report = run(sampled);
  const std::string out = (folder_->path() / "exported").string();
  const Ended ended =
      ended_of({"export", sampled.out, "--as", "glb,colmap,nerfstudio,webp", "--between", "1", "--out", out});
  ASSERT_EQ(ended.status, 0) << ended.errors;
  const test::GltfFile gltf = test::read_gltf(std::filesystem::path(out) / "scene.glb");
  test::expect_valid_gltf(gltf);
  EXPECT_EQ(gltf.json.at("asset").at("extras").at("gld:model"), report.at("model").at("hash"));
  EXPECT_EQ(gltf.count("cameras"), 4U);
  const CameraList cameras = read_cameras_json(std::filesystem::path(sampled.out) / "cameras.json");
  for (const char* format : {"colmap", "nerfstudio"}) {
    const Scene scene = open_scene(std::filesystem::path(out) / format);
    ASSERT_EQ(scene.frames.size(), cameras.records.size());
    for (size_t i = 0; i < scene.frames.size(); ++i) {
      const Camera &expected = cameras.records[i].camera, &found = scene.frames[i].camera;
      EXPECT_LT(
          (found.world_from_camera.matrix() - expected.world_from_camera.matrix()).cwiseAbs().maxCoeff(),
          1e-12);
      EXPECT_LT((found.intrinsics - expected.intrinsics).cwiseAbs().maxCoeff(), 1e-12);
    }
  }
  // The written configuration repeats it, and a flag names the run as well.
  const std::string again = (folder_->path() / "again").string();
  EXPECT_EQ(ended_of({"export", "--config", out + "/config.yaml", "--out", again}).status, 0);
  EXPECT_EQ(read_file(std::filesystem::path(again) / "scene.glb") ==
                read_file(std::filesystem::path(out) / "scene.glb"),
            true);
  const Ended twice =
      ended_of({"export", sampled.out, "--run", "elsewhere", "--as", "glb", "--out", again + "2"});
  EXPECT_NE(twice.status, 0);
  EXPECT_THAT(twice.errors, HasSubstr("--run: expected one run folder, found two; name it once."));
}

}  // namespace
}  // namespace gld
