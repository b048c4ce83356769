#include "train/objectives/backbone_objective.h"

#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "models/layers/imagenet.h"
#include "models/layers/initialisation.h"
#include "models/layers/layer_precision.h"
#include "train/objectives/correspondence.h"
#include "train/objectives/feature_noise.h"
#include "train/objectives/scene_pixels.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

// The learned camera token has to be learned too.
constexpr double kMostKnown = 0.9;

// Parameters whose names begin so are no part of what is trained, and are saved as they were.
void keep_still(torch::nn::Module& module, const std::string& beginning) {
  for (auto& item : module.named_parameters()) {
    if (item.key().rfind(beginning, 0) == 0) item.value().set_requires_grad(false);
  }
}

}  // namespace

void BackboneObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"training",
       "from_scratch, from_bundle or head_only: backbone and DPT head, or the head alone, on what the bundle has"},
      training, {"from_scratch", "from_bundle", "head_only"});
  visitor.group({"loss", "weights of the geometry losses"}, loss);
  visitor.reals({"pixel_weights", "weight of the pixel error read off each level, from level 0"},
                pixel_weights, {0.0, 1e6});
  visitor.reals({"geometry_weights", "weight of the depth and rays read off each level, from level 0"},
                geometry_weights, {0.0, 1e6});
  visitor.real({"head_probability", "probability of running the DPT head on a scene; it is most of a step"},
               head_probability, {0.0, 1.0});
  visitor.real({"all_views_probability", "probability of showing all views; otherwise the first 1..V-1"},
               all_views_probability, {0.0, 1.0});
  visitor.real(
      {"known_cameras", "probability of telling the backbone the cameras, where it has an encoder of them"},
      known_cameras, {0.0, kMostKnown});
  visitor.real({"correspondence_weight", "weight of the attention's error against true correspondence"},
               correspondence_weight, {0.0, 1e6});
  visitor.integers({"correspondence_blocks", "whose attention over all views has that loss, counted from 0"},
                   correspondence_blocks, {0, 1000});
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
  if (static_cast<int64_t>(options_.geometry_weights.size()) > model_.backbone.levels()) {
    fail({"objective.geometry_weights", "at most " + std::to_string(model_.backbone.levels()) + " levels",
          std::to_string(options_.geometry_weights.size()), "leave out the last ones"});
  }
  const auto none_positive = [](const std::vector<double>& weights) {
    return std::none_of(weights.begin(), weights.end(), [](double weight) { return weight > 0; });
  };
  if (options_.head_probability < 1 && !head_only() && none_positive(options_.pixel_weights) &&
      none_positive(options_.geometry_weights)) {
    fail({"objective.head_probability", "1 where nothing but the head has a loss",
          fmt::format("{:g}", options_.head_probability), "give geometry_weights or pixel_weights"});
  }
  if (!model_.geometry_head.exists() && none_positive(options_.pixel_weights) &&
      none_positive(options_.geometry_weights)) {
    fail({"objective.pixel_weights", "a weight above 0 for a backbone without a geometry head", "none",
          "give pixel_weights or geometry_weights"});
  }
  if (options_.feature_noise > 0 && !head_only()) {
    fail({"objective.feature_noise", "0 while the backbone is trained, whose features have to be exact",
          fmt::format("{:g}", options_.feature_noise), "set objective.training to head_only"});
  }
  const auto& backbone = model_.backbone.architecture();
  if (options_.known_cameras > 0 && !backbone.takes_cameras()) {
    fail({"objective.known_cameras", "0 for a backbone without an encoder of cameras",
          fmt::format("{:g}", options_.known_cameras),
          "give the model one (backbone.camera_encoder_depth), or leave it out"});
  }
  if (options_.correspondence_weight > 0 && options_.correspondence_blocks.empty() && !head_only()) {
    fail({"objective.correspondence_weight",
          "0 without correspondence_blocks, whose attention it would teach",
          fmt::format("{:g}", options_.correspondence_weight), "name blocks, or leave it out"});
  }
  for (const int64_t block : options_.correspondence_blocks) {
    if (block >= backbone.blocks() || !backbone.attends_over_views(block)) {
      fail({"objective.correspondence_blocks",
            fmt::format("blocks below {} that attend over all views", backbone.blocks()),
            std::to_string(block), "choose others"});
    }
  }
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  if (options_.training == GeometryTraining::kFromScratch) {
    backbone_ = model_.backbone.make(placement);
    backbone_->initialise(generator);
    if (model_.geometry_head.exists()) {
      head_ = model_.geometry_head.make(placement);
      head_->initialise(generator);
    }
  } else {
    if (!trained.backbone || (!trained.head && (head_only() || model_.geometry_head.exists()))) {
      fail({head_only() ? "objective.training head_only" : "objective.training from_bundle",
            "a bundle with a trained backbone and DPT head", "none", "train them from_scratch first"});
    }
    backbone_ = trained.backbone;
    head_ = trained.head;
  }
  // What no loss reaches weight decay alone would shrink.
  if (options_.known_cameras == 0) keep_still(*backbone_, "cam_enc.");
  if (head_ && options_.loss.camera_weight == 0) keep_still(*head_, "cam_dec.");
  if (head_only()) return;
  const int64_t patch = model_.backbone.patch_side();
  for (size_t level = 0; level < options_.pixel_weights.size(); ++level) {
    const LinearSizes sizes = {model_.backbone.level_channels(), 3 * patch * patch};
    pixel_layers_.push_back(std::make_shared<Linear>(sizes, placement));
    initialise_parameters(*pixel_layers_.back(), MatrixInitialisation::kXavierUniform, generator);
  }
  for (const double weight : options_.geometry_weights) {
    geometry_layers_.emplace_back();
    if (weight <= 0) continue;
    const LinearSizes sizes = {model_.backbone.level_channels(), kTokenGeometry};
    geometry_layers_.back() = std::make_shared<Linear>(sizes, placement);
    initialise_parameters(*geometry_layers_.back(), MatrixInitialisation::kXavierUniform, generator);
  }
}

