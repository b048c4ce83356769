#include "train/optim/optimiser.h"

#include "gld/base/error.h"
#include "gld/kernels/adam_kernel.h"
#include "train/optim/workers.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include <ATen/Parallel.h>
#include <torch/autograd.h>

namespace gld {
namespace {

// Sums are formed over blocks of this length and then over blocks, whatever the number of threads.
constexpr int64_t kBlock = 1 << 16;

const torch::Tensor& tensor_of(const std::map<std::string, torch::Tensor>& state, const std::string& name,
                               at::IntArrayRef shape, const std::string& where) {
  const auto found = state.find(name);
  if (found == state.end()) {
    fail({where, "the optimiser's tensor '" + name + "'", "none of that name",
          "resume with the objective and options that wrote the checkpoint"});
  }
  if (found->second.sizes() != shape) {
    fail({where + ", tensor '" + name + "'", "shape " + c10::str(shape),
          "shape " + c10::str(found->second.sizes()),
          "resume with the objective and options that wrote the checkpoint"});
  }
  return found->second;
}

// Norms in double of pieces, since LibTorch copies what it sums in another type: of a full-size model 6 GB.
double norm_in_pieces(const torch::Tensor& flat) {
  constexpr int64_t kPiece = int64_t{1} << 24;
  std::vector<torch::Tensor> norms;
  for (int64_t first = 0; first < flat.numel(); first += kPiece) {
    const auto piece = flat.narrow(0, first, std::min(kPiece, flat.numel() - first));
    norms.push_back(torch::linalg_vector_norm(piece, 2, {}, false, torch::kFloat64));
  }
  if (norms.empty()) return 0;
  return torch::linalg_vector_norm(torch::stack(norms), 2).item<double>();
}

// Returns the multiplications of a Newton-Schulz step of that matrix.
double newton_schulz_products(const torch::Tensor& matrix) {
  const auto shorter = static_cast<double>(std::min(matrix.size(0), matrix.size(1)));
  const auto longer = static_cast<double>(std::max(matrix.size(0), matrix.size(1)));
  return shorter * shorter * (2 * longer + shorter);
}

// Returns `items` in that many shares of about equal cost: the dearest first, each to the share that has least. In runs
// of equal counts one thread had the wide blocks of a DiT and the others waited.
std::vector<std::vector<size_t>> equal_shares(const std::vector<size_t>& items, int64_t count,
                                              const std::function<double(size_t)>& cost_of) {
  std::vector<std::pair<double, size_t>> dearest_first;
  dearest_first.reserve(items.size());
  for (const size_t item : items) dearest_first.emplace_back(-cost_of(item), item);
  std::sort(dearest_first.begin(), dearest_first.end());
  std::vector<std::vector<size_t>> shares(static_cast<size_t>(std::max<int64_t>(1, count)));
  std::vector<double> costs(shares.size(), 0.0);
  for (const auto& [negative_cost, item] : dearest_first) {
    const auto least = static_cast<size_t>(std::min_element(costs.begin(), costs.end()) - costs.begin());
    shares[least].push_back(item);
    costs[least] -= negative_cost;
  }
  return shares;
}

}  // namespace

void OptimiserOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"algorithm",
       "adamw (decoupled weight decay), adam, or muon for blocks' matrices and kernels and adamw for the rest"},
      algorithm, {"adamw", "adam", "muon"});
  visitor.reals({"betas", "decay of the first and the second moment"}, betas, {0.0, 0.999999});
  visitor.real({"momentum", "muon: decay of the momentum"}, momentum, {0.0, 0.999999});
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

Optimiser::Optimiser(FlatParameters& parameters, const OptimiserOptions& options,
                     std::optional<FlatRange> own)
    : parameters_(&parameters),
      options_(options),
      own_(own.value_or(FlatRange{0, parameters.values().numel()})) {
  options_.check();
  if (options_.algorithm == OptimiserAlgorithm::kMuon && own_.length() != parameters.values().numel()) {
    fail({"loop.shard_optimiser", "adamw or adam, which move each number by itself",
          "muon, which moves whole matrices", "choose one of them, or leave the optimiser whole"});
  }
  const torch::NoGradGuard no_grad;
  const auto values = parameters.values().narrow(0, own_.begin, own_.length());
  first_moment_ = torch::zeros_like(values);
  second_moment_ = torch::zeros_like(values);
  if (options_.ema_decay > 0.0) average_ = values.clone();
}

