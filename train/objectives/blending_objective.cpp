#include "train/objectives/blending_objective.h"

#include "gld/metrics/metric_list.h"
#include "gld/tensors/tensor_pictures.h"
#include "models/layers/layer_precision.h"
#include "models/scene_geometry/composed_views.h"
#include "models/weights/weight_loading.h"
#include "train/objectives/scene_pixels.h"
#include "train/objectives/source_view_depth.h"

#include <array>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

namespace gld {
namespace {

BlendingCandidates in_type(BlendingCandidates candidates, torch::Dtype type) {
  for (torch::Tensor* part : candidates.parts()) {
    if (part->defined()) *part = part->to(type);
  }
  return candidates;
}

std::array<std::pair<const char*, torch::Tensor*>, 4> named_parts(BlendingCandidates& candidates) {
  return {{{"colours", &candidates.colours},
           {"shown", &candidates.shown},
           {"disagreement", &candidates.disagreement},
           {"depth", &candidates.depth}}};
}

torch::Tensor targets_of(const TrainingScene& scene) {
  return scene.images.slice(0, scene.views.num_sources);
}

SourceDepth true_depth_of(const TrainingScene& scene) {
  std::vector<PlanarDepth> maps;
  maps.reserve(static_cast<size_t>(scene.views.num_sources));
  for (int64_t view = 0; view < scene.views.num_sources; ++view) {
    const auto map = scene.depth[view];
    maps.push_back({map.size(1), map.size(0), numbers_of(map)});
  }
  return depth_of_scene(std::move(maps));
}

}  // namespace

void BlendingObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_start(visitor, start);
  visitor.real(
      {"true_depth", "how often photographs are carried by their true depth, where the scene has it"},
      true_depth, {0.0, 1.0});
  visitor.real({"logarithmic_weight", "weight of the logarithm of a scene's mean squared error"},
               logarithmic_weight, {0.0, 1e6});
  visitor.real({"perceptual_weight", "weight of the perceptual loss"}, perceptual_weight, {0.0, 1e6});
  visitor.group({"perceptual", "gradients and structure in the place of a network's features"}, perceptual);
  visitor.real({"kept_gib", "memory, in GiB, for what scenes that were seen before are chosen from"},
               kept_gib, {0.0, 1e6});
}

BlendingObjective::BlendingObjective(const BundleOptions& model, const BlendingObjectiveOptions& options,
                                     const BlendingDepthModels& depth_models, int64_t seed)
    : model_(model),
      options_(options),
      space_(depth_models.backbone, model.boundary_level),
      depth_models_(depth_models),
      kept_(options.kept_gib) {
  model_.check();
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  blending_ = std::make_shared<PhotographBlending>(model_.blending, ParameterPlacement{});
  blending_->initialise(generator);
}

int64_t BlendingObjective::learn_in(ComputePrecision precision) {
  return gld::learn_in(*blending_, precision);
}

std::vector<NamedParameter> BlendingObjective::parameters() const { return named_parameters(*blending_); }

std::vector<NamedParameter> BlendingObjective::untrained() const { return named_untrained(*blending_); }

BlendingCandidates BlendingObjective::candidates_of(const TrainingScene& scene, DepthOf origin) const {
  const torch::NoGradGuard no_grad;
  const auto pictures = scene.images.slice(0, 0, scene.views.num_sources);
  const SourcePhotographs photographs = photographs_of_images(scene.views, pictures);
  SourceDepth depth;
  if (origin == DepthOf::kTruth) {
    depth = true_depth_of(scene);
  } else {
    // Its training has two sources or more (train/stages/feature_stages.cpp).
    depth = sampled_source_depth(space_, *depth_models_.head, depth_models_.refinement.get(), scene,
                                 photographs, /*single_source_unit=*/0);
  }
  if (!depth.known()) return {};
  const CarriableSources sources(photographs, depth);
  std::vector<BlendingCandidates> views;
  for (int64_t view = scene.views.num_sources; view < scene.views.size(); ++view) {
    const PlacedPhotographs placed = sources.placed_in(scene.views.cameras[static_cast<size_t>(view)], 1);
    views.push_back(blending_candidates(nearest_photographs(placed), view_from_photographs(placed)));
  }
  BlendingCandidates result;
  for (size_t part = 0; part < result.parts().size(); ++part) {
    std::vector<torch::Tensor> maps;
    maps.reserve(views.size());
    for (BlendingCandidates& view : views) maps.push_back(*view.parts()[part]);
    *result.parts()[part] = torch::stack(maps);
  }
  return in_type(std::move(result), torch::kFloat16);
}

