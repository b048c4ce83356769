#include "models/splats/splatted_scene.h"

#include "gld/base/error.h"
#include "gld/base/json_text.h"
#include "gld/base/sha256.h"
#include "gld/cameras/camera_checks.h"
#include "gld/tensors/weight_tensors.h"

#include <algorithm>
#include <map>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kExtension = ".safetensors";
constexpr const char* kSceneKey = "gld:scene";
constexpr const char* kFittedKey = "gld:fitted";
constexpr const char* kTagKey = "gld:latent_space";

template <class Matrix>
torch::Tensor matrix_tensor(const Matrix& matrix) {
  torch::Tensor values = torch::empty({matrix.rows(), matrix.cols()}, torch::kFloat64);
  auto to = values.accessor<double, 2>();
  for (int row = 0; row < matrix.rows(); ++row) {
    for (int column = 0; column < matrix.cols(); ++column) to[row][column] = matrix(row, column);
  }
  return values;
}

template <class Matrix>
Matrix matrix_of(const torch::Tensor& values) {
  Matrix matrix;
  const auto from = values.accessor<double, 2>();
  for (int row = 0; row < matrix.rows(); ++row) {
    for (int column = 0; column < matrix.cols(); ++column) matrix(row, column) = from[row][column];
  }
  return matrix;
}

[[noreturn]] void fail_at(const std::filesystem::path& file, const std::string& expected,
                          const std::string& found) {
  fail({file.string(), expected, found, "make it again with gld splat pairs"});
}

const std::string& required_note(const WeightFile& file, const char* key) {
  const auto found = file.metadata().find(key);
  if (found == file.metadata().end()) fail_at(file.path(), fmt::format("{} in its metadata", key), "none");
  return found->second;
}

torch::Tensor tensor_like(const WeightFile& file, const char* name, torch::Dtype dtype, int64_t dimensions) {
  if (file.find(name) == nullptr) fail_at(file.path(), fmt::format("a tensor {}", name), "none");
  auto tensor = read_tensor(file, name);
  if (tensor.scalar_type() != dtype || tensor.dim() != dimensions) {
    fail_at(file.path(),
            fmt::format("{} of {} dimensions and type {}", name, dimensions, c10::toString(dtype)),
            fmt::format("shape {}, {}", c10::str(tensor.sizes()), c10::toString(tensor.scalar_type())));
  }
  return tensor;
}

LatentTag tag_of(const std::filesystem::path& file, const std::string& text) {
  const auto tag = tag_of_json(nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false));
  if (!tag) fail_at(file, "the latent space that gld splat pairs writes", "something else");
  return *tag;
}

}  // namespace

void save_splatted_scene(const std::filesystem::path& file, const SplattedScene& scene) {
  std::vector<torch::Tensor> intrinsics, poses;
  for (const Camera& camera : scene.cameras) {
    intrinsics.push_back(matrix_tensor(camera.intrinsics));
    poses.push_back(matrix_tensor(camera.world_from_camera.matrix()));
  }
  const std::map<std::string, torch::Tensor> tensors = {{"pictures", scene.pictures},
                                                        {"encoded", scene.encoded.to(torch::kFloat16)},
                                                        {"splatted", scene.splatted.to(torch::kFloat16)},
                                                        {"colours", scene.colours.to(torch::kFloat16)},
                                                        {"intrinsics", torch::stack(intrinsics)},
                                                        {"world_from_camera", torch::stack(poses)}};
  save_safetensors(file, tensors,
                   {{kSceneKey, scene.name},
                    {kFittedKey, std::to_string(scene.fitted)},
                    {kTagKey, json_text(tag_json(scene.tag))}});
}

