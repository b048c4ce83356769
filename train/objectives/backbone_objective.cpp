#include "train/objectives/backbone_objective.h"

#include "gld/base/error.h"
#include "gld/metrics/image_metrics.h"
#include "models/layers/imagenet.h"
#include "models/layers/initialisation.h"
#include "train/objectives/feature_noise.h"
#include "train/objectives/scene_pixels.h"

#include <algorithm>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {

void BackboneObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor,
               {"training", "from_scratch (backbone and DPT head) or head_only (goes on with the bundle's)"},
               training, {"from_scratch", "head_only"});
  visitor.group({"loss", "weights of the geometry losses"}, loss);
  visitor.reals({"pixel_weights", "weight of the pixel error read off each level, from level 0"},
                pixel_weights, {0.0, 1e6});
  visitor.real({"all_views_probability", "probability of showing all views; otherwise the first 1..V-1"},
               all_views_probability, {0.0, 1.0});
  visitor.real({"feature_noise", "head_only: strength of noise on the features, in deviations of a channel"},
               feature_noise, {0.0, 100.0});
}

BackboneObjective::BackboneObjective(const BundleOptions& model, const BackboneObjectiveOptions& options,
                                     const ParameterPlacement& placement, int64_t seed,
                                     const TrainedGeometry& trained)
    : model_(model), options_(options), placement_(placement) {
  model_.check();
  if (static_cast<int64_t>(options_.pixel_weights.size()) > model_.backbone.levels()) {
    fail({"objective.pixel_weights", "at most " + std::to_string(model_.backbone.levels()) + " levels",
          std::to_string(options_.pixel_weights.size()), "leave out the last ones"});
  }
  if (options_.feature_noise > 0 && !head_only()) {
    fail({"objective.feature_noise", "0 while the backbone is trained, whose features have to be exact",
          fmt::format("{:g}", options_.feature_noise), "set objective.training to head_only"});
  }
  if (head_only()) {
    if (!trained.backbone || !trained.head) {
      fail({"objective.training head_only", "a bundle with a trained backbone and DPT head", "none",
            "train them from_scratch first"});
    }
    backbone_ = trained.backbone;
    head_ = trained.head;
    return;
  }
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  backbone_ = std::make_shared<Da3Backbone>(model_.backbone, placement);
  head_ = std::make_shared<DptHead>(model_.dpt_head, placement);
  backbone_->initialise(generator);
  head_->initialise(generator);
  const int64_t patch = model_.backbone.patch_size;
  for (size_t level = 0; level < options_.pixel_weights.size(); ++level) {
    const LinearSizes sizes = {model_.backbone.level_channels(), 3 * patch * patch};
    pixel_layers_.push_back(std::make_shared<Linear>(sizes, placement));
    initialise_parameters(*pixel_layers_.back(), MatrixInitialisation::kXavierUniform, generator);
  }
}

std::vector<NamedParameter> BackboneObjective::parameters() const {
  if (head_only()) return named_parameters(*head_, DptHead::kPrefix);
  auto result = named_parameters(*backbone_, Da3Backbone::kPrefix);
  for (auto& item : named_parameters(*head_, DptHead::kPrefix)) result.push_back(std::move(item));
  for (size_t level = 0; level < pixel_layers_.size(); ++level) {
    const std::string prefix = "pixels." + std::to_string(level) + ".";
    for (auto& item : named_parameters(*pixel_layers_[level], prefix)) result.push_back(std::move(item));
  }
  return result;
}