// The head alone is convolutions, and what it learns on stays as it was.
int64_t BackboneObjective::learn_in(ComputePrecision precision) {
  return head_only() ? 0 : gld::learn_in(*backbone_, precision);
}

std::vector<NamedParameter> BackboneObjective::parameters() const {
  const std::string prefix = model_.geometry_head.architecture().published_prefix();
  if (head_only()) return named_parameters(*head_, prefix);
  auto result = named_parameters(*backbone_, model_.backbone.architecture().published_prefix());
  if (head_) {
    for (auto& item : named_parameters(*head_, prefix)) result.push_back(std::move(item));
  }
  for (size_t level = 0; level < pixel_layers_.size(); ++level) {
    const std::string prefix = "pixels." + std::to_string(level) + ".";
    for (auto& item : named_parameters(*pixel_layers_[level], prefix)) result.push_back(std::move(item));
  }
  for (size_t level = 0; level < geometry_layers_.size(); ++level) {
    if (!geometry_layers_[level]) continue;
    const std::string prefix = "geometry." + std::to_string(level) + ".";
    for (auto& item : named_parameters(*geometry_layers_[level], prefix)) result.push_back(std::move(item));
  }
  return result;
}

std::vector<NamedParameter> BackboneObjective::untrained() const {
  std::vector<NamedParameter> result;
  if (!head_only()) result = named_untrained(*backbone_, model_.backbone.architecture().published_prefix());
  if (head_) {
    for (auto& item : named_untrained(*head_, model_.geometry_head.architecture().published_prefix()))
      result.push_back(std::move(item));
  }
  return result;
}

