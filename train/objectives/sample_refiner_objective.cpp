#include "train/objectives/sample_refiner_objective.h"

#include "gld/base/error.h"
#include "gld/flow/flow.h"
#include "gld/latents/relative_latent_error.h"
#include "gld/metrics/metric_list.h"
#include "models/conditioning/level_conditioning.h"
#include "models/layers/layer_precision.h"
#include "models/refiner/latent_refining.h"
#include "models/refiner/stacked_levels.h"
#include "train/objectives/scene_pixels.h"

#include <map>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

namespace gld {
namespace {

constexpr uint64_t kSampleValidationSeed = 20261128;

// What the repaired sample stands beside: the default of gld sample.
int64_t usual_evaluations() { return SolverOptions().evaluations; }

}  // namespace

void SampleRefinerObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_start(visitor, start);
  visit_carried_by(visitor, carried_by);
  visitor.integer({"least_evaluations", "evaluations a level of the samples that are repaired, at least"},
                  least_evaluations, {1, 1000});
  visitor.integer({"most_evaluations", "at most"}, most_evaluations, {1, 1000});
  visitor.real({"guidance_scale", "guidance of the samples that are repaired"}, guidance_scale, {0, 1000});
  visitor.integer({"validation_evaluations", "evaluations a level of the samples that it is validated on"},
                  validation_evaluations, {1, 1000});
}

void SampleRefinerObjectiveOptions::check() const {
  if (most_evaluations >= least_evaluations) return;
  fail({"objective.most_evaluations",
        "at least objective.least_evaluations, " + std::to_string(least_evaluations),
        std::to_string(most_evaluations), "raise it"});
}

SampleRefinerObjective::SampleRefinerObjective(const BundleOptions& model,
                                               const SampleRefinerObjectiveOptions& options,
                                               FrozenParts frozen, FrozenGenerators generators,
                                               const ParameterPlacement& placement, int64_t seed)
    : model_(model),
      options_(options),
      frozen_(std::move(frozen)),
      generators_(std::move(generators)),
      placement_(placement) {
  model_.check();
  options_.check();
  check_carried_by(options_.carried_by, placement_.device);
  unet_ = std::make_shared<DenoisingUnet>(model_.refiner, placement);
  unet_->initialise(at::detail::createCPUGenerator(static_cast<uint64_t>(seed)));
}

int64_t SampleRefinerObjective::learn_in(ComputePrecision precision) {
  return gld::learn_in(*unet_, precision);
}

std::vector<NamedParameter> SampleRefinerObjective::parameters() const { return named_parameters(*unet_); }

std::vector<NamedParameter> SampleRefinerObjective::untrained() const { return named_untrained(*unet_); }

LatentGrid SampleRefinerObjective::grid_of(const TrainingScene& scene) const {
  return model_.backbone.grid_of(scene.views.size(), scene.height(), scene.width());
}

SampleRefinerObjective::Encoded SampleRefinerObjective::encoded(const TrainingScene& scene) const {
  const torch::NoGradGuard no_grad;
  const LevelSet set = model_.level_set();
  const int64_t deepest = set.deepest_generated();
  Encoded result;
  result.sources =
      condition_on_scene_sources(frozen_, model_, options_.carried_by, scene, deepest, set.warped_sources);
  const auto all = frozen_.space->encode(scene.images, deepest);
  for (size_t i = 0; i < set.generators.size(); ++i) {
    const auto level = static_cast<size_t>(set.generators[i].level);
    const LevelStatistics& statistics = generators_.statistics[i];
    result.source_levels.push_back(
        latent_of_level(result.sources.levels[level], result.sources.grid, statistics));
    result.all_levels.push_back(latent_of_level(all[level], grid_of(scene), statistics));
  }
  return result;
}

SampleRefinerObjective::Levels SampleRefinerObjective::noise(const TrainingScene& scene,
                                                             torch::Generator& generator) const {
  const LatentGrid grid = grid_of(scene);
  Levels result;
  for (const LevelStatistics& statistics : generators_.statistics) {
    const auto shape = {grid.views, statistics.special_tokens + grid.tokens_per_view(),
                        model_.backbone.level_channels()};
    result.push_back(torch::randn(shape, generator, torch::kFloat32).to(placement_.device));
  }
  return result;
}

SampleRefinerObjective::Levels SampleRefinerObjective::sampled(const TrainingScene& scene,
                                                               const SourceConditioning& sources,
                                                               const Levels& noise,
                                                               int64_t evaluations) const {
  const torch::NoGradGuard no_grad;
  const LatentGrid grid = grid_of(scene);
  std::map<int64_t, torch::Tensor> by_number;
  Levels result;
  for (size_t i = 0; i < generators_.models.size(); ++i) {
    const GeneratorOptions& part = model_.generators[i];
    const DitDh& dit = *generators_.models[i];
    DitSceneInputs shown = condition_on_source_level(
        {part.generator.level, part.dit, generators_.statistics[i]}, scene.views, sources);
    if (part.generator.is_cascade()) condition_on_deeper_level(shown, by_number.at(*part.generator.deeper));
    SolverOptions solver;
    solver.evaluations = evaluations;
    solver.schedule.shift = resolved_time_shift(part.time_shift.evaluation, grid, part.dit.in_channels);
    result.push_back(generated_level(dit, shown, noise[i], solver, options_.guidance_scale));
    by_number[part.generator.level] = result.back();
  }
  return result;
}