SplattedScene read_splatted_scene(const std::filesystem::path& file) {
  const auto weights = WeightFile::open(file);
  SplattedScene scene;
  scene.name = required_note(*weights, kSceneKey);
  scene.tag = tag_of(file, required_note(*weights, kTagKey));
  scene.pictures = tensor_like(*weights, "pictures", torch::kUInt8, 4);
  scene.encoded = tensor_like(*weights, "encoded", torch::kFloat16, 4);
  scene.splatted = tensor_like(*weights, "splatted", torch::kFloat16, 4);
  scene.colours = tensor_like(*weights, "colours", torch::kFloat16, 4);
  const auto intrinsics = tensor_like(*weights, "intrinsics", torch::kFloat64, 3);
  const auto poses = tensor_like(*weights, "world_from_camera", torch::kFloat64, 3);
  const int64_t views = scene.pictures.size(0);
  scene.fitted = views - scene.splatted.size(0);
  const auto expect = [&](bool holds, const std::string& expected, at::IntArrayRef found) {
    if (!holds) fail_at(file, expected, c10::str(found));
  };
  expect(views > 0 && scene.pictures.size(1) == 3 && scene.pictures.numel() > 0,
         "pictures (views, 3, height, width)", scene.pictures.sizes());
  expect(scene.encoded.sizes().equals({views, scene.tag.channels, scene.tag.height, scene.tag.width}),
         fmt::format("encoded latents of {} views, {} channels and {}x{} pixels", views, scene.tag.channels,
                     scene.tag.width, scene.tag.height),
         scene.encoded.sizes());
  expect(scene.fitted > 0 && scene.splatted.size(0) > 0 &&
             scene.splatted.sizes().slice(1).equals(scene.encoded.sizes().slice(1)),
         "splatted latents of some of the views", scene.splatted.sizes());
  expect(intrinsics.sizes().equals({views, 3, 3}), fmt::format("intrinsics of {} views", views),
         intrinsics.sizes());
  expect(poses.sizes().equals({views, 4, 4}), fmt::format("world_from_camera of {} views", views),
         poses.sizes());
  if (required_note(*weights, kFittedKey) != std::to_string(scene.fitted)) {
    fail_at(file, fmt::format("{} fitted views, those that are not splatted", scene.fitted),
            required_note(*weights, kFittedKey) + " in gld:fitted");
  }
  expect(scene.colours.sizes().equals(scene.splatted.sizes()),
         "colours of the shape of splatted latents, " + c10::str(scene.splatted.sizes()),
         scene.colours.sizes());
  for (const auto& latents : {scene.encoded, scene.splatted, scene.colours}) {
    if (!latents.isfinite().all().item<bool>()) fail_at(file, "finite latents", "NaN or infinity");
  }
  for (int64_t view = 0; view < views; ++view) {
    Camera camera;
    camera.width = scene.pictures.size(3);
    camera.height = scene.pictures.size(2);
    camera.intrinsics = matrix_of<Eigen::Matrix3d>(intrinsics[view]);
    camera.world_from_camera.matrix() = matrix_of<Eigen::Matrix4d>(poses[view]);
    check_camera(camera, fmt::format("{}, view {}", file.string(), view));
    scene.cameras.push_back(camera);
  }
  return scene;
}

std::vector<std::filesystem::path> splatted_scene_files(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  if (std::filesystem::is_directory(folder)) {
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      const bool partial = entry.path().filename().string().front() == '.';
      if (entry.path().extension() == kExtension && !partial) files.push_back(entry.path());
    }
  }
  std::sort(files.begin(), files.end());
  if (files.empty()) {
    fail({folder.string(), "splatted scenes, files *.safetensors",
          std::filesystem::is_directory(folder) ? "none" : "no such folder",
          "make them with gld splat pairs, and name its folder pairs/"});
  }
  return files;
}

void require_same_latent_space(const LatentTag& tag, const ModelBundle& bundle, const std::string& where) {
  const std::string hash = sha256_of_file(bundle.file(BundlePart::backbone()));
  if (tag.backbone_hash != hash) {
    fail({where,
          fmt::format("latents of the backbone of {}, {}", bundle.folder().string(), hash.substr(0, 12)),
          fmt::format("those of {}, {}", tag.model, tag.backbone_hash.substr(0, 12)),
          "make them again with this model"});
  }
}

void require_same_normalisation(const LatentTag& tag, const ModelBundle& bundle, const std::string& where) {
  require_same_latent_space(tag, bundle, where);
  const auto statistics = bundle.file(BundlePart::statistics(tag.level));
  const std::string hash =
      bundle.has(BundlePart::statistics(tag.level)) ? sha256_of_file(statistics) : std::string("none");
  if (tag.statistics_hash != hash) {
    fail({where, fmt::format("latents normalised by {}, {}", statistics.string(), hash.substr(0, 12)),
          tag.statistics_hash.empty() ? tag.statistics : tag.statistics_hash.substr(0, 12),
          "make them again with this model"});
  }
}

}  // namespace gld
