#include "infer/evaluate/pose_estimation.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/cameras/pose_encoding.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/evaluate/evaluation.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/random_cameras.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

TEST(PoseEstimation, DecodedCamerasAreThoseOfTheEncodings) {
  test::RandomCameras random(6);
  std::vector<Camera> cameras;
  GeometryOutput geometry;
  geometry.camera_encodings = torch::empty({3, 9}, torch::kFloat64);
  for (int64_t view = 0; view < 3; ++view) {
    cameras.push_back(random.ordinary(84, 56));
    const PoseEncoding encoding = pose_encoding(cameras.back());
    for (size_t i = 0; i < encoding.size(); ++i)
      geometry.camera_encodings[view][static_cast<int64_t>(i)] = encoding[i];
  }
  // Rays, of which there are none, are not looked at.
  const auto estimated = estimated_cameras(PoseEstimator::kDa3Decoder, geometry, cameras);
  ASSERT_EQ(estimated.size(), 3U);
  for (size_t view = 0; view < 3; ++view) {
    EXPECT_LT((estimated[view].world_from_camera.matrix() - cameras[view].world_from_camera.matrix()).norm(),
              1e-12);
    EXPECT_NEAR(estimated[view].intrinsics(0, 0), cameras[view].intrinsics(0, 0), 1e-9);
    EXPECT_EQ(estimated[view].intrinsics(0, 2), 42);  // not the given principal point: the decoder knows none
  }
  EXPECT_EQ(
      test::error_of([&] { estimated_cameras(PoseEstimator::kDa3Decoder, {}, cameras); }),
      "pose estimation: expected cameras of a camera decoder, found none; choose another one for --poses.");
}

// Of another model that looks at the pictures, and of the model's own levels.
TEST(PoseEstimation, EvaluationMeasuresTheCamerasOfADecoder) {
  const test::TemporaryFolder folder;
  EvaluationOptions asked;
  asked.model = (folder.path() / "model").string();
  asked.out = (folder.path() / "eval").string();
  asked.synthetic = 1;
  asked.generator.frames = 8;
  asked.generator.width = asked.generator.height = 56;
  asked.solver.evaluations = 1;
  asked.views.shortest_interval = asked.views.longest_interval = 1;
  asked.threads = 1;
  asked.pictures = 0;
  asked.poses = PoseEstimator::kDa3Decoder;
  BundleOptions seeing = small_bundle_options();
  seeing.trained_sizes = {"56x56"};
  write_random_bundle(asked.model, seeing, 7);
  EXPECT_EQ(
      test::error_of([&] { evaluate(asked); }),
      "--poses da3_decoder: expected a model with DA3's camera decoder, found the head of kind da3 without one; "
      "name a bundle with dpt_head.camera_decoder: true with --pose-model, or choose another estimator.");

  apply_setting(seeing, "dpt_head.camera_decoder=true");
  const auto model = folder.path() / "decoder_model";
  write_random_bundle(model, seeing, 7);
  // The lenses have a focal length, whatever the random weights say.
  auto tensors = read_all(model / "dpt_head.safetensors");
  tensors["cam_dec.fc_fov.0.bias"] = torch::ones({2});
  tensors["cam_dec.fc_fov.0.weight"] = tensors.at("cam_dec.fc_fov.0.weight") * 0.01;
  save_safetensors(model / "dpt_head.safetensors", tensors);
  const auto protocol = [&] {
    asked.overwrite = true;
    testing::internal::CaptureStdout();
    testing::internal::CaptureStderr();
    evaluate(asked);
    testing::internal::GetCapturedStdout();
    testing::internal::GetCapturedStderr();
    const auto report = nlohmann::json::parse(read_file(std::filesystem::path(asked.out) / "report.json"));
    EXPECT_EQ(report.at("means").at("reprojection_baseline_ratio").at("scenes"), 1);
    return report.at("protocol");
  };
  asked.pose_model = model.string();
  EXPECT_EQ(protocol().at("poses_from"), model.string());
  asked.pose_model.clear();
  asked.model = model.string();
  EXPECT_EQ(protocol().at("poses_from"), "the model's own geometry head");
  EXPECT_EQ(protocol().at("poses"), "da3_decoder");
}

}  // namespace
}  // namespace gld