BackboneObjective::SceneResult BackboneObjective::evaluate(const TrainingScene& scene,
                                                           const Showing& showing) const {
  const int64_t views = showing.views;
  TrainingScene shown = scene.to(placement_.device);
  shown.images = shown.images.narrow(0, 0, views);
  if (shown.depth.defined()) shown.depth = shown.depth.narrow(0, 0, views);
  shown.views.cameras.resize(static_cast<size_t>(views));

  const auto grid = model_.backbone.grid_of(views, shown.height(), shown.width());
  const auto pixels = imagenet_normalise(shown.images);
  std::vector<torch::Tensor> levels;
  torch::Tensor leading;  // of the last level
  const bool wants_correspondence = options_.correspondence_weight > 0 && !head_only() && views > 1;
  std::vector<AttentionTap> taps;
  {
    const torch::AutoGradMode gradients(torch::GradMode::is_enabled() && !head_only());
    for (const int64_t block :
         wants_correspondence ? options_.correspondence_blocks : std::vector<int64_t>{}) {
      taps.push_back({block, {}, {}});
    }
    const int64_t last = model_.backbone.levels() - 1;
    const auto encoded = showing.known_cameras
                             ? backbone_->encode_with_cameras(shown.images, last, shown.views.cameras, &taps)
                             : backbone_->encode(shown.images, last, &taps);
    for (const auto& level : encoded) {
      const DecodableLevel decodable = backbone_->decodable(level);
      levels.push_back(decodable.patches);
      leading = decodable.leading;
    }
  }

  if (showing.noisy != nullptr) {
    levels = with_feature_noise(std::move(levels), options_.feature_noise, *showing.noisy);
  }

  SceneResult result;
  if (showing.head) {
    result.output = head_->forward(GeometryInputs{levels, leading}, grid, GeometryMaps::kDepthAndRays);
    const RayGrid rays = {result.output.rays.size(1), result.output.rays.size(2)};
    if (const auto targets = geometry_targets(shown, rays)) {
      result.geometry = geometry_losses(result.output, *targets, options_.loss);
      if (!torch::GradMode::is_enabled()) result.rays = ray_errors(result.output.rays, *targets);
    }
  }
  result.token_errors.resize(geometry_layers_.size());
  if (!geometry_layers_.empty()) {
    const auto targets =
        geometry_targets(shown, {kTokenDepthsASide * grid.height, kTokenDepthsASide * grid.width});
    for (size_t level = 0; level < geometry_layers_.size(); ++level) {
      if (!geometry_layers_[level] || !targets) continue;
      result.token_errors[level] = token_geometry_losses(geometry_layers_[level]->forward(levels[level]),
                                                         *targets, {grid.height, grid.width}, options_.loss);
    }
  }
  if (!taps.empty()) {
    const auto truth = token_correspondence(shown, model_.backbone.patch_side());
    for (const AttentionTap& tap : taps) {
      const auto error = correspondence_loss(tap, truth, {model_.backbone.leading_tokens(), views});
      if (!error.defined()) break;
      const auto share = error / static_cast<double>(taps.size());
      result.correspondence = result.correspondence.defined() ? result.correspondence + share : share;
    }
  }
  const auto patches = image_patches(pixels, model_.backbone.patch_side());
  for (size_t level = 0; level < pixel_layers_.size(); ++level) {
    const auto read = pixel_layers_[level]->forward(levels[level]);
    result.pixel_errors.push_back((read - patches).abs().mean());
    if (level == 0) {
      result.shallow_image =
          imagenet_denormalise(image_of_patches(read.detach(), grid, model_.backbone.patch_side()));
    }
  }
  return result;
}

void BackboneObjective::count_depth(const TrainingScene& scene, bool asked, bool known) {
  if (known) {
    without_depth_ = 0;
    return;
  }
  constexpr int64_t kMost = 1000;  // scenes in a row
  if (!asked || ++without_depth_ < kMost) return;
  fail({"scene " + scene.name, "pixels of known depth in the views that are shown, at least in some scenes",
        fmt::format("none in {} scenes one after the other", kMost),
        "check the unit of the depth, and what stands for unknown"});
}

