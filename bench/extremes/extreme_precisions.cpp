// Layers, attention and models in the precisions other than float32, at the ends of the range of numbers.
#include "bench/extremes/extreme_inputs.h"
#include "bench/extremes/extremes_benchmark.h"
#include "bench/support/benchmark_precisions.h"
#include "bench/support/random_dit.h"
#include "bench/support/relative_rms.h"
#include "gld/attention/attention.h"
#include "gld/attention/composed_attention.h"
#include "gld/tensors/fused_ops.h"
#include "infer/method/plan_errors.h"
#include "models/bundle/bundle.h"
#include "models/layers/layer_precision.h"
#include "models/layers/layers.h"

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

std::vector<ComputePrecision> reduced_precisions() {
  auto precisions = benchmark_precisions(compute_precision_names());
  precisions.erase(precisions.begin());  // float32
  return precisions;
}

// Returns what a product may differ by, as relative RMS: two operands are rounded to 8 bits, or (int8) to 255 steps
// between the smallest and the largest number of a token or an output channel.
double stated_error(ComputePrecision precision) {
  switch (precision) {
    case ComputePrecision::kInt8:
      return 0x1p-6;
    default:
      return 0x1p-8;
  }
}

std::string measured_against_double(ComputePrecision precision) {
  return fmt::format("relative RMS, {} against double", compute_precision_name(precision));
}

// A linear layer at M1's width.
class ProductInPrecision {
 public:
  explicit ProductInPrecision(ComputePrecision precision) : layer_({kWidth, kWidth}, ParameterPlacement{}) {
    const at::NoGradGuard no_grad;
    layer_.weight.copy_(extreme_random({kWidth, kWidth}, 11) / std::sqrt(double{kWidth}));
    layer_.bias.zero_();
    weight_ = layer_.weight.to(torch::kFloat64);
    LayerPrecision layers = layer_precision(precision, ModelKind::kGenerator);
    layers.originals = PackedOriginals::kRelease;
    layer_.use_precision(layers);
  }

  static torch::Tensor activations() { return extreme_random({kTokens, kWidth}, 12); }
  // x is float64, with every number a float32.
  double error(const torch::Tensor& x) const {
    return relative_rms(layer_.forward(x.to(torch::kFloat32)).to(torch::kFloat64), exact(x));
  }
  torch::Tensor exact(const torch::Tensor& x) const { return torch::matmul(x, weight_.t()); }
  const Linear& layer() const { return layer_; }

 private:
  static constexpr int64_t kWidth = 768, kTokens = 64;
  Linear layer_;
  torch::Tensor weight_;  // in float64
};

std::vector<ExtremeRow> product_rows(ComputePrecision precision) {
  const ProductInPrecision product(precision);
  const std::string measured = measured_against_double(precision);
  std::vector<ExtremeRow> rows;
  for (const double size : {1e-30, 1.0, 1e4, 1e30}) {
    const auto x = (size * ProductInPrecision::activations()).to(torch::kFloat32).to(torch::kFloat64);
    rows.push_back({"products", fmt::format("activations of {:g}", size), measured, product.error(x),
                    stated_error(precision)});
  }
  auto outlier = ProductInPrecision::activations().to(torch::kFloat32).to(torch::kFloat64);
  outlier.select(1, 5).mul_(1e4);
  rows.push_back({"products", "one channel of 1e4 among others of 1", measured, product.error(outlier),
                  stated_error(precision)});
  // The norm in front of a layer is float32 in every precision.
  for (const double size : {1e-30, 1e30}) {
    RmsNormInputs norm;
    norm.x = (size * ProductInPrecision::activations()).to(torch::kFloat32);
    norm.epsilon = 0;
    const auto x = norm.x.to(torch::kFloat64);
    const auto normal = x * torch::rsqrt(x.square().mean(-1, true));
    const auto made = product.layer().forward(rms_norm(norm)).to(torch::kFloat64);
    rows.push_back({"products", fmt::format("a norm of RMS {:g}, then a layer", size), measured,
                    relative_rms(made, product.exact(normal)), stated_error(precision)});
  }
  return rows;
}

AttentionInputs in_single(AttentionInputs inputs) {
  for (auto* x : {&inputs.query, &inputs.key, &inputs.value}) *x = x->to(torch::kFloat32);
  inputs.precision = ComputePrecision::kBFloat16;
  return inputs;
}

// Kernels round keys to 8 bits, and queries after their factor log2(e) / sqrt(head_dim), so a logit L of any numbers is
// known to L / 256. Queries that the factor takes to numbers of bfloat16 show what attention itself loses; any others
// show that nothing overflows.
std::vector<ExtremeRow> attention_rows() {
  constexpr double kLog2E = 1.4426950408889634;
  std::vector<ExtremeRow> rows;
  for (const double size : {0.0, 1.0, 1e2, 1e4}) {
    const std::string situation = size == 0 ? "all logits equal" : fmt::format("logits up to {:g}", size);
    AttentionInputs inputs = attention_inputs_with_logits(size * kLog2E, 96);
    inputs.query = (inputs.query / kLog2E).to(torch::kFloat32).to(torch::kFloat64);
    inputs.value = inputs.value.to(torch::kBFloat16).to(torch::kFloat64);
    rows.push_back(
        {"attention", situation + ", queries exact in bfloat16",
         measured_against_double(ComputePrecision::kBFloat16),
         relative_rms(attention(in_single(inputs)).to(torch::kFloat64), composed_attention(inputs)), 0x1p-7});
    inputs.query = inputs.query * 1.2345;
    rows.push_back({"attention", situation + ", any queries", "numbers that are not finite, bfloat16",
                    torch::isfinite(attention(in_single(inputs))).logical_not().sum().item<double>(), 0});
  }
  return rows;
}

// The model is M1 of DA3-Base at its widths with random weights, shortened so that float64 takes seconds.
std::vector<ExtremeRow> full_width_rows() {
  DitOptions options = BundleOptions().generators.front().dit;
  options.depth = {2, 1};
  const auto model = dit_with_random_weights(options);
  RandomDitSceneSettings settings;
  settings.cameras = {4, 2, {70, 42}};
  settings.grid = BackboneOptions().grid_of(settings.cameras.views, settings.cameras.image.height,
                                            settings.cameras.image.width);
  const auto velocity = [&](const DitDh& of) {
    const RandomDitScene random = random_scene_for(of, settings);
    return of.velocity(random.scene, random.noisy, random.time).to(torch::kFloat64);
  };
  const auto exact = velocity(*double_copy(*model));
  std::vector<ExtremeRow> rows;
  const auto add = [&](ComputePrecision precision, double limit) {
    rows.push_back({"full width", "M1 of 2 and 1 blocks, the velocity", measured_against_double(precision),
                    relative_rms(velocity(*packed_copy(*model, precision)), exact), limit});
  };
  add(ComputePrecision::kFloat32, 1e-5);
  for (const auto precision : {ComputePrecision::kBFloat16, ComputePrecision::kInt8})
    add(precision, largest_automatic_error(precision));
  return rows;
}

}  // namespace

std::vector<ExtremeRow> precision_extremes() {
  const at::NoGradGuard no_grad;
  std::vector<ExtremeRow> rows;
  for (const ComputePrecision precision : reduced_precisions()) {
    for (auto& row : product_rows(precision)) rows.push_back(std::move(row));
  }
  for (auto& row : attention_rows()) rows.push_back(std::move(row));
  for (auto& row : full_width_rows()) rows.push_back(std::move(row));
  return rows;
}

}  // namespace gld