torch::Tensor SampleRefinerObjective::target_maps(const TrainingScene& scene, const Levels& levels) const {
  return stacked_levels(levels, grid_of(scene)).slice(0, scene.views.num_sources);
}

torch::Tensor SampleRefinerObjective::refined(const TrainingScene& scene, const Encoded& encoded,
                                              const Levels& sample) const {
  const auto references = stacked_levels(encoded.source_levels, encoded.sources.grid);
  const auto degraded = target_maps(scene, sample);
  const auto& cameras = scene.views.cameras;
  const std::vector<Camera> sources(cameras.begin(), cameras.begin() + scene.views.num_sources);
  std::vector<torch::Tensor> views;
  for (int64_t target = 0; target < degraded.size(0); ++target) {
    views.push_back(beside_references(unet_->options(), cameras[sources.size() + static_cast<size_t>(target)],
                                      degraded[target], sources, references));
  }
  return refined_latents(*unet_, torch::stack(views));
}

torch::Tensor SampleRefinerObjective::target_pictures(const TrainingScene& scene,
                                                      const Levels& levels) const {
  std::map<int64_t, torch::Tensor> raw;
  for (size_t i = 0; i < levels.size(); ++i)
    raw[model_.generators[i].generator.level] = generators_.statistics[i].denormalise(levels[i]);
  return decoded_views(frozen_, model_, scene, raw).slice(0, scene.views.num_sources).to(torch::kCPU);
}

Losses SampleRefinerObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  Losses losses;
  PartMeans parts;
  for (const TrainingScene& on_host : batch.scenes) {
    const TrainingScene scene = on_host.to(placement_.device);
    const Encoded exact = encoded(scene);
    const auto evaluations = torch::randint(options_.least_evaluations, options_.most_evaluations + 1, {1},
                                            generator, torch::kInt64)
                                 .item<int64_t>();
    const Levels sample = sampled(scene, exact.sources, noise(scene, generator), evaluations);
    const auto truth = target_maps(scene, exact.all_levels);
    const auto error = (refined(scene, exact, sample) - truth).square().mean();
    losses.total = losses.total.defined() ? losses.total + share * error : share * error;
    parts.add("latent", error);
    parts.add("sampled", (target_maps(scene, sample) - truth).square().mean());
  }
  losses.parts = parts.take();
  return losses;
}

Validation SampleRefinerObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  // In the order of the report; a run's best checkpoint is by the first.
  const char* const kinds[] = {"refined", "sampled", "usual"};
  std::map<std::string, double> sums;
  auto generator = at::detail::createCPUGenerator(kSampleValidationSeed);
  for (const TrainingScene& on_host : scenes) {
    const TrainingScene scene = on_host.to(placement_.device);
    const int64_t sources = scene.views.num_sources;
    const Encoded exact = encoded(scene);
    const Levels start = noise(scene, generator);
    const Levels few = sampled(scene, exact.sources, start, options_.validation_evaluations);
    const Levels repaired = with_stacked_levels(few, refined(scene, exact, few), sources);
    const Levels usual = sampled(scene, exact.sources, start, usual_evaluations());
    const auto truth = target_maps(scene, exact.all_levels);
    const auto true_images = on_host.images.slice(0, sources);
    std::vector<torch::Tensor> pictures;
    for (const auto& [name, levels] :
         {std::pair<std::string, const Levels&>{kinds[0], repaired}, {kinds[1], few}, {kinds[2], usual}}) {
      sums[name + "_latent_error"] += relative_latent_error(target_maps(scene, levels), truth);
      if (!frozen_.rgb_decoder) continue;
      pictures.push_back(target_pictures(scene, levels).clamp(0, 1));
      sums[name + "_psnr"] += measure_images(metric_named("psnr"), true_images, pictures.back()).mean();
      sums[name + "_sharpness"] +=
          measure_images(metric_named("sharpness"), true_images, pictures.back()).mean();
    }
    if (pictures.empty() || validation.rows.size() >= 4) continue;
    PictureRow row;
    row.name = scene.name;
    row.pictures = {{"truth", true_images[0]},
                    {"few evaluations", pictures[1][0]},
                    {"refined", pictures[0][0]},
                    {"usual evaluations", pictures[2][0]}};
    validation.rows.push_back(std::move(row));
  }
  for (const char* what : {"_latent_error", "_psnr", "_sharpness"}) {
    for (const char* kind : kinds) {
      const auto sum = sums.find(std::string(kind) + what);
      if (sum == sums.end()) continue;
      validation.values.emplace_back(sum->first, sum->second / static_cast<double>(scenes.size()));
    }
  }
  return validation;
}

void SampleRefinerObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::refiner(), named_tensors(*unet_), dtype);
}

}  // namespace gld