Losses BackboneObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  Losses losses;
  PartMeans parts;
  // Where no scene says anything the gradient is 0, not missing.
  losses.total = 0 * parameters().front().parameter.sum();
  for (const TrainingScene& scene : batch.scenes) {
    const int64_t all = scene.views.size();
    const auto draws = torch::rand({3}, generator, torch::kFloat64);
    int64_t views = all;
    if (all > 1 && draws[0].item<double>() >= options_.all_views_probability) {
      views =
          1 + std::min(static_cast<int64_t>(draws[1].item<double>() * static_cast<double>(all - 1)), all - 2);
    }
    Showing showing;
    showing.views = views;
    showing.head = head_ && (head_only() || draws[2].item<double>() < options_.head_probability);
    // Drawn where it is asked for alone, so that what others draw stays what it was.
    showing.known_cameras =
        options_.known_cameras > 0 &&
        torch::rand({}, generator, torch::kFloat64).item<double>() < options_.known_cameras;
    showing.noisy = &generator;
    const SceneResult result = evaluate(scene, showing);
    const bool says_geometry = result.geometry.total.defined();
    const bool reads_geometry = std::any_of(result.token_errors.begin(), result.token_errors.end(),
                                            [](const auto& losses) { return losses.total.defined(); });
    count_depth(scene, showing.head || reads_geometry, says_geometry || reads_geometry);
    torch::Tensor total = says_geometry ? result.geometry.total : torch::zeros({}, scene.images.options());
    for (size_t level = 0; level < result.pixel_errors.size(); ++level) {
      total = total + options_.pixel_weights[level] * result.pixel_errors[level];
      parts.add("pixels_level" + std::to_string(level), result.pixel_errors[level]);
    }
    for (size_t level = 0; level < result.token_errors.size(); ++level) {
      const auto& error = result.token_errors[level].total;
      if (!error.defined()) continue;
      total = total + options_.geometry_weights[level] * error;
      parts.add("geometry_level" + std::to_string(level), error);
    }
    if (result.correspondence.defined()) {
      total = total + options_.correspondence_weight * result.correspondence;
      parts.add("correspondence", result.correspondence);
    }
    losses.total = losses.total + share * total;
    if (!says_geometry) continue;
    parts.add("depth", result.geometry.depth);
    parts.add("depth_gradient", result.geometry.gradient);
    parts.add("rays", result.geometry.ray);
    parts.add("origins", result.geometry.origin);
    parts.add("points", result.geometry.point);
    if (result.geometry.point_map.defined()) parts.add("point_maps", result.geometry.point_map);
    if (result.geometry.camera.defined()) parts.add("cameras", result.geometry.camera);
    parts.add("depth_abs_rel", result.geometry.absolute_relative);
  }
  losses.parts = parts.take();
  return losses;
}

