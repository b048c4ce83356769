#include "train/optim/optimiser.h"

#include "gld/base/error.h"
#include "gld/kernels/adam_kernel.h"

#include <algorithm>
#include <cmath>

#include <ATen/Parallel.h>
#include <torch/autograd.h>

namespace gld {
namespace {

// Sums are formed over blocks of this length and then over blocks, whatever the number of threads.
constexpr int64_t kBlock = 1 << 16;

void load_into(torch::Tensor& target, const std::map<std::string, torch::Tensor>& state,
               const std::string& name, const std::string& where) {
  const auto found = state.find(name);
  if (found == state.end()) {
    fail({where, "the optimiser's tensor '" + name + "'", "none of that name",
          "resume with the objective and options that wrote the checkpoint"});
  }
  if (found->second.sizes() != target.sizes()) {
    fail({where + ", tensor '" + name + "'", "shape " + c10::str(target.sizes()),
          "shape " + c10::str(found->second.sizes()),
          "resume with the objective and options that wrote the checkpoint"});
  }
  const torch::NoGradGuard no_grad;
  target.copy_(found->second);
}

}  // namespace

void OptimiserOptions::visit(FieldVisitor& visitor) {
  visit_choice(visitor, {"algorithm", "adamw (decoupled weight decay) or adam"}, algorithm,
               {"adamw", "adam"});
  visitor.reals({"betas", "decay of the first and the second moment"}, betas, {0.0, 0.999999});
  visitor.real({"epsilon", "added to the root of the second moment"}, epsilon, {0.0, 1.0});
  visitor.real({"weight_decay", "weight decay"}, weight_decay, {0.0, 10.0});
  visitor.real({"clip_norm", "largest global gradient norm; 0 does not clip"}, clip_norm, {0.0, 1e12});
  visitor.real({"ema_decay", "decay of the moving average of the parameters; 0 keeps none"}, ema_decay,
               {0.0, 0.9999999});
}

void OptimiserOptions::check() const {
  if (betas.size() != 2) {
    fail({"optimiser.betas", "two numbers", std::to_string(betas.size()), "write betas: [0.9, 0.95]"});
  }
}

Optimiser::Optimiser(FlatParameters& parameters, const OptimiserOptions& options)
    : parameters_(&parameters), options_(options) {
  options_.check();
  const torch::NoGradGuard no_grad;
  first_moment_ = torch::zeros_like(parameters.values());
  second_moment_ = torch::zeros_like(parameters.values());
  if (options_.ema_decay > 0.0) average_ = parameters.values().clone();
}

double Optimiser::gradient_norm() const {
  const torch::Tensor& gradients = parameters_->gradients();
  if (!gradients.is_cpu()) return gradients.to(torch::kFloat64).square().sum().sqrt().item<double>();
  const auto* data = gradients.data_ptr<float>();
  const int64_t length = gradients.numel();
  const int64_t blocks = (length + kBlock - 1) / kBlock;
  std::vector<double> sums(static_cast<size_t>(blocks));
  at::parallel_for(0, blocks, 1, [&](int64_t begin, int64_t end) {
    for (int64_t block = begin; block < end; ++block) {
      const int64_t first = block * kBlock;
      sums[static_cast<size_t>(block)] = sum_of_squares(data + first, std::min(kBlock, length - first));
    }
  });
  double total = 0.0;
  for (const double sum : sums) total += sum;
  return std::sqrt(total);
}

void Optimiser::step(double learning_rate, double gradient_norm) {
  const torch::NoGradGuard no_grad;
  ++steps_;
  const double steps = static_cast<double>(steps_);
  AdamStep step;
  // The published clipping divides by (norm + 1e-6).
  const double scale =
      options_.clip_norm > 0.0 ? std::min(1.0, options_.clip_norm / (gradient_norm + 1e-6)) : 1.0;
  step.gradient_scale = static_cast<float>(scale);
  const bool decoupled = options_.algorithm == OptimiserAlgorithm::kAdamW;
  step.value_scale = static_cast<float>(decoupled ? 1.0 - learning_rate * options_.weight_decay : 1.0);
  step.coupled_decay = static_cast<float>(decoupled ? 0.0 : options_.weight_decay);
  step.first_beta = static_cast<float>(options_.betas[0]);
  step.second_beta = static_cast<float>(options_.betas[1]);
  step.step_size = static_cast<float>(learning_rate / (1.0 - std::pow(options_.betas[0], steps)));
  step.inverse_correction = static_cast<float>(1.0 / std::sqrt(1.0 - std::pow(options_.betas[1], steps)));
  step.epsilon = static_cast<float>(options_.epsilon);
  step.average_decay = static_cast<float>(options_.ema_decay);

  torch::Tensor values = parameters_->values();
  torch::Tensor gradients = parameters_->gradients();
  if (values.is_cpu()) {
    const AdamArrays arrays = {values.data_ptr<float>(), gradients.data_ptr<float>(),
                               first_moment_.data_ptr<float>(), second_moment_.data_ptr<float>(),
                               average_.defined() ? average_.data_ptr<float>() : nullptr};
    at::parallel_for(0, values.numel(), kBlock,
                     [&](int64_t begin, int64_t end) { adam_update(arrays, step, begin, end); });
    return;
  }
  gradients.mul_(step.gradient_scale);
  if (step.coupled_decay != 0.0F) gradients.add_(values, step.coupled_decay);
  first_moment_.mul_(step.first_beta).add_(gradients, 1.0F - step.first_beta);
  second_moment_.mul_(step.second_beta).addcmul_(gradients, gradients, 1.0F - step.second_beta);
  const auto denominator = second_moment_.sqrt().mul_(step.inverse_correction).add_(step.epsilon);
  values.mul_(step.value_scale).addcdiv_(first_moment_, denominator, -step.step_size);
  if (average_.defined()) average_.mul_(step.average_decay).add_(values, 1.0F - step.average_decay);
}

std::map<std::string, torch::Tensor> Optimiser::state() const {
  std::map<std::string, torch::Tensor> state = {
      {"steps", torch::full({1}, steps_, torch::kInt64)},
      {"first_moment", first_moment_},
      {"second_moment", second_moment_},
  };
  if (average_.defined()) state["average"] = average_;
  return state;
}

void Optimiser::load_state(const std::map<std::string, torch::Tensor>& state, const std::string& where) {
  torch::Tensor steps = torch::zeros({1}, torch::kInt64);
  load_into(steps, state, "steps", where);
  load_into(first_moment_, state, "first_moment", where);
  load_into(second_moment_, state, "second_moment", where);
  if (average_.defined()) load_into(average_, state, "average", where);
  steps_ = steps.item<int64_t>();
}

AverageInPlace::AverageInPlace(FlatParameters& parameters, const Optimiser& optimiser)
    : parameters_(&parameters) {
  if (!optimiser.has_average()) return;
  const torch::NoGradGuard no_grad;
  trained_ = parameters.values().clone();
  torch::Tensor values = parameters.values();
  values.copy_(optimiser.average());
}

AverageInPlace::~AverageInPlace() {
  if (!trained_.defined()) return;
  const torch::NoGradGuard no_grad;
  torch::Tensor values = parameters_->values();
  values.copy_(trained_);
}

}  // namespace gld
