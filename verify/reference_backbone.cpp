#include "gld/base/error.h"
#include "models/backbones/backbone_registry.h"
#include "models/weights/weight_loading.h"
#include "verify/reference_runners.h"

#include <algorithm>
#include <string>
#include <vector>

namespace gld {
namespace {

std::string level_name(const std::string& group, int64_t level) {
  return group + ".level" + std::to_string(level);
}

// Returns the deepest level of that group that the case compares; -1 for none.
int64_t deepest_level(const ReferenceCase& reference, const std::string& group, int64_t levels) {
  for (int64_t level = levels - 1; level >= 0; --level) {
    if (reference.expects_prefix(level_name(group, level))) return level;
  }
  return -1;
}

void encode_group(const ReferenceCase& reference, const Backbone& backbone, const std::string& group,
                  const torch::Tensor& images, NamedTensors& outputs) {
  const int64_t deepest = deepest_level(reference, group, backbone.architecture().levels());
  if (deepest < 0) return;
  const auto levels = backbone.encode(images, deepest);
  const int64_t leading = backbone.architecture().leading_tokens();
  for (size_t level = 0; level < levels.size(); ++level) {
    const auto name = level_name(group, static_cast<int64_t>(level));
    outputs[name] = levels[level];
    outputs[name + ".patches"] = levels[level].slice(1, leading);
    outputs[name + ".special"] = levels[level].narrow(1, 0, leading);
  }
}

// Cases of one level name its kinds of tokens: class, registers, patches.
void encode_tokens(const ReferenceCase& reference, const Backbone& backbone, const torch::Tensor& images,
                   NamedTensors& outputs) {
  if (!reference.expects("patch_tokens")) return;
  const int64_t leading = backbone.architecture().leading_tokens();
  const auto tokens = backbone.encode(images, backbone.architecture().levels() - 1).back();
  outputs["class_token"] = tokens.select(1, 0);
  outputs["register_tokens"] = tokens.slice(1, 1, leading);
  outputs["patch_tokens"] = tokens.slice(1, leading);
}

// Returns the case's cameras, which are those of its images.
std::vector<Camera> known_cameras(const ReferenceCase& reference, const torch::Tensor& images) {
  const int64_t views = images.size(0);
  const auto poses = reference.input("camera_from_world", {views, 4, 4}).to(torch::kFloat64).contiguous();
  const auto intrinsics = reference.input("intrinsics", {views, 3, 3}).to(torch::kFloat64).contiguous();
  std::vector<Camera> cameras;
  for (int64_t view = 0; view < views; ++view) {
    using Pose = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
    using Pixels = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
    Camera camera;
    camera.height = images.size(2);
    camera.width = images.size(3);
    camera.intrinsics = Eigen::Map<const Pixels>(intrinsics[view].data_ptr<double>());
    Eigen::Isometry3d camera_from_world;
    camera_from_world.matrix() = Eigen::Map<const Pose>(poses[view].data_ptr<double>());
    camera.world_from_camera = camera_from_world.inverse();
    cameras.push_back(camera);
  }
  return cameras;
}

void encode_known_cameras(const ReferenceCase& reference, const Backbone& backbone,
                          const torch::Tensor& images, NamedTensors& outputs) {
  const int64_t deepest = deepest_level(reference, "known_cameras", backbone.architecture().levels());
  if (deepest < 0) return;
  const auto levels = backbone.encode_with_cameras(images, deepest, known_cameras(reference, images));
  for (size_t level = 0; level < levels.size(); ++level) {
    outputs[level_name("known_cameras", static_cast<int64_t>(level))] = levels[level];
  }
}

// Leading tokens and patches are one input, or one each.
torch::Tensor propagation_input(const ReferenceCase& reference, int64_t level, int64_t channels) {
  const auto number = std::to_string(level);
  const auto whole = "propagate_input_level" + number, patches = "propagate_patches_level" + number;
  if (reference.inputs.count(whole) > 0) return reference.module_input(whole, {-1, -1, channels});
  if (reference.inputs.count(patches) == 0) return {};
  return torch::cat({reference.module_input("propagate_special_level" + number, {-1, -1, channels}),
                     reference.module_input(patches, {-1, -1, channels})},
                    1);
}

}  // namespace

NamedTensors run_backbone_case(const ReferenceCase& reference) {
  BackboneOptions options;
  reference.read_config(options);
  const auto backbone = options.make(reference.placement());
  WeightSelection selection;
  selection.prefix = options.architecture().published_prefix();
  selection.elsewhere = options.architecture().published_elsewhere();
  load_strict(*backbone, reference.weight_file(), selection);
  reference.apply_precision(*backbone, ModelKind::kRunOnce);

  const auto images = reference.module_input("images", {-1, 3, -1, -1});
  NamedTensors outputs;
  encode_group(reference, *backbone, "all_views", images, outputs);
  if (reference.expects_prefix("source_views.")) {
    const int64_t sources = reference.integer_input("num_sources");
    if (sources < 1 || sources > images.size(0)) {
      fail({(reference.folder / "inputs.safetensors").string() + ": num_sources",
            "1 to " + std::to_string(images.size(0)), std::to_string(sources), "repair the inputs"});
    }
    encode_group(reference, *backbone, "source_views", images.slice(0, 0, sources), outputs);
  }
  encode_group(reference, *backbone, "first_view", images.slice(0, 0, 1), outputs);
  encode_tokens(reference, *backbone, images, outputs);
  encode_known_cameras(reference, *backbone, images, outputs);

  for (int64_t level = 0; level < options.levels(); ++level) {
    PropagationStart start;
    start.level = level;
    start.tokens = propagation_input(reference, level, options.level_channels());
    if (!start.tokens.defined()) continue;
    start.grid = options.grid_of(start.tokens.size(0), images.size(2), images.size(3));
    auto reached = level;
    for (const auto& propagated : backbone->propagate(start)) {
      const auto prefix = level_name("propagated", reached++);
      outputs[prefix + ".cls"] = propagated.leading.select(1, 0);
      outputs[prefix + ".patches"] = propagated.patches;
    }
  }
  return outputs;
}

}  // namespace gld
