#include "bench/sampling/scene_sampler.h"

#include "bench/support/relative_rms.h"
#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "gld/tensors/device.h"
#include "models/cost/cost_model.h"
#include "models/refiner/latent_refining.h"

#include <limits>

namespace gld {
namespace {

// Counts M1, cascade and refiner, from what ran.
double flop_of(const PipelineResult& result, const BundleOptions& bundle) {
  double flop = 0;
  for (const auto& flow : result.flows) {
    const DitOptions& model = bundle.generator(flow.generator).dit;
    flop +=
        static_cast<double>(flow.counts.condition_encoder) *
            condition_encoder_cost(model, result.grid).flop() +
        static_cast<double>(flow.counts.velocity_decoder) * velocity_decoder_cost(model, result.grid).flop();
  }
  if (result.refined > 0) {
    const int64_t references = references_taken(bundle.refiner, result.grid.views - result.refined);
    flop += static_cast<double>(result.refined) *
            refiner_cost(bundle.refiner, 1 + references, result.grid.height, result.grid.width).flop();
  }
  return flop;
}

// Returns the relative RMS of each generated level's latent against the exact one.
std::map<int64_t, double> errors_by_level(const std::map<int64_t, torch::Tensor>& latents,
                                          const std::map<int64_t, torch::Tensor>& exact) {
  std::map<int64_t, double> errors;
  for (const auto& [level, latent] : exact) errors[level] = relative_rms(latents.at(level), latent);
  return errors;
}

}  // namespace

SampledScene SceneSampler::run(const BenchmarkScene& scene, const ComparedMethod& compared) {
  auto& models = models_[compared.method.precision];
  if (!models) models = load_(compared.method.precision);
  GuidanceOptions guidance;
  guidance.guidance_scale = compared.guidance_scale;
  PipelineRequest request = scene.request;
  request.flow = flow_settings(compared.method, guidance, bundle_);
  StageRecords stages;
  record_device(stages, request.device);
  SampledScene made;
  try {
    made.result = run_pipeline(*models, request, stages);
  } catch (const Error& error) {
    // Every stage words it like this (gld/flow/solvers/solver.h, infer/pipeline/sampling_pipeline.h); other errors end
    // the report.
    if (error.parts().expected != "finite numbers") throw;
    made.finite = false;
  }
  made.seconds = stage_seconds(models->levels, StageKind::kFlow, stages) +
                 stage_seconds(models->levels, StageKind::kSampleRefinement, stages);
  for (const auto& stage : stages.records()) made.peak_bytes = std::max(made.peak_bytes, stage.peak_bytes);
  return made;
}

Sample SceneSampler::sample_of(const BenchmarkScene& scene, const SampledScene& made) const {
  Sample sample;
  sample.scene = scene.name;
  sample.seconds = made.seconds;
  sample.peak_bytes = made.peak_bytes;
  sample.non_finite = made.finite ? 0 : 1;
  for (const auto& flow : made.result.flows) {
    sample.evaluations += flow.evaluations;
    sample.unconditional += flow.guidance.unconditional;
  }
  if (!made.finite) return sample;
  sample.flop = flop_of(made.result, bundle_);
  MetricInputs inputs;
  inputs.true_images = scene.truth;
  inputs.images = made.result.images;
  if (lpips_) {
    inputs.perceptual_distance = [this](const torch::Tensor& a, const torch::Tensor& b) {
      return lpips_->forward(a, b);
    };
  }
  for (const Metric& metric : image_metric_list()) {
    const MetricValue value = gld::measure(metric, inputs);
    if (value.absent.empty()) sample.quality[metric.name] = value.mean();
  }
  return sample;
}

Sample SceneSampler::reference_sample(const BenchmarkScene& scene, const SampledScene& reference) const {
  if (!reference.finite) {
    fail({"gld bench sample", "a reference of finite numbers", "none in scene " + scene.name,
          "verify the weights with gld verify"});
  }
  Sample sample = sample_of(scene, reference);
  for (const auto& [level, latent] : reference.result.latents) sample.level_errors[level] = 0;
  return sample;
}

Sample SceneSampler::measure(const BenchmarkScene& scene, const ComparedMethod& compared,
                             const SampledScene& reference) {
  const SampledScene made = run(scene, compared);
  Sample sample = sample_of(scene, made);
  if (!made.finite) {
    constexpr double kNotKnown = std::numeric_limits<double>::quiet_NaN();
    sample.psnr_to_reference = kNotKnown;
    for (const auto& [level, exact] : reference.result.latents) sample.level_errors[level] = kNotKnown;
    return sample;
  }
  const auto& latents = made.result.latents;
  sample.level_errors = errors_by_level(latents, reference.result.latents);
  sample.psnr_to_reference =
      measure_images(metric_named("psnr"), reference.result.images, made.result.images).mean();
  if (kept_scene_ != scene.name || kept_scale_ != compared.guidance_scale) plain_latents_.clear();
  kept_scene_ = scene.name;
  kept_scale_ = compared.guidance_scale;
  if (compared.is_fewer_evaluations()) {
    plain_latents_[compared.method.solver.evaluations] = latents;
  } else if (compared.method.precision != ComputePrecision::kFloat32) {
    sample.precision_error = worst_error(errors_by_level(latents, latents_in_float32(scene, compared)));
  }
  return sample;
}

SceneSampler::Latents SceneSampler::latents_in_float32(const BenchmarkScene& scene, ComparedMethod compared) {
  const auto kept = plain_latents_.find(compared.method.solver.evaluations);
  if (kept != plain_latents_.end()) return kept->second;
  compared.method.precision = ComputePrecision::kFloat32;
  return run(scene, compared).result.latents;
}

}  // namespace gld
