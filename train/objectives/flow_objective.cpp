#include "train/objectives/flow_objective.h"

#include "gld/base/error.h"
#include "gld/flow/flow.h"
#include "gld/flow/schedule.h"
#include "gld/flow/solvers/solver.h"
#include "gld/metrics/metric_list.h"
#include "models/conditioning/level_conditioning.h"
#include "models/dit/flow_matching_loss.h"
#include "models/layers/layer_precision.h"
#include "train/objectives/scene_pixels.h"

#include <algorithm>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr uint64_t kValidationSeed = 20240607;

}  // namespace

void FlowObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_start(visitor, start);
  visit_carried_by(visitor, carried_by);
  visitor.real({"camera_dropout", "probability of showing a scene without cameras"}, camera_dropout,
               {0.0, 1.0});
  visitor.real(
      {"carried_dropout",
       "probability of carrying no photograph into the target views of a scene, as where no source tells "
       "the unit of depth"},
      carried_dropout, {0.0, 1.0});
  visitor.integer({"validation_evaluations", "function evaluations of the validation pictures"},
                  validation_evaluations, {1, 1000});
  visitor.boolean(
      {"checkpoint_blocks", "keep few activations of blocks and compute the others again: memory for time"},
      checkpoint_blocks);
  visitor.real({"correspondence_weight",
                "weight of the attention's error against true correspondence; needs scenes with depth"},
               correspondence_weight, {0.0, 1e6});
  visitor.integers({"correspondence_blocks",
                    "whose attention has that loss, counted from 0, the condition encoder's first"},
                   correspondence_blocks, {0, 1000});
  visitor.real({"kept_latents_gib",
                "memory for the latents of scenes that come again (data.distinct_batches), in float16; 0 "
                "encodes them every time"},
               kept_latents_gib, {0.0, 1e6});
}

FlowObjective::FlowObjective(const BundleOptions& model, const LevelGenerator& generator,
                             const FlowObjectiveOptions& options, FrozenParts frozen,
                             const ParameterPlacement& placement, int64_t seed)
    : model_(model),
      generator_(generator),
      options_(options),
      frozen_(std::move(frozen)),
      placement_(placement),
      kept_latents_(options.kept_latents_gib) {
  model_.check();
  const DitOptions& dit = model_.generator(generator).dit;
  const int64_t blocks = dit.encoder_blocks() + dit.decoder_blocks();
  for (const int64_t block : options_.correspondence_blocks) {
    if (block >= blocks) {
      fail({"objective.correspondence_blocks", fmt::format("blocks from 0 to {}", blocks - 1),
            std::to_string(block), "choose others"});
    }
  }
  check_carried_by(options_.carried_by, placement_.device);
  if (options_.carried_dropout > 0 && dit.warped_sources == 0) {
    fail({"objective.carried_dropout", "0 for a model into which nothing is carried (warped_sources: 0)",
          fmt::format("{:g}", options_.carried_dropout), "leave it out"});
  }
  if (options_.correspondence_weight > 0 && options_.correspondence_blocks.empty()) {
    fail({"objective.correspondence_weight",
          "0 without correspondence_blocks, whose attention it would teach",
          fmt::format("{:g}", options_.correspondence_weight), "name blocks, or leave it out"});
  }
  if (options_.correspondence_weight > 0 && options_.checkpoint_blocks) {
    fail({"objective.correspondence_weight", "0 with checkpoint_blocks, which keeps no queries and keys",
          fmt::format("{:g}", options_.correspondence_weight), "switch one of the two off"});
  }
  auto random = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  dit_ = std::make_shared<DitDh>(dit, placement);
  dit_->initialise(random);
  if (options_.checkpoint_blocks) dit_->set_activation_storage(ActivationStorage::kRecompute);
}

int64_t FlowObjective::learn_in(ComputePrecision precision) { return gld::learn_in(*dit_, precision); }

std::vector<NamedParameter> FlowObjective::parameters() const { return named_parameters(*dit_); }

std::vector<NamedParameter> FlowObjective::untrained() const { return named_untrained(*dit_); }

void FlowObjective::start_from(const DitDh& trained) {
  const torch::NoGradGuard no_grad;
  const auto from = trained.named_parameters();
  for (auto& item : dit_->named_parameters()) item.value().copy_(from[item.key()]);
  const auto buffers = trained.named_buffers();
  for (auto& item : dit_->named_buffers()) item.value().copy_(buffers[item.key()]);
}

LatentGrid FlowObjective::grid_of(const TrainingScene& scene) const {
  return model_.backbone.grid_of(scene.views.size(), scene.height(), scene.width());
}