Validation BackboneObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  struct HeadErrors {
    double total = 0, relative = 0, camera = 0, scenes = 0;
    RayErrors rays;
    void add(const SceneResult& result) {
      if (!result.geometry.total.defined()) return;
      scenes += 1;
      total += result.geometry.total.item<double>();
      relative += result.geometry.absolute_relative.item<double>();
      if (result.geometry.camera.defined()) camera += result.geometry.camera.item<double>();
      rays += result.rays;
    }
  };
  HeadErrors found, told;  // where the backbone has to find the cameras, and where it knows them
  double pixel_error = 0.0, pixel_psnr = 0.0, correspondence = 0.0;
  std::vector<RayErrors> token_rays(geometry_layers_.size());
  std::vector<double> token_depth(geometry_layers_.size());
  double with_depth = 0;  // scenes that linear layers were measured on
  for (const TrainingScene& scene : scenes) {
    Showing showing;
    showing.views = scene.views.size();
    showing.head = head_ != nullptr;
    const SceneResult result = evaluate(scene, showing);
    if (head_) found.add(result);
    if (head_ && options_.known_cameras > 0) {
      showing.known_cameras = true;
      told.add(evaluate(scene, showing));
    }
    if (result.correspondence.defined()) correspondence += result.correspondence.item<double>();
    const auto measured = [](const TokenGeometryLosses& losses) { return losses.total.defined(); };
    if (std::any_of(result.token_errors.begin(), result.token_errors.end(), measured)) with_depth += 1;
    for (size_t level = 0; level < token_rays.size(); ++level) {
      token_rays[level] += result.token_errors[level].rays;
      token_depth[level] += result.token_errors[level].depth_abs_rel;
    }
    if (result.shallow_image.defined()) {
      pixel_error += result.pixel_errors.front().item<double>();
      pixel_psnr +=
          measure_images(metric_named("psnr"), scene.images.to(placement_.device), result.shallow_image)
              .mean();
    }
    if (validation.rows.size() < 4) {
      PictureRow row;
      row.name = scene.name;
      const auto true_depth = head_ ? scene.depth.to(torch::kCPU) : torch::Tensor();
      for (int64_t view = 0; view < std::min<int64_t>(scene.views.size(), 2); ++view) {
        row.pictures.emplace_back("image", scene.images[view].to(torch::kCPU));
        if (result.shallow_image.defined()) {
          row.pictures.emplace_back("level 0 pixels",
                                    result.shallow_image[view].to(torch::kCPU).clamp(0.0, 1.0));
        }
        if (!head_) continue;
        row.pictures.emplace_back("true depth", depth_picture(true_depth[view], true_depth));
        const auto depth = result.output.depth.to(torch::kCPU);
        row.pictures.emplace_back("depth", depth_picture(depth[view], depth));
      }
      validation.rows.push_back(std::move(row));
    }
  }
  const auto count = static_cast<double>(scenes.size());
  const bool reads_geometry = std::any_of(geometry_layers_.begin(), geometry_layers_.end(),
                                          [](const auto& layer) { return layer != nullptr; });
  if ((head_ && found.scenes == 0) || (reads_geometry && with_depth == 0)) {
    fail({"validation of a backbone", "a scene with pixels of known depth",
          "none among " + std::to_string(scenes.size()),
          "give others with --validation-folder, or none with --validation-scenes 0"});
  }
  const auto add_head_errors = [&](const std::string& prefix, const HeadErrors& errors) {
    const RayErrors& rays = errors.rays;
    const double count = errors.scenes;
    validation.values.insert(validation.values.end(),
                             {{prefix + "geometry_loss", errors.total / count},
                              {prefix + "depth_abs_rel", errors.relative / count},
                              {prefix + "direction_degrees", rays.direction_degrees / count},
                              {prefix + "rotation_degrees", rays.rotation_degrees / count},
                              {prefix + "translation_degrees", rays.translation_degrees / count},
                              {prefix + "origin_error", rays.origin / count}});
    if (model_.geometry_head.architecture().decodes_cameras())
      validation.values.emplace_back(prefix + "camera_error", errors.camera / count);
  };
  if (head_) add_head_errors("", found);
  if (head_ && options_.known_cameras > 0) add_head_errors("known_cameras_", told);
  for (size_t level = 0; level < token_rays.size(); ++level) {
    if (!geometry_layers_[level]) continue;
    const std::string name = "level" + std::to_string(level) + "_";
    validation.values.emplace_back(name + "depth_abs_rel", token_depth[level] / with_depth);
    validation.values.emplace_back(name + "rotation_degrees",
                                   token_rays[level].rotation_degrees / with_depth);
    validation.values.emplace_back(name + "translation_degrees",
                                   token_rays[level].translation_degrees / with_depth);
    validation.values.emplace_back(name + "origin_error", token_rays[level].origin / with_depth);
  }
  if (options_.correspondence_weight > 0 && !head_only()) {
    validation.values.emplace_back("correspondence", correspondence / count);
  }
  // The first value is the one that the best checkpoint has least of: an error, where pixels are all there is.
  if (!pixel_layers_.empty()) {
    validation.values.emplace_back("pixel_error", pixel_error / count);
    validation.values.emplace_back("pixel_psnr", pixel_psnr / count);
  }
  return validation;
}

void BackboneObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  if (!head_only()) save_bundle_part(folder, BundlePart::backbone(), named_tensors(*backbone_), dtype);
  if (head_) save_bundle_part(folder, BundlePart::geometry_head(), named_tensors(*head_), dtype);
}

}  // namespace gld
