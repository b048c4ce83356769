#include "train/objectives/flow_objective.h"

#include "gld/base/error.h"
#include "gld/flow/flow.h"
#include "gld/flow/schedule.h"
#include "gld/metrics/metric_list.h"
#include "models/dit/flow_matching_loss.h"
#include "models/layers/layer_precision.h"
#include "models/scene_geometry/source_warp.h"
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
  visit_choice(visitor, {"start", "random weights, or those of the bundle (fine-tuning)"}, start,
               {"random", "bundle"});
  visitor.real({"camera_dropout", "probability of showing a scene without cameras"}, camera_dropout,
               {0.0, 1.0});
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

torch::Tensor FlowObjective::normalised_tokens(const torch::Tensor& raw_level,
                                               const LevelStatistics& statistics) const {
  return statistics.normalise(
      generated_tokens(raw_level, frozen_.space->leading_tokens(), statistics.special_tokens));
}

torch::Tensor FlowObjective::latent_of(const TrainingScene& scene, int64_t level,
                                       const LevelStatistics& statistics) const {
  const torch::NoGradGuard no_grad;
  const auto levels = frozen_.space->encode(scene.images, level);
  return normalised_tokens(levels.at(static_cast<size_t>(level)), statistics);
}

SceneLatents FlowObjective::latents_of_sources(const TrainingScene& scene) const {
  const torch::NoGradGuard no_grad;
  const int64_t warped_sources = dit_->options().warped_sources;
  const auto images = images_of(scene, scene.views.num_sources);
  const bool warps = warped_sources > 0 && scene.views.num_sources > 1;
  SourceEncoding wanted;
  wanted.deepest = warps ? frozen_.space->levels() - 1 : generator_.level;
  wanted.carried = false;
  const auto encoded = frozen_.space->encode_sources(images, wanted);
  SceneLatents latents;
  latents.sources =
      normalised_tokens(encoded.levels.at(static_cast<size_t>(generator_.level)), frozen_.statistics);
  CarriedSources carried;
  if (warps) {
    const auto geometry = frozen_.geometry_head->forward(geometry_inputs(*frozen_.space, encoded),
                                                         encoded.grid, GeometryMaps::kDepthAndRays);
    carried =
        carry_sources(*frozen_.space, scene.views, images, geometry, {warped_sources, generator_.level});
  }
  DitSceneInputs shown;
  shown.views = scene.views;
  set_warp(shown, dit_->options(), carried.agreement,
           carried.levels.empty() ? torch::Tensor() : frozen_.statistics.normalise(carried.levels.back()));
  latents.warp_agreement = shown.warp_agreement;
  latents.warped_features = shown.warped_features;
  return latents.to(images.device());
}

torch::Tensor FlowObjective::decode(const TrainingScene& scene, const torch::Tensor& latent) const {
  SourceEncoding wanted;
  wanted.deepest = model_.boundary_level;
  const auto carried = frozen_.space->encode_sources(images_of(scene, 1), wanted).carried;
  auto raw = known_levels(scene);
  raw[generator_.level] = frozen_.statistics.denormalise(latent);
  const auto completed = frozen_.space->complete(raw, carried, grid_of(scene));
  const auto shape =
      torch::zeros({latent.size(0), grid_of(scene).tokens_per_view(), latent.size(2)}, latent.options());
  std::vector<torch::Tensor> decoded;
  for (const int64_t level : model_.level_set().decoded_levels()) {
    const auto& made = completed.patches.at(static_cast<size_t>(level));
    decoded.push_back(made.defined() ? made : shape);
  }
  return frozen_.rgb_decoder->decode(torch::cat(decoded, 2), grid_of(scene));
}

void FlowObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::of(generator_), named_tensors(*dit_), dtype);
}