double FlowObjective::training_shift(const TrainingScene& scene) const {
  const GeneratorOptions& part = model_.generator(generator_);
  return resolved_time_shift(part.time_shift.training, grid_of(scene), part.dit.in_channels);
}

SceneLatents FlowObjective::drawn(const SceneLatents& latents, torch::Generator& /*generator*/) const {
  return latents;
}

torch::Tensor FlowObjective::latent_of(const TrainingScene& scene, int64_t level,
                                       const LevelStatistics& statistics) const {
  const torch::NoGradGuard no_grad;
  const auto levels = frozen_.space->encode(scene.images, level);
  return latent_of_level(levels.at(static_cast<size_t>(level)), grid_of(scene), statistics);
}

DitSceneInputs FlowObjective::conditioned_on_sources(const TrainingScene& scene) const {
  const torch::NoGradGuard no_grad;
  const auto sources = condition_on_scene_sources(frozen_, model_, options_.carried_by, scene,
                                                  generator_.level, dit_->options().warped_sources);
  return condition_on_source_level({generator_.level, dit_->options(), frozen_.statistics}, scene.views,
                                   sources);
}

torch::Tensor FlowObjective::decode(const TrainingScene& scene, const torch::Tensor& latent) const {
  auto raw = known_levels(scene);
  raw[generator_.level] = frozen_.statistics.denormalise(latent);
  return decoded_views(frozen_, model_, scene, raw);
}

void FlowObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::of(generator_), named_tensors(*dit_), dtype);
}

std::vector<FlowObjective::Errors> FlowObjective::velocity_errors(const std::vector<Drawn>& scenes) const {
  // The network takes scenes of one shape at a time.
  std::map<std::vector<int64_t>, std::vector<size_t>> by_shape;
  for (size_t i = 0; i < scenes.size(); ++i) {
    const auto& views = scenes[i].latents.shown.views;
    by_shape[{views.size(), views.cameras.front().height, views.cameras.front().width}].push_back(i);
  }
  std::vector<Errors> result(scenes.size());
  std::vector<std::vector<AttentionTap>> taps(scenes.size());
  for (const auto& group : by_shape) {
    std::vector<FlowMatchingScene> together;
    for (const size_t i : group.second) {
      const Drawn& scene = scenes[i];
      FlowMatchingDraw draw{scene.latents.clean, scene.noise, scene.time, scene.branch, nullptr};
      if (scene.truth.shares.defined()) {
        for (const int64_t block : options_.correspondence_blocks) taps[i].push_back({block, {}, {}});
        draw.taps = &taps[i];
      }
      together.push_back({scene.latents.shown, draw});
    }
    const auto errors = flow_matching_errors(*dit_, together);
    for (size_t place = 0; place < errors.size(); ++place) {
      result[group.second[place]].velocity = errors[place];
    }
  }
  for (size_t i = 0; i < scenes.size(); ++i) {
    const int64_t sources = scenes[i].latents.shown.views.num_sources;
    for (const AttentionTap& tap : taps[i]) {
      const auto off =
          correspondence_loss(tap, scenes[i].truth, {dit_->options().num_special_tokens, sources});
      if (!off.defined()) break;
      const auto share = off / static_cast<double>(taps[i].size());
      auto& sum = result[i].correspondence;
      sum = sum.defined() ? sum + share : share;
    }
  }
  return result;
}

SceneLatents FlowObjective::with_nothing_carried(SceneLatents latents) const {
  set_no_warp(latents.shown, dit_->options());
  return latents.to(placement_.device);
}

FlowObjective::Drawn FlowObjective::draw(const TrainingScene& on_host, torch::Generator& generator) {
  const TrainingScene scene = on_host.to(placement_.device);
  const auto encode = [&] { return latents(scene); };
  const auto scene_latents =
      (kept_latents_.enabled() ? kept_latents_.get(on_host, encode) : encode()).to(placement_.device);
  Drawn drawn;
  drawn.latents = this->drawn(scene_latents, generator);
  const auto draws = torch::rand({2}, generator, torch::kFloat64);
  drawn.time = shifted_time(draws[0].item<double>(), training_shift(scene));
  drawn.branch =
      draws[1].item<double>() < options_.camera_dropout ? DitBranch::kUnconditional : DitBranch::kConditional;
  drawn.noise = torch::randn(drawn.latents.clean.sizes(), generator, torch::kFloat32).to(placement_.device);
  if (options_.carried_dropout > 0 &&
      torch::rand({1}, generator, torch::kFloat64).item<double>() < options_.carried_dropout)
    drawn.latents = with_nothing_carried(std::move(drawn.latents));
  if (options_.correspondence_weight > 0 && drawn.branch == DitBranch::kConditional) {
    drawn.truth = token_correspondence(on_host, model_.backbone.patch_side());
  }
  return drawn;
}