BlendingCandidates BlendingObjective::kept_candidates_of(const TrainingScene& scene, DepthOf depth) {
  const KeptTensors kept = kept_.get(scene, depth == DepthOf::kTruth ? "true depth" : "depth", [&] {
    BlendingCandidates made = candidates_of(scene, depth);
    KeptTensors tensors;
    for (const auto& [name, part] : named_parts(made)) {
      if (part->defined()) tensors[name] = *part;
    }
    return tensors;
  });
  BlendingCandidates candidates;
  for (const auto& [name, part] : named_parts(candidates)) {
    const auto found = kept.find(name);
    if (found != kept.end()) *part = found->second.to(torch::kFloat32);
  }
  return candidates;
}

Losses BlendingObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  Losses losses;
  PartMeans parts;
  // Where no scene says anything the gradient is 0, not missing.
  losses.total = 0 * parameters().front().parameter.sum();
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  for (const TrainingScene& scene : batch.scenes) {
    const bool truth_asked =
        torch::rand({1}, generator, torch::kFloat64).item<double>() < options_.true_depth;
    const bool from_truth = truth_asked && scene.depth.defined();
    const auto candidates = kept_candidates_of(scene, from_truth ? DepthOf::kTruth : DepthOf::kModel);
    if (!candidates.colours.defined()) continue;
    const auto truth = targets_of(scene);
    const auto picture = blended(candidates, chosen_shares(*blending_, candidates));
    const auto off = picture - truth;
    const auto absolute = off.abs().mean();
    const auto logarithm = (off.pow(2).mean({1, 2, 3}) + 1e-4).log().mean();
    losses.total = losses.total + share * (2 * absolute + options_.logarithmic_weight * logarithm);
    parts.add("absolute", absolute.detach());
    if (options_.perceptual_weight > 0) {
      const auto perceptual = perceptual_standin(truth, picture, options_.perceptual).mean();
      losses.total = losses.total + share * options_.perceptual_weight * perceptual;
      parts.add("perceptual", perceptual.detach());
    }
  }
  losses.parts = parts.take();
  return losses;
}

Validation BlendingObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  double absolute = 0, psnr = 0, rule_psnr = 0, sharpness = 0, rule_sharpness = 0, count = 0;
  for (const TrainingScene& scene : scenes) {
    const auto candidates = in_type(candidates_of(scene, DepthOf::kModel), torch::kFloat32);
    if (!candidates.colours.defined()) continue;
    const auto truth = targets_of(scene);
    const auto picture = blended(candidates, chosen_shares(*blending_, candidates));
    const auto rule = candidates.colours.select(1, 0);
    absolute += (picture - truth).abs().mean().item<double>();
    psnr += measure_images(metric_named("psnr"), truth, picture).mean();
    rule_psnr += measure_images(metric_named("psnr"), truth, rule).mean();
    sharpness += measure_images(metric_named("sharpness"), truth, picture).mean();
    rule_sharpness += measure_images(metric_named("sharpness"), truth, rule).mean();
    count += 1;
    if (validation.rows.size() < 4) {
      PictureRow row;
      row.name = scene.name;
      row.pictures = {{"truth", truth[0]}, {"by rule", rule[0]}, {"blended", picture[0].clamp(0, 1)}};
      validation.rows.push_back(std::move(row));
    }
  }
  // Without a scene that tells its depth no number is one.
  validation.values = {{"absolute", absolute / count},
                       {"psnr", psnr / count},
                       {"rule_psnr", rule_psnr / count},
                       {"sharpness", sharpness / count},
                       {"rule_sharpness", rule_sharpness / count}};
  return validation;
}

void BlendingObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::blending(), named_tensors(*blending_), dtype);
}

}  // namespace gld