double Optimiser::gradient_norm() const {
  const torch::Tensor& gradients = parameters_->gradients();
  if (!gradients.is_cpu()) return norm_in_pieces(gradients);
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

void Optimiser::step(double learning_rate, double gradient_norm, int64_t workers) {
  const torch::NoGradGuard no_grad;
  ++steps_;
  const double steps = static_cast<double>(steps_);
  AdamStep step;
  // The published clipping divides by (norm + 1e-6).
  const double scale =
      options_.clip_norm > 0.0 ? std::min(1.0, options_.clip_norm / (gradient_norm + 1e-6)) : 1.0;
  step.gradient_scale = static_cast<float>(scale);
  const bool decoupled = options_.algorithm != OptimiserAlgorithm::kAdam;
  step.value_scale = static_cast<float>(decoupled ? 1.0 - learning_rate * options_.weight_decay : 1.0);
  step.coupled_decay = static_cast<float>(decoupled ? 0.0 : options_.weight_decay);
  step.first_beta = static_cast<float>(options_.betas[0]);
  step.second_beta = static_cast<float>(options_.betas[1]);
  step.step_size = static_cast<float>(learning_rate / (1.0 - std::pow(options_.betas[0], steps)));
  step.inverse_correction = static_cast<float>(1.0 / std::sqrt(1.0 - std::pow(options_.betas[1], steps)));
  step.epsilon = static_cast<float>(options_.epsilon);
  step.average_decay = static_cast<float>(options_.ema_decay);

  if (options_.algorithm != OptimiserAlgorithm::kMuon) {
    adam_step(step, own_.begin, own_.end);
    return;
  }
  // Runs of parameters between Muon's matrices are Adam's; the average of the matrices is taken with them, so here it
  // is Muon's own.
  const auto& parameters = parameters_->parameters();
  int64_t begin = 0;
  for (size_t i = 0; i < parameters.size(); ++i) {
    if (!is_block_matrix(parameters[i])) continue;
    adam_step(step, begin, parameters_->offset(i));
    begin = parameters_->offset(i) + parameters[i].parameter.numel();
  }
  adam_step(step, begin, parameters_->values().numel());
  muon_step(learning_rate, scale, workers);
}

void Optimiser::adam_step(const AdamStep& step, int64_t begin, int64_t end) {
  if (begin >= end) return;
  const auto part = [&](const torch::Tensor& flat) { return flat.narrow(0, begin, end - begin); };
  const auto own_part = [&](const torch::Tensor& own) {
    return own.narrow(0, begin - own_.begin, end - begin);
  };
  torch::Tensor values = part(parameters_->values());
  torch::Tensor gradients = part(parameters_->gradients());
  torch::Tensor first_moment = own_part(first_moment_);
  torch::Tensor second_moment = own_part(second_moment_);
  torch::Tensor average = average_.defined() ? own_part(average_) : torch::Tensor();
  if (values.is_cpu()) {
    const AdamArrays arrays = {values.data_ptr<float>(), gradients.data_ptr<float>(),
                               first_moment.data_ptr<float>(), second_moment.data_ptr<float>(),
                               average.defined() ? average.data_ptr<float>() : nullptr};
    at::parallel_for(0, values.numel(), kBlock,
                     [&](int64_t first, int64_t last) { adam_update(arrays, step, first, last); });
    return;
  }
  gradients.mul_(step.gradient_scale);
  if (step.coupled_decay != 0.0F) gradients.add_(values, step.coupled_decay);
  first_moment.mul_(step.first_beta).add_(gradients, 1.0F - step.first_beta);
  second_moment.mul_(step.second_beta).addcmul_(gradients, gradients, 1.0F - step.second_beta);
  const auto denominator = second_moment.sqrt().mul_(step.inverse_correction).add_(step.epsilon);
  values.mul_(step.value_scale).addcdiv_(first_moment, denominator, -step.step_size);
  if (average.defined()) average.mul_(step.average_decay).add_(values, 1.0F - step.average_decay);
}

void Optimiser::muon_step(double learning_rate, double gradient_scale, int64_t workers) {
  const auto& parameters = parameters_->parameters();
  std::vector<size_t> matrices;
  for (size_t i = 0; i < parameters.size(); ++i) {
    if (is_block_matrix(parameters[i])) matrices.push_back(i);
  }
  const auto shares = equal_shares(
      matrices, workers > 1 ? workers : int64_t{at::get_num_threads()},
      [&](size_t index) { return newton_schulz_products(parameters[index].parameter.flatten(1)); });
  const auto move = [&](int64_t share) {
    for (const size_t index : shares[static_cast<size_t>(share)])
      move_matrix(index, learning_rate, gradient_scale);
  };
  const auto count = static_cast<int64_t>(shares.size());
  if (workers > 1) {
    in_workers(workers, count, move);
    return;
  }
  // Inside a share products run on its thread alone.
  at::parallel_for(0, count, 1, [&](int64_t first, int64_t last) {
    for (int64_t share = first; share < last; ++share) move(share);
  });
}

void Optimiser::move_matrix(size_t index, double learning_rate, double gradient_scale) {
  const torch::NoGradGuard no_grad;
  torch::Tensor value = parameters_->part(parameters_->values(), index);
  torch::Tensor momentum = parameters_->part(first_moment_, index);
  const auto gradient = parameters_->part(parameters_->gradients(), index) * gradient_scale;
  momentum.lerp_(gradient, 1.0 - options_.momentum);
  const auto ahead = torch::lerp(gradient, momentum, options_.momentum);
  const auto matrix = ahead.flatten(1);
  const double size = 0.2 * std::sqrt(static_cast<double>(std::max(matrix.size(0), matrix.size(1))));
  value.mul_(1.0 - learning_rate * options_.weight_decay)
      .add_(nearly_orthogonal(matrix).view_as(value), -learning_rate * size);
  if (average_.defined()) {
    parameters_->part(average_, index).mul_(options_.ema_decay).add_(value, 1.0 - options_.ema_decay);
  }
}

bool Optimiser::is_block_matrix(const NamedParameter& item) {
  // The published names: blocks.I of backbones, DiTs, autoencoders and UNets, the latter's mid_block, and
  // decoder_layers.I of the RGB decoder. AdaLN's matrix makes vectors from one condition, as an embedding does, and so
  // does a timestep's.
  const auto contains = [&](const char* part) { return item.name.find(part) != std::string::npos; };
  const bool matrix = item.parameter.dim() == 2 || item.parameter.dim() == 4;
  return matrix && (contains("blocks.") || contains("mid_block.") || contains("decoder_layers.")) &&
         !contains("adaLN_modulation") && !contains("time_emb_proj");
}

torch::Tensor nearly_orthogonal(const torch::Tensor& matrix) {
  constexpr double kFirst = 3.4445, kThird = -4.7750, kFifth = 2.0315;
  constexpr int kSteps = 5;
  const bool tall = matrix.size(0) > matrix.size(1);
  auto x = tall ? matrix.t() : matrix;
  x = x / (x.norm() + 1e-7);
  for (int i = 0; i < kSteps; ++i) {
    const auto squares = torch::mm(x, x.t());
    const auto terms = torch::addmm(squares, squares, squares, kThird, kFifth);
    x = torch::addmm(x, terms, x, kFirst, 1.0);
  }
  return tall ? x.t() : x;
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

std::map<std::string, torch::Tensor> Optimiser::whole_initial_state() const {
  const torch::Tensor& values = parameters_->values();
  std::map<std::string, torch::Tensor> state = {
      {"steps", torch::zeros({1}, torch::kInt64)},
      {"first_moment", torch::zeros_like(values)},
      {"second_moment", torch::zeros_like(values)},
  };
  if (average_.defined()) state["average"] = values.detach().clone();
  return state;
}

void Optimiser::load_state(const std::map<std::string, torch::Tensor>& state, const std::string& where) {
  const torch::NoGradGuard no_grad;
  const auto take = [&](torch::Tensor& own, const std::string& name) {
    const auto& whole = tensor_of(state, name, parameters_->values().sizes(), where);
    own.copy_(whole.narrow(0, own_.begin, own_.length()));
  };
  const auto steps = tensor_of(state, "steps", {1}, where).item<int64_t>();
  take(first_moment_, "first_moment");
  take(second_moment_, "second_moment");
  if (average_.defined()) take(average_, "average");
  steps_ = steps;
}

AverageInPlace::AverageInPlace(FlatParameters& parameters, const torch::Tensor& average)
    : parameters_(&parameters) {
  if (!average.defined()) return;
  const torch::NoGradGuard no_grad;
  trained_ = parameters.values().clone();
  parameters.values().copy_(average);
}

AverageInPlace::~AverageInPlace() {
  if (!trained_.defined()) return;
  const torch::NoGradGuard no_grad;
  torch::Tensor values = parameters_->values();
  values.copy_(trained_);
}

}  // namespace gld