Losses FlowObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  std::vector<Drawn> scenes;
  for (const TrainingScene& scene : batch.scenes) scenes.push_back(draw(scene, generator));
  Losses losses;
  PartMeans parts;
  for (const Errors& errors : velocity_errors(scenes)) {
    auto total = errors.velocity.all;
    if (errors.correspondence.defined()) {
      total = total + options_.correspondence_weight * errors.correspondence;
      parts.add("correspondence", errors.correspondence);
    }
    losses.total = losses.total.defined() ? losses.total + share * total : share * total;
    parts.add("source", errors.velocity.source);
    parts.add("target", errors.velocity.target);
  }
  losses.parts = parts.take();
  return losses;
}

torch::Tensor FlowObjective::generate(const DitSceneInputs& shown, const torch::Tensor& noise,
                                      double shift) const {
  SolverOptions euler;
  euler.solver = SolverKind::kEuler;
  euler.evaluations = options_.validation_evaluations;
  euler.schedule.schedule = ScheduleKind::kShifted;
  euler.schedule.shift = shift;
  return generated_level(*dit_, shown, noise, euler, /*guidance_scale=*/1);
}

Validation FlowObjective::validate(const std::vector<TrainingScene>& scenes) {
  constexpr int kTimes = 4;
  Validation validation;
  double all = 0.0, source = 0.0, target = 0.0, target_uncarried = 0.0, one_step = 0.0, psnr_sum = 0.0;
  auto generator = at::detail::createCPUGenerator(kValidationSeed);
  for (const TrainingScene& on_host : scenes) {
    const TrainingScene scene = on_host.to(placement_.device);
    const SceneLatents of_scene = drawn(latents(scene).to(placement_.device), generator);
    const auto noise = torch::randn(of_scene.clean.sizes(), generator, torch::kFloat32).to(placement_.device);
    const double shift = training_shift(scene);
    std::vector<Drawn> draws;
    draws.reserve(kTimes + 1);
    for (int i = 0; i < kTimes; ++i) {
      draws.push_back(
          {of_scene, noise, shifted_time((i + 0.5) / kTimes, shift), DitBranch::kConditional, {}});
    }
    // At t = 1 the velocity's error is that of the prediction of the data; 1 would be predicting nothing.
    draws.push_back({of_scene, noise, 1.0, DitBranch::kConditional, {}});
    if (options_.carried_dropout > 0) {
      const SceneLatents uncarried = with_nothing_carried(of_scene);
      for (int i = 0; i < kTimes; ++i) {
        draws.push_back(draws[static_cast<size_t>(i)]);
        draws.back().latents = uncarried;
      }
    }
    const auto errors = velocity_errors(draws);
    for (int i = 0; i < kTimes; ++i) {
      const FlowMatchingErrors& at_time = errors[static_cast<size_t>(i)].velocity;
      all += at_time.all.item<double>() / kTimes;
      source += at_time.source.item<double>() / kTimes;
      target += at_time.target.item<double>() / kTimes;
    }
    one_step += errors[kTimes].velocity.target.item<double>();
    for (size_t i = kTimes + 1; i < errors.size(); ++i)
      target_uncarried += errors[i].velocity.target.item<double>() / kTimes;
    if (!frozen_.rgb_decoder) continue;
    const auto decoded = decode(scene, generate(of_scene.shown, noise, shift)).to(torch::kCPU);
    const int64_t sources = scene.views.num_sources;
    const int64_t targets = scene.views.num_targets();
    psnr_sum += measure_images(metric_named("psnr"), on_host.images.narrow(0, sources, targets),
                               decoded.narrow(0, sources, targets))
                    .mean();
    if (validation.rows.size() < 6) {
      PictureRow row;
      row.name = scene.name;
      for (int64_t view = 0; view < sources; ++view)
        row.pictures.emplace_back("source", on_host.images[view]);
      for (int64_t view = sources; view < std::min(scene.views.size(), sources + 2); ++view) {
        row.pictures.emplace_back("target", on_host.images[view]);
        row.pictures.emplace_back("generated", decoded[view].clamp(0.0, 1.0));
      }
      validation.rows.push_back(std::move(row));
    }
  }
  const auto count = static_cast<double>(scenes.size());
  validation.values = {{"flow_loss", all / count},
                       {"flow_loss_source", source / count},
                       {"flow_loss_target", target / count},
                       {"one_step_error_target", one_step / count}};
  if (options_.carried_dropout > 0)
    validation.values.emplace_back("flow_loss_target_uncarried", target_uncarried / count);
  if (frozen_.rgb_decoder) validation.values.emplace_back("target_psnr", psnr_sum / count);
  return validation;
}

}  // namespace gld
