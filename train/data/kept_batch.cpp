#include "train/data/kept_batch.h"

#include <algorithm>

#include <fmt/format.h>

namespace gld {
namespace {

// Cameras as rows of numbers: the pose (4x4), the intrinsics (3x3), width and height.
constexpr int64_t kPose = 16, kIntrinsics = 9, kCamera = kPose + kIntrinsics + 2;

torch::Tensor rows_of(const std::vector<Camera>& cameras) {
  auto rows = torch::empty({static_cast<int64_t>(cameras.size()), kCamera}, torch::kFloat64);
  auto* row = rows.data_ptr<double>();
  for (const Camera& camera : cameras) {
    row = std::copy_n(camera.world_from_camera.data(), kPose, row);
    row = std::copy_n(camera.intrinsics.data(), kIntrinsics, row);
    *row++ = static_cast<double>(camera.width);
    *row++ = static_cast<double>(camera.height);
  }
  return rows;
}

std::vector<Camera> cameras_of(const torch::Tensor& rows) {
  std::vector<Camera> cameras(static_cast<size_t>(rows.size(0)));
  const auto* row = rows.data_ptr<double>();
  for (Camera& camera : cameras) {
    std::copy_n(row, kPose, camera.world_from_camera.data());
    std::copy_n(row + kPose, kIntrinsics, camera.intrinsics.data());
    camera.width = static_cast<int64_t>(row[kPose + kIntrinsics]);
    camera.height = static_cast<int64_t>(row[kPose + kIntrinsics + 1]);
    row += kCamera;
  }
  return cameras;
}

std::optional<TrainingScene> scene_of(const KeptThing& kept, const std::string& scene_key) {
  const auto named = [&](const char* name) {
    const auto found = kept.tensors.find(scene_key + name);
    return found == kept.tensors.end() ? torch::Tensor() : found->second;
  };
  const auto name = kept.text.find(scene_key + "name");
  const auto cameras = named("cameras"), images = named("images"), facts = named("facts");
  if (name == kept.text.end() || !cameras.defined() || !images.defined() || !facts.defined())
    return std::nullopt;
  TrainingScene scene;
  scene.name = name->second;
  scene.views.cameras = cameras_of(cameras);
  scene.views.num_sources = facts[0].item<int64_t>();
  scene.metric = facts[1].item<int64_t>() != 0;
  scene.images = images.to(torch::kFloat32).div(255);
  scene.depth = named("depth");
  return scene;
}

}  // namespace

KeptThing kept_batch(const TrainingBatch& batch) {
  KeptThing kept;
  kept.text["scenes"] = std::to_string(batch.scenes.size());
  for (size_t i = 0; i < batch.scenes.size(); ++i) {
    const TrainingScene& scene = batch.scenes[i];
    const std::string key = fmt::format("{}.", i);
    kept.text[key + "name"] = scene.name;
    kept.tensors[key + "cameras"] = rows_of(scene.views.cameras);
    kept.tensors[key + "images"] = scene.images.mul(255).round().to(torch::kUInt8);
    kept.tensors[key + "facts"] =
        torch::tensor({scene.views.num_sources, int64_t{scene.metric}}, torch::kInt64);
    if (scene.depth.defined()) kept.tensors[key + "depth"] = scene.depth;
  }
  return kept;
}

std::optional<TrainingBatch> batch_of(const KeptThing& kept, int64_t index) {
  const auto count = kept.text.find("scenes");
  if (count == kept.text.end()) return std::nullopt;
  TrainingBatch batch;
  batch.index = index;
  for (size_t i = 0; std::to_string(i) != count->second; ++i) {
    auto scene = scene_of(kept, fmt::format("{}.", i));
    if (!scene) return std::nullopt;
    batch.scenes.push_back(std::move(*scene));
  }
  return batch;
}

}  // namespace gld