BackboneObjective::SceneResult BackboneObjective::evaluate(const TrainingScene& scene, int64_t views,
                                                           torch::Generator* noisy) const {
  TrainingScene shown = scene.to(placement_.device);
  shown.images = shown.images.narrow(0, 0, views);
  if (shown.depth.defined()) shown.depth = shown.depth.narrow(0, 0, views);
  shown.views.cameras.resize(static_cast<size_t>(views));

  const auto grid = model_.backbone.grid_of(views, shown.height(), shown.width());
  const auto pixels = imagenet_normalise(shown.images);
  std::vector<torch::Tensor> levels;
  {
    const torch::AutoGradMode gradients(torch::GradMode::is_enabled() && !head_only());
    for (const auto& level : backbone_->encode(pixels, model_.backbone.levels() - 1)) {
      levels.push_back(backbone_->decodable(level).patches);
    }
  }

  if (noisy != nullptr) levels = with_feature_noise(std::move(levels), options_.feature_noise, *noisy);

  SceneResult result;
  result.output = head_->forward(levels, grid, GeometryMaps::kDepthAndRays);
  const RayGrid rays = {result.output.rays.size(1), result.output.rays.size(2)};
  result.geometry = geometry_losses(result.output, geometry_targets(shown, rays), options_.loss);
  const auto patches = image_patches(pixels, model_.backbone.patch_size);
  for (size_t level = 0; level < pixel_layers_.size(); ++level) {
    const auto read = pixel_layers_[level]->forward(levels[level]);
    result.pixel_errors.push_back((read - patches).abs().mean());
    if (level == 0) {
      result.shallow_image =
          imagenet_denormalise(image_of_patches(read.detach(), grid, model_.backbone.patch_size));
    }
  }
  return result;
}

Losses BackboneObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  Losses losses;
  PartSums parts;
  for (const TrainingScene& scene : batch.scenes) {
    const int64_t all = scene.views.size();
    const auto draws = torch::rand({2}, generator, torch::kFloat64);
    int64_t views = all;
    if (all > 1 && draws[0].item<double>() >= options_.all_views_probability) {
      views =
          1 + std::min(static_cast<int64_t>(draws[1].item<double>() * static_cast<double>(all - 1)), all - 2);
    }
    const SceneResult result = evaluate(scene, views, &generator);
    torch::Tensor total = result.geometry.total;
    for (size_t level = 0; level < result.pixel_errors.size(); ++level) {
      total = total + options_.pixel_weights[level] * result.pixel_errors[level];
      parts.add("pixels_level" + std::to_string(level), result.pixel_errors[level], share);
    }
    losses.total = losses.total.defined() ? losses.total + share * total : share * total;
    parts.add("depth", result.geometry.depth, share);
    parts.add("depth_gradient", result.geometry.gradient, share);
    parts.add("rays", result.geometry.ray, share);
    parts.add("points", result.geometry.point, share);
    parts.add("depth_abs_rel", result.geometry.absolute_relative, share);
  }
  losses.parts = parts.take();
  return losses;
}

Validation BackboneObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  double total = 0.0, relative = 0.0, pixel_psnr = 0.0;
  for (const TrainingScene& scene : scenes) {
    const SceneResult result = evaluate(scene, scene.views.size());
    total += result.geometry.total.item<double>();
    relative += result.geometry.absolute_relative.item<double>();
    if (result.shallow_image.defined()) {
      pixel_psnr += psnr(scene.images.to(placement_.device), result.shallow_image).mean().item<double>();
    }
    if (validation.rows.size() < 4) {
      PictureRow row;
      row.name = scene.name;
      const auto true_depth = scene.depth.to(torch::kCPU);
      for (int64_t view = 0; view < std::min<int64_t>(scene.views.size(), 2); ++view) {
        row.pictures.emplace_back("image", scene.images[view].to(torch::kCPU));
        if (result.shallow_image.defined()) {
          row.pictures.emplace_back("level 0 pixels",
                                    result.shallow_image[view].to(torch::kCPU).clamp(0.0, 1.0));
        }
        row.pictures.emplace_back("true depth", depth_picture(true_depth[view], true_depth));
        const auto depth = result.output.depth.to(torch::kCPU);
        row.pictures.emplace_back("depth", depth_picture(depth[view], depth));
      }
      validation.rows.push_back(std::move(row));
    }
  }
  const auto count = static_cast<double>(scenes.size());
  validation.values = {{"geometry_loss", total / count}, {"depth_abs_rel", relative / count}};
  if (!pixel_layers_.empty()) validation.values.emplace_back("pixel_psnr", pixel_psnr / count);
  return validation;
}

void BackboneObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  if (!head_only()) save_bundle_part(folder, BundlePart::kBackbone, named_tensors(*backbone_), dtype);
  save_bundle_part(folder, BundlePart::kDptHead, named_tensors(*head_), dtype);
}

}  // namespace gld