std::vector<FlowObjective::Errors> FlowObjective::velocity_errors(const std::vector<Drawn>& scenes) const {
  // The network takes scenes of one shape at a time.
  std::map<std::vector<int64_t>, std::vector<size_t>> by_shape;
  for (size_t i = 0; i < scenes.size(); ++i) {
    const auto& views = scenes[i].prepared.inputs.views;
    by_shape[{views.size(), views.cameras.front().height, views.cameras.front().width}].push_back(i);
  }
  std::vector<Errors> result(scenes.size());
  std::vector<std::vector<AttentionTap>> taps(scenes.size());
  for (const auto& group : by_shape) {
    std::vector<FlowMatchingScene> together;
    for (const size_t i : group.second) {
      const Drawn& scene = scenes[i];
      FlowMatchingDraw draw{scene.prepared.clean, scene.noise, scene.time, scene.branch, nullptr};
      if (scene.truth.shares.defined()) {
        for (const int64_t block : options_.correspondence_blocks) taps[i].push_back({block, {}, {}});
        draw.taps = &taps[i];
      }
      together.push_back({scene.prepared.inputs, draw});
    }
    const auto errors = flow_matching_errors(*dit_, together);
    for (size_t place = 0; place < errors.size(); ++place) {
      result[group.second[place]].velocity = errors[place];
    }
  }
  for (size_t i = 0; i < scenes.size(); ++i) {
    const int64_t sources = scenes[i].prepared.inputs.views.num_sources;
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

FlowObjective::Drawn FlowObjective::draw(const TrainingScene& on_host, torch::Generator& generator) {
  const TrainingScene scene = on_host.to(placement_.device);
  const auto scene_latents =
      kept_latents_.enabled()
          ? kept_latents_.get(on_host, [&] { return latents(scene); }).to(placement_.device)
          : latents(scene);
  Drawn drawn;
  drawn.prepared = prepare(scene, scene_latents, generator);
  const auto draws = torch::rand({2}, generator, torch::kFloat64);
  drawn.time = shifted_time(draws[0].item<double>(), training_shift(scene));
  drawn.branch =
      draws[1].item<double>() < options_.camera_dropout ? DitBranch::kUnconditional : DitBranch::kConditional;
  drawn.noise = torch::randn(drawn.prepared.clean.sizes(), generator, torch::kFloat32).to(placement_.device);
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

torch::Tensor FlowObjective::generate(const Prepared& prepared, const torch::Tensor& noise,
                                      double shift) const {
  const auto scene = dit_->prepare_scene(prepared.inputs);
  // Euler's steps, and no solver of gld/flow/solvers: those throw at Ctrl-C and at values that are not finite, while
  // training goes on to its checkpoint and reports what validation gave.
  const auto steps = options_.validation_evaluations;
  torch::Tensor state = noise;
  for (int64_t i = 0; i < steps; ++i) {
    const double from = shifted_time(1.0 - static_cast<double>(i) / static_cast<double>(steps), shift);
    const double to = shifted_time(1.0 - static_cast<double>(i + 1) / static_cast<double>(steps), shift);
    state = state + (to - from) * dit_->velocity(scene, state, dit_->time_rows({from}).front());
  }
  return state;
}

Validation FlowObjective::validate(const std::vector<TrainingScene>& scenes) {
  constexpr int kTimes = 4;
  Validation validation;
  double all = 0.0, source = 0.0, target = 0.0, one_step = 0.0, psnr_sum = 0.0;
  auto generator = at::detail::createCPUGenerator(kValidationSeed);
  for (const TrainingScene& on_host : scenes) {
    const TrainingScene scene = on_host.to(placement_.device);
    const Prepared prepared = prepare(scene, latents(scene), generator);
    const auto noise = torch::randn(prepared.clean.sizes(), generator, torch::kFloat32).to(placement_.device);
    const double shift = training_shift(scene);
    std::vector<Drawn> draws;
    draws.reserve(kTimes + 1);
    for (int i = 0; i < kTimes; ++i) {
      draws.push_back(
          {prepared, noise, shifted_time((i + 0.5) / kTimes, shift), DitBranch::kConditional, {}});
    }
    // At t = 1 the velocity's error is that of the prediction of the data; 1 would be predicting nothing.
    draws.push_back({prepared, noise, 1.0, DitBranch::kConditional, {}});
    const auto errors = velocity_errors(draws);
    for (int i = 0; i < kTimes; ++i) {
      const FlowMatchingErrors& at_time = errors[static_cast<size_t>(i)].velocity;
      all += at_time.all.item<double>() / kTimes;
      source += at_time.source.item<double>() / kTimes;
      target += at_time.target.item<double>() / kTimes;
    }
    one_step += errors.back().velocity.target.item<double>();
    if (!frozen_.rgb_decoder) continue;
    const auto decoded = decode(scene, generate(prepared, noise, shift)).to(torch::kCPU);
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
  if (frozen_.rgb_decoder) validation.values.emplace_back("target_psnr", psnr_sum / count);
  return validation;
}

}  // namespace gld
