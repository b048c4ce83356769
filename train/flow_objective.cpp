#include "train/flow_objective.h"

#include "gld/error.h"
#include "gld/schedule.h"
#include "models/imagenet.h"
#include "train/scene_pixels.h"

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

FlowObjective::FlowObjective(const BundleOptions& model, const DitOptions& dit, double training_shift,
                             const FlowObjectiveOptions& options, FrozenParts frozen,
                             const ParameterPlacement& placement, int64_t seed)
    : model_(model),
      training_shift_(training_shift),
      options_(options),
      frozen_(std::move(frozen)),
      placement_(placement),
      kept_latents_(options.kept_latents_gib) {
  model_.check();
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
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  dit_ = std::make_shared<DitDh>(dit, placement);
  dit_->initialise(generator);
  if (options_.checkpoint_blocks) dit_->set_activation_storage(ActivationStorage::kRecompute);
}

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

std::vector<torch::Tensor> FlowObjective::encode(const TrainingScene& scene, int64_t views,
                                                 int64_t last) const {
  const torch::NoGradGuard no_grad;
  return frozen_.backbone->encode(imagenet_normalise(scene.images.narrow(0, 0, views)), last);
}

FlowObjective::Errors FlowObjective::velocity_errors(const Prepared& prepared, const torch::Tensor& noise,
                                                     double time, DitBranch branch,
                                                     const TokenCorrespondence& truth) const {
  const auto noisy = (1.0 - time) * prepared.clean + time * noise;
  auto scene = dit_->prepare_scene(prepared.inputs);
  std::vector<AttentionTap> taps;
  if (truth.shares.defined()) {
    for (const int64_t block : options_.correspondence_blocks) taps.push_back({block, {}, {}});
    scene.taps = &taps;
  }
  const auto velocity = dit_->velocity(scene, noisy, dit_->time_rows({time}).front(), branch);
  const auto error = (velocity - (noise - prepared.clean)).square();
  const int64_t sources = prepared.inputs.views.num_sources;
  Errors errors;
  errors.all = error.mean();
  errors.source = error.detach().narrow(0, 0, sources).mean();
  errors.target = error.detach().narrow(0, sources, error.size(0) - sources).mean();
  for (const AttentionTap& tap : taps) {
    const auto off = correspondence_loss(tap, truth, {dit_->options().num_special_tokens, sources});
    if (!off.defined()) break;
    const auto share = off / static_cast<double>(taps.size());
    errors.correspondence = errors.correspondence.defined() ? errors.correspondence + share : share;
  }
  return errors;
}

Losses FlowObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  const double share = 1.0 / static_cast<double>(batch.scenes.size());
  Losses losses;
  PartSums parts;
  for (const TrainingScene& on_host : batch.scenes) {
    const TrainingScene scene = on_host.to(placement_.device);
    const auto scene_latents =
        kept_latents_.enabled()
            ? kept_latents_.get(on_host, [&] { return latents(scene); }).to(placement_.device)
            : latents(scene);
    const Prepared prepared = prepare(scene, scene_latents, generator);
    const auto draws = torch::rand({2}, generator, torch::kFloat64);
    const double time = shifted_time(draws[0].item<double>(), training_shift_);
    const auto branch = draws[1].item<double>() < options_.camera_dropout ? DitBranch::kUnconditional
                                                                          : DitBranch::kConditional;
    const auto noise = torch::randn(prepared.clean.sizes(), generator, torch::kFloat32).to(placement_.device);
    TokenCorrespondence truth;
    if (options_.correspondence_weight > 0 && branch == DitBranch::kConditional) {
      truth = token_correspondence(on_host, model_.backbone.patch_size);
    }
    const Errors errors = velocity_errors(prepared, noise, time, branch, truth);
    auto total = errors.all;
    if (errors.correspondence.defined()) {
      total = total + options_.correspondence_weight * errors.correspondence;
      parts.add("correspondence", errors.correspondence, share);
    }
    losses.total = losses.total.defined() ? losses.total + share * total : share * total;
    parts.add("source", errors.source, share);
    parts.add("target", errors.target, share);
  }
  losses.parts = parts.take();
  return losses;
}

torch::Tensor FlowObjective::generate(const Prepared& prepared, const torch::Tensor& noise) const {
  const auto scene = dit_->prepare_scene(prepared.inputs);
  const auto steps = options_.validation_evaluations;
  torch::Tensor state = noise;
  for (int64_t i = 0; i < steps; ++i) {
    const double from =
        shifted_time(1.0 - static_cast<double>(i) / static_cast<double>(steps), training_shift_);
    const double to =
        shifted_time(1.0 - static_cast<double>(i + 1) / static_cast<double>(steps), training_shift_);
    state = state + (to - from) * dit_->velocity(scene, state, dit_->time_rows({from}).front());
  }
  return state;
}

Validation FlowObjective::validate(const std::vector<TrainingScene>& scenes) {
  constexpr int kTimes = 4;
  Validation validation;
  double all = 0.0, source = 0.0, target = 0.0, one_step = 0.0, psnr = 0.0;
  auto generator = at::detail::createCPUGenerator(kValidationSeed);
  for (const TrainingScene& on_host : scenes) {
    const TrainingScene scene = on_host.to(placement_.device);
    const Prepared prepared = prepare(scene, latents(scene), generator);
    const auto noise = torch::randn(prepared.clean.sizes(), generator, torch::kFloat32).to(placement_.device);
    for (int i = 0; i < kTimes; ++i) {
      const double time = shifted_time((i + 0.5) / kTimes, training_shift_);
      const Errors errors = velocity_errors(prepared, noise, time, DitBranch::kConditional);
      all += errors.all.item<double>() / kTimes;
      source += errors.source.item<double>() / kTimes;
      target += errors.target.item<double>() / kTimes;
    }
    // At t = 1 the velocity's error is that of the prediction of the data; 1 would be predicting nothing.
    one_step += velocity_errors(prepared, noise, 1.0, DitBranch::kConditional).target.item<double>();
    if (!frozen_.rgb_decoder) continue;
    const auto decoded = decode(scene, generate(prepared, noise)).to(torch::kCPU);
    const int64_t sources = scene.views.num_sources;
    const int64_t targets = scene.views.num_targets();
    psnr += mean_psnr(decoded.narrow(0, sources, targets), on_host.images.narrow(0, sources, targets));
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
  if (frozen_.rgb_decoder) validation.values.emplace_back("target_psnr", psnr / count);
  return validation;
}

}  // namespace gld
