#include "train/objectives/decoder_objective.h"

#include "gld/base/error.h"
#include "gld/metrics/metric_list.h"
#include "models/layers/layer_precision.h"
#include "models/weights/weight_loading.h"
#include "train/objectives/feature_noise.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

namespace gld {
namespace {

constexpr int64_t kLargestStep = 1'000'000'000'000;

torch::Tensor to_signed(const torch::Tensor& images) { return images * 2.0 - 1.0; }

}  // namespace

AdversarialOptions::AdversarialOptions() {
  learning_rate.schedule = LearningRateSchedule::kCosine;
  learning_rate.peak = 2e-4;
  learning_rate.final = 2e-5;
  optimiser.clip_norm = 0.0;
  optimiser.ema_decay = 0.0;
}

void AdversarialOptions::visit(FieldVisitor& visitor) {
  visitor.real({"weight", "weight of the adversarial loss; 0 trains without a discriminator"}, weight,
               {0.0, 1e6});
  visitor.integer({"generator_start", "first step at which the decoder sees the discriminator"},
                  generator_start, {0, kLargestStep});
  visitor.integer({"discriminator_start", "first step at which the discriminator learns"},
                  discriminator_start, {0, kLargestStep});
  visitor.real({"largest_adaptive_weight", "bound of the adaptive weight"}, largest_adaptive_weight,
               {0.0, 1e12});
  visitor.integer({"crop", "side in pixels of the random crop that is judged"}, crop, {8, 65536});
  visitor.text({"dino_weights", "DINO weight file; empty uses a small convolutional discriminator"},
               dino_weights);
  visitor.group({"dino", "the DINO-based discriminator"}, dino);
  visitor.group({"convolutional", "the convolutional discriminator"}, convolutional);
  visitor.group({"augment", "augmentation of what the discriminator sees"}, augment);
  visitor.group({"learning_rate", "course of the discriminator's learning rate, over its own steps"},
                learning_rate);
  visitor.group({"optimiser", "the discriminator's optimiser"}, optimiser);
}

void DecoderObjectiveOptions::visit(FieldVisitor& visitor) {
  visit_start(visitor, start);
  visitor.real({"reconstruction_weight", "weight of the absolute error"}, reconstruction_weight, {0.0, 1e6});
  visitor.real({"level_dropout", "probability of leaving a level out"}, level_dropout, {0.0, 0.99});
  visitor.real(
      {"latent_noise", "deviation of the strength of noise on the features, in deviations of a channel"},
      latent_noise, {0.0, 100.0});
  visitor.group({"perceptual", "perceptual loss"}, perceptual);
  visitor.group({"adversarial", "adversarial loss"}, adversarial);
}

std::vector<std::string> stand_in_notes(const DecoderObjectiveOptions& options) {
  std::vector<std::string> notes;
  if (options.perceptual.weight > 0 && options.perceptual.lpips.lpips_backbone.empty()) {
    notes.push_back(standin_note());
  }
  if (options.adversarial.weight > 0 && options.adversarial.dino_weights.empty()) {
    notes.emplace_back(
        "the discriminator is a small convolutional one; DINO's features need objective.adversarial.dino_weights");
  }
  return notes;
}

DecoderObjective::DecoderObjective(const BundleOptions& model, const DecoderObjectiveOptions& options,
                                   std::shared_ptr<const Backbone> backbone,
                                   const ParameterPlacement& placement, int64_t seed)
    : model_(model),
      options_(options),
      placement_(placement),
      backbone_(std::move(backbone)),
      perceptual_(options.perceptual, placement) {
  model_.check();
  auto generator = at::detail::createCPUGenerator(static_cast<uint64_t>(seed));
  decoder_ = std::make_shared<RgbDecoder>(model_.rgb_decoder, placement);
  decoder_->initialise(generator);
  if (options_.adversarial.weight > 0.0) {
    if (options_.adversarial.dino_weights.empty()) {
      discriminator_ =
          std::make_shared<ConvolutionalDiscriminator>(options_.adversarial.convolutional, placement);
    } else {
      auto dino = std::make_shared<DinoDiscriminator>(options_.adversarial.dino, placement);
      dino->load_dino(*WeightFile::open(options_.adversarial.dino_weights));
      discriminator_ = dino;
    }
    discriminator_->initialise(generator);
    discriminator_->eval();
    discriminator_parameters_ = std::make_unique<FlatParameters>(named_parameters(*discriminator_));
    discriminator_optimiser_ =
        std::make_unique<Optimiser>(*discriminator_parameters_, options_.adversarial.optimiser);
  }
}

int64_t DecoderObjective::learn_in(ComputePrecision precision) { return gld::learn_in(*decoder_, precision); }

std::vector<NamedParameter> DecoderObjective::parameters() const {
  return named_parameters(*decoder_, RgbDecoder::kPrefix);
}

std::vector<NamedParameter> DecoderObjective::untrained() const {
  return named_untrained(*decoder_, RgbDecoder::kPrefix);
}

std::vector<torch::Tensor> DecoderObjective::levels_of(const torch::Tensor& images) const {
  const torch::NoGradGuard no_grad;
  std::vector<torch::Tensor> levels;
  const auto decoded = model_.level_set().decoded_levels();
  const auto encoded = backbone_->encode(images, decoded.back());
  levels.reserve(decoded.size());
  for (const int64_t level : decoded) {
    levels.push_back(backbone_->decodable(encoded.at(static_cast<size_t>(level))).patches);
  }
  return levels;
}

std::vector<int64_t> DecoderObjective::draw_corner(const torch::Tensor& images,
                                                   torch::Generator& generator) const {
  const int64_t side = options_.adversarial.crop;
  std::vector<int64_t> corner;
  for (const int64_t dim : {2, 3}) {
    const int64_t room = std::max<int64_t>(images.size(dim) - side, 0);
    corner.push_back(torch::randint(0, room + 1, {1}, generator, torch::kInt64).item<int64_t>());
  }
  return corner;
}

torch::Tensor DecoderObjective::crop(const torch::Tensor& images, const std::vector<int64_t>& corner) const {
  const int64_t side = options_.adversarial.crop;
  return images.narrow(2, corner[0], std::min(side, images.size(2)))
      .narrow(3, corner[1], std::min(side, images.size(3)));
}

Losses DecoderObjective::losses(const TrainingBatch& batch, const StepContext& context) {
  torch::Generator generator = context.generator;
  std::vector<torch::Tensor> truths, features;
  for (const TrainingScene& scene : batch.scenes) {
    truths.push_back(scene.images.to(placement_.device));
    auto levels = levels_of(truths.back());
    auto kept = torch::rand({static_cast<int64_t>(levels.size())}, generator, torch::kFloat64)
                    .ge(options_.level_dropout);
    if (!kept.any().item<bool>()) kept[0] = true;
    for (size_t level = 0; level < levels.size(); ++level) {
      if (!kept[static_cast<int64_t>(level)].item<bool>()) levels[level] = torch::zeros_like(levels[level]);
    }
    levels = with_feature_noise(std::move(levels), options_.latent_noise, generator);
    features.push_back(torch::cat(levels, 2));
  }
  // The decoder works on single views, so scenes of one resolution are one batch for it.
  const auto truth = torch::cat(truths);
  const auto grid = backbone_->architecture().grid_of(truth.size(0), truth.size(2), truth.size(3));
  const auto decoded = decoder_->decode(torch::cat(features), grid);

  Losses losses;
  const auto reconstruction = (decoded - truth).abs().mean();
  losses.parts.emplace_back("reconstruction", reconstruction.detach());
  losses.total = options_.reconstruction_weight * reconstruction;
  if (options_.perceptual.weight > 0.0 && context.step >= options_.perceptual.start) {
    const auto loss = perceptual_(truth, decoded);
    losses.parts.emplace_back("perceptual", loss.detach());
    losses.total = losses.total + options_.perceptual.weight * loss;
  }
  if (discriminator_ && context.step >= options_.adversarial.generator_start) {
    const auto seen = crop(to_signed(decoded), draw_corner(decoded, generator));
    const auto loss =
        -discriminator_->logits(diff_augment(seen, options_.adversarial.augment, generator)).mean();
    const auto& layer = decoder_->last_layer_weight();
    const auto gradient_norm = [&layer](const torch::Tensor& of) {
      return torch::autograd::grad({of}, {layer}, {}, /*retain_graph=*/true)[0].norm();
    };
    const auto adaptive = (gradient_norm(losses.total) / (gradient_norm(loss) + 1e-6))
                              .clamp(0.0, options_.adversarial.largest_adaptive_weight)
                              .detach();
    losses.parts.emplace_back("adversarial", loss.detach());
    losses.parts.emplace_back("adaptive_weight", adaptive);
    losses.total = losses.total + options_.adversarial.weight * adaptive * loss;
  }
  if (discriminator_) keep_for_discriminator(batch.index, context.step, {truth, decoded.detach()});
  return losses;
}

void DecoderObjective::keep_for_discriminator(int64_t micro_batch, int64_t step, const JudgedImages& images) {
  const std::lock_guard<std::mutex> lock(judged_mutex_);
  if (step != judged_step_) judged_.clear();  // a step that was skipped leaves its images behind
  judged_step_ = step;
  judged_[micro_batch] = images;
}

std::vector<std::pair<std::string, double>> DecoderObjective::after_step(const StepContext& context) {
  const auto judged = std::exchange(judged_, {});
  const AdversarialOptions& options = options_.adversarial;
  if (judged.empty() || context.step < options.discriminator_start) return {};
  torch::Generator generator = context.generator;
  discriminator_->train();
  discriminator_parameters_->zero_gradients();
  const auto share = 1.0 / static_cast<double>(judged.size());
  double loss_sum = 0.0, accuracy = 0.0;
  for (const auto& [micro_batch, of_micro_batch] : judged) {
    const auto& [truth, images] = of_micro_batch;
    const auto corner = draw_corner(truth, generator);
    // Rounded to 8 bits like the real images, so that the discriminator cannot tell them by their precision.
    const auto decoded = torch::round(images.clamp(0.0, 1.0) * 255.0) / 255.0;
    const auto fake = diff_augment(crop(to_signed(decoded), corner), options.augment, generator);
    const auto real = diff_augment(crop(to_signed(truth), corner), options.augment, generator);
    const auto fake_logits = discriminator_->logits(fake);
    const auto real_logits = discriminator_->logits(real);
    const auto loss = 0.5 * (torch::relu(1.0 - real_logits).mean() + torch::relu(1.0 + fake_logits).mean());
    (share * loss).backward();
    loss_sum += share * loss.item<double>();
    accuracy += share * real_logits.gt(fake_logits).to(torch::kFloat32).mean().item<double>();
  }
  const double norm = discriminator_optimiser_->gradient_norm();
  if (std::isfinite(norm)) {
    const int64_t own_step = discriminator_optimiser_->steps_taken();
    const int64_t own_steps = context.total_steps - options.discriminator_start;
    discriminator_optimiser_->step(learning_rate(options.learning_rate, own_step, own_steps), norm);
  }
  discriminator_->eval();  // judging leaves its spectral norms alone: losses() runs in several threads
  return {{"discriminator", loss_sum}, {"discriminator_accuracy", accuracy}};
}

Validation DecoderObjective::validate(const std::vector<TrainingScene>& scenes) {
  Validation validation;
  double absolute = 0.0, perceptual_sum = 0.0, psnr_sum = 0.0, sharpness_sum = 0.0;
  for (const TrainingScene& scene : scenes) {
    const auto truth = scene.images.to(placement_.device);
    const auto grid = backbone_->architecture().grid_of(truth.size(0), truth.size(2), truth.size(3));
    const auto decoded = decoder_->decode(torch::cat(levels_of(truth), 2), grid);
    absolute += (decoded - truth).abs().mean().item<double>();
    perceptual_sum += perceptual_(truth, decoded).item<double>();
    psnr_sum += measure_images(metric_named("psnr"), truth, decoded).mean();
    sharpness_sum += measure_images(metric_named("sharpness"), truth, decoded).mean();
    if (validation.rows.size() < 4) {
      PictureRow row;
      row.name = scene.name;
      for (int64_t view = 0; view < std::min<int64_t>(scene.views.size(), 3); ++view) {
        row.pictures.emplace_back("image", truth[view].to(torch::kCPU));
        row.pictures.emplace_back("decoded", decoded[view].to(torch::kCPU).clamp(0.0, 1.0));
      }
      validation.rows.push_back(std::move(row));
    }
  }
  const auto count = static_cast<double>(scenes.size());
  validation.values = {{"reconstruction", absolute / count},
                       {"perceptual", perceptual_sum / count},
                       {"psnr", psnr_sum / count},
                       {"sharpness", sharpness_sum / count}};
  return validation;
}

std::map<std::string, torch::Tensor> DecoderObjective::state() const {
  std::map<std::string, torch::Tensor> state;
  if (!discriminator_) return state;
  for (const auto& [name, tensor] : named_tensors(*discriminator_)) state["discriminator." + name] = tensor;
  for (const auto& [name, tensor] : discriminator_optimiser_->state()) state["optimiser." + name] = tensor;
  return state;
}

void DecoderObjective::load_state(const std::map<std::string, torch::Tensor>& state,
                                  const std::string& where) {
  if (!discriminator_) return;
  std::map<std::string, torch::Tensor> optimiser;
  const torch::NoGradGuard no_grad;
  for (const auto& [name, tensor] : state) {
    if (name.rfind("optimiser.", 0) == 0) optimiser[name.substr(10)] = tensor;
  }
  for (auto& [name, tensor] : named_tensors(*discriminator_)) {
    const auto found = state.find("discriminator." + name);
    if (found == state.end() || found->second.sizes() != tensor.sizes()) {
      fail({where, "the discriminator's tensor '" + name + "'", "none of that name and shape",
            "resume with the options that wrote the checkpoint"});
    }
    torch::Tensor target = tensor;
    target.copy_(found->second);
  }
  discriminator_optimiser_->load_state(optimiser, where);
}

void DecoderObjective::export_model(const std::filesystem::path& folder, DType dtype) const {
  save_bundle_options(folder, model_);
  save_bundle_part(folder, BundlePart::rgb_decoder(), named_tensors(*decoder_), dtype);
}

}  // namespace gld
