#include "train/objectives/refiner_objective.h"

#include "gld/latents/latent_tokens.h"
#include "gld/latents/relative_latent_error.h"
#include "gld/metrics/metric_list.h"
#include "models/layers/layer_precision.h"
#include "models/refiner/one_step_update.h"
#include "models/splats/latent_fit.h"
#include "models/weights/weight_loading.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

namespace gld {
namespace {

// How well noise is told from latents is measured at these timesteps, and with noise of this seed.
constexpr int64_t kValidationTimesteps[] = {100, 300, 500, 700, 900};
constexpr uint64_t kValidationNoiseSeed = 1;

// Of scenes with as many references: what the network is given, (scenes, 1 + references, channels, height, width), and
// what it is to make of the degraded view, (scenes, channels, height, width).
struct RefinerBatch {
  torch::Tensor views, truth, images;
};

RefinerBatch batch_of(const std::vector<TrainingScene>& scenes, torch::Device device) {
  std::vector<torch::Tensor> views, truth, images;
  for (const TrainingScene& scene : scenes) {
    const int64_t target = scene.views.num_sources;
    views.push_back(torch::cat({scene.degraded, scene.encoded.slice(0, 0, target)}));
    truth.push_back(scene.encoded[target]);
    images.push_back(scene.images[target]);
  }
  return {torch::stack(views).to(device), torch::stack(truth).to(device), torch::stack(images).to(device)};
}

torch::Tensor squared(const torch::Tensor& a, const torch::Tensor& b) { return (a - b).square().mean(); }

// Pictures are brought from [0, 1], as far as they can be shown.
torch::Tensor signed_pictures(const torch::Tensor& pictures) { return (pictures * 2 - 1).clamp(-1, 1); }

}  // namespace

RefinerObjectiveOptions::RefinerObjectiveOptions() { perceptual.weight = 2; }

void RefinerObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_start(visitor, start);
  visitor.real({"latent_weight", "weight of the mean squared error of latents"}, latent_weight, {0.0, 1e6});
  visitor.real({"picture_weight", "weight of the mean squared error of decoded pictures in [-1, 1]"},
               picture_weight, {0.0, 1e6});
  visitor.group({"perceptual", "perceptual loss of decoded pictures"}, perceptual);
  visit_choice(
      visitor,
      {"truth", "decoded pictures are compared with the true view's latents decoded, or with the view"},
      truth, {"decoded", "photograph"});
  visitor.integer(
      {"denoising_steps", "first steps in which encoded latents are seen through noise of random timesteps"},
      denoising_steps, {0, 1'000'000'000});
  visitor.integer({"latent_steps",
                   "so many steps behind denoising_steps in which latents alone count, not decoded pictures"},
                  latent_steps, {0, 1'000'000'000});
}

RefinerObjective::RefinerObjective(const BundleOptions& model, const RefinerObjectiveOptions& options,
                                   std::shared_ptr<Backbone> autoencoder, const LatentStatistics& latents,
                                   const ParameterPlacement& placement, int64_t seed)
    : model_(model),
      options_(options),
      placement_(placement),
      autoencoder_(std::move(autoencoder)),
      latents_(latents.to(placement.device)),
      perceptual_(options.perceptual, placement) {
  model_.check();
  for (auto& parameter : autoencoder_->parameters()) parameter.set_requires_grad(false);
  unet_ = std::make_shared<DenoisingUnet>(model_.refiner, placement);
  unet_->initialise(at::detail::createCPUGenerator(static_cast<uint64_t>(seed)));
}

int64_t RefinerObjective::learn_in(ComputePrecision precision) { return gld::learn_in(*unet_, precision); }

std::vector<NamedParameter> RefinerObjective::parameters() const { return named_parameters(*unet_); }

std::vector<NamedParameter> RefinerObjective::untrained() const { return named_untrained(*unet_); }

torch::Tensor RefinerObjective::decoded(const torch::Tensor& latents) const {
  const int64_t pixels = autoencoder_->architecture().latent_pixels();

  const auto raw = raw_latents(latents, latents_);
  const LatentGrid grid{raw.size(0), raw.size(2) / pixels, raw.size(3) / pixels};
  return autoencoder_->decode(autoencoder_->normalise_for_decoding(tokens_of_latents(raw, pixels)), grid);
}

torch::Tensor RefinerObjective::denoising_error(const torch::Tensor& views, const torch::Tensor& truth,
                                                const torch::Tensor& noise, int64_t timestep) const {
  const OneStepForm form = model_.refiner.form;
  auto seen = views.clone();
  seen.select(1, 0).copy_(noised_latent(truth, noise, timestep, form));
  const auto prediction = unet_->forward(seen, timestep).select(1, 0);
  const bool predicts_noise = one_step_gains(timestep, form).prediction < 0;
  return squared(prediction, predicts_noise ? noise : -noise);
}

Losses RefinerObjective::denoising_losses(const torch::Tensor& views, const torch::Tensor& truth,
                                          const StepContext& context) const {
  torch::Generator generator = context.generator;
  // The first timesteps are left out, at which nothing can be seen of the noise.
  constexpr int64_t kFirstTimestep = 20;
  const auto timestep =
      torch::randint(kFirstTimestep, kDiffusionSteps, {1}, generator, torch::kInt64).item<int64_t>();
  const auto noise = torch::randn(truth.sizes(), generator, torch::kFloat32).to(truth.device());
  Losses losses;
  losses.total = denoising_error(views, truth, noise, timestep);
  losses.parts = {{"noise", losses.total.detach()}};
  return losses;
}

Losses RefinerObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  const RefinerBatch given = batch_of(batch.scenes, placement_.device);
  if (context.step < options_.denoising_steps) return denoising_losses(given.views, given.truth, context);
  const auto refined = refined_latents(*unet_, given.views);
  Losses losses;
  const auto latent = squared(refined, given.truth);
  losses.total = options_.latent_weight * latent;
  losses.parts = {{"latent", latent.detach()}};
  const double perceptual_weight =
      context.step < options_.perceptual.start ? 0.0 : options_.perceptual.weight;
  const bool latents_alone = context.step < options_.denoising_steps + options_.latent_steps;
  if (latents_alone || (options_.picture_weight == 0 && perceptual_weight == 0)) return losses;
  torch::Tensor truth = given.images;
  if (options_.truth == RefinerTruth::kDecoded) {
    const torch::NoGradGuard no_grad;
    truth = decoded(given.truth);
  }
  const auto picture = decoded(refined);
  const auto pixels = squared(signed_pictures(picture), signed_pictures(truth));
  losses.total = losses.total + options_.picture_weight * pixels;
  losses.parts.emplace_back("picture", pixels.detach());
  if (perceptual_weight > 0) {
    const auto perceptual = perceptual_(truth.clamp(0, 1), picture.clamp(0, 1));
    losses.total = losses.total + perceptual_weight * perceptual;
    losses.parts.emplace_back("perceptual", perceptual.detach());
  }
  return losses;
}

Validation RefinerObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  double latent = 0, degraded_latent = 0, psnr = 0, degraded_psnr = 0, autoencoded_psnr = 0, sharpness = 0,
         denoising = 0;
  // The same noise in every validation, so that its errors can be compared.
  torch::Generator noises = at::detail::createCPUGenerator(kValidationNoiseSeed);
  for (const TrainingScene& scene : scenes) {
    const RefinerBatch given = batch_of({scene}, placement_.device);
    const auto degraded = given.views.select(1, 0);
    const auto refined = refined_latents(*unet_, given.views);
    latent += relative_latent_error(refined, given.truth);
    degraded_latent += relative_latent_error(degraded, given.truth);
    const auto noise = torch::randn(given.truth.sizes(), noises, torch::kFloat32).to(placement_.device);
    for (const int64_t timestep : kValidationTimesteps) {
      denoising += denoising_error(given.views, given.truth, noise, timestep).item<double>() /
                   static_cast<double>(std::size(kValidationTimesteps));
    }
    const auto picture = decoded(refined).clamp(0, 1), before = decoded(degraded).clamp(0, 1),
               best = decoded(given.truth).clamp(0, 1);
    const auto psnr_of = [&](const torch::Tensor& image) {
      return measure_images(metric_named("psnr"), given.images, image).mean();
    };
    psnr += psnr_of(picture);
    degraded_psnr += psnr_of(before);
    autoencoded_psnr += psnr_of(best);
    sharpness += measure_images(metric_named("sharpness"), best, picture).mean();
    if (validation.rows.size() >= 4) continue;
    PictureRow row;
    row.name = scene.name;
    row.pictures = {{"truth", given.images[0].to(torch::kCPU)},
                    {"degraded", before[0].to(torch::kCPU)},
                    {"refined", picture[0].to(torch::kCPU)},
                    {"encoded and decoded", best[0].to(torch::kCPU)}};
    validation.rows.push_back(std::move(row));
  }
  const auto count = static_cast<double>(scenes.size());
  validation.values = {
      {"latent_error", latent / count},         {"degraded_latent_error", degraded_latent / count},
      {"denoising_error", denoising / count},   {"psnr", psnr / count},
      {"degraded_psnr", degraded_psnr / count}, {"autoencoded_psnr", autoencoded_psnr / count},
      {"sharpness", sharpness / count}};
  return validation;
}

void RefinerObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::refiner(), named_tensors(*unet_), dtype);
}

}  // namespace gld
