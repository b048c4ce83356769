#include "models/blending/photograph_blending.h"

#include "gld/base/error.h"
#include "gld/cameras/image_size.h"
#include "gld/photogrammetry/percentile.h"
#include "models/layers/initialisation.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include <torch/autograd.h>

namespace gld {
namespace {

constexpr auto kHypotheses = static_cast<int64_t>(kDepthFactors.size());

// (height, width, channels) values as (channels, height, width).
torch::Tensor plane(const std::vector<float>& values, int64_t height, int64_t width, int64_t channels) {
  return torch::tensor(at::ArrayRef<float>(values)).view({height, width, channels}).permute({2, 0, 1});
}

// log(depth / its median), 0 where no source reaches: (1, height, width).
torch::Tensor relative_depth(const TargetDepth& depth) {
  std::vector<float> logs(depth.values.size(), 0.0F), known;
  for (size_t i = 0; i < logs.size(); ++i) {
    if (depth.reached[i] == 0) continue;
    logs[i] = static_cast<float>(std::log(depth.values[i]));
    known.push_back(logs[i]);
  }
  const float middle = known.empty() ? 0.0F : median(known);
  for (size_t i = 0; i < logs.size(); ++i) logs[i] = depth.reached[i] == 0 ? 0.0F : logs[i] - middle;
  return plane(logs, depth.height, depth.width, 1);
}

}  // namespace

void BlendingOptions::visit(FieldVisitor& visitor) {
  visitor.integers(
      {"channels",
       "channels at full size, half, a quarter and so on; none for a model that lays photographs "
       "together by rule"},
      channels, {1, 4096});
  visitor.integer({"side", "longer side, in pixels, of the pictures that it looks at"}, side, {8, 4096});
}

void BlendingOptions::check() const {
  constexpr size_t kMost = 8;
  if (channels.size() > kMost || channels.size() == 1) {
    fail({"channels", "none, or 2 to 8 numbers", std::to_string(channels.size()),
          "write for example channels: [24, 32, 48, 64]"});
  }
}

PhotographBlending::PhotographBlending(const BlendingOptions& options, const ParameterPlacement& placement)
    : options_(options) {
  options_.check();
  const auto& channels = options_.channels;
  const auto encoder = register_module("encoder", std::make_shared<torch::nn::Module>());
  const auto decoder = register_module("decoder", std::make_shared<torch::nn::Module>());
  for (size_t i = 0; i < channels.size(); ++i) {
    encoder_.push_back(
        make_pair(*encoder, std::to_string(i), {i == 0 ? kInputs : channels[i - 1], channels[i]}, placement));
  }
  for (size_t i = 0; i + 1 < channels.size(); ++i) {
    decoder_.push_back(
        make_pair(*decoder, std::to_string(i), {channels[i] + channels[i + 1], channels[i]}, placement));
  }
  choice_ = register_module(
      "choice",
      std::make_shared<Convolution>(same_size_convolution(channels.front(), 1 + kHypotheses, 3), placement));
}

torch::Tensor PhotographBlending::Pair::operator()(const torch::Tensor& x) const {
  return torch::gelu(second->forward(torch::gelu(first->forward(x))));
}

torch::Tensor PhotographBlending::forward(const torch::Tensor& inputs) const {
  std::vector<torch::Tensor> levels;
  torch::Tensor x = inputs;
  for (const Pair& pair : encoder_) {
    if (!levels.empty()) x = torch::avg_pool2d(x, {2, 2}, {2, 2}, {0, 0}, /*ceil_mode=*/true);
    x = pair(x);
    levels.push_back(x);
  }
  for (size_t i = decoder_.size(); i-- > 0;) {
    const auto larger = torch::upsample_bilinear2d(x, {levels[i].size(2), levels[i].size(3)}, false);
    x = decoder_[i](torch::cat({levels[i], larger}, 1));
  }
  return choice_->forward(x);
}

void PhotographBlending::initialise(const torch::Generator& generator) {
  const torch::NoGradGuard no_grad;
  initialise_parameters(*this, MatrixInitialisation::kFanInUniform, generator);
  constexpr float kNearlyAlone = 5;
  choice_->weight.zero_();
  choice_->bias.zero_();
  choice_->bias[0] = kNearlyAlone;
}

PhotographBlending::Pair PhotographBlending::make_pair(torch::nn::Module& parent, const std::string& name,
                                                       const Widths& widths,
                                                       const ParameterPlacement& placement) {
  const auto pair = parent.register_module(name, std::make_shared<torch::nn::Module>());
  const auto convolution = [&](const char* own, int64_t inputs) {
    return pair->register_module(
        own, std::make_shared<Convolution>(same_size_convolution(inputs, widths.outputs, 3), placement));
  };
  auto first = convolution("first", widths.inputs);
  return {first, convolution("second", widths.outputs)};
}

Cost blending_cost(const BlendingOptions& options, int64_t height, int64_t width) {
  Cost cost;
  if (!options.exists()) return cost;
  const ImageSize seen = image_within(width, height, options.side);
  const auto whole = static_cast<double>(seen.width * seen.height);
  const auto& channels = options.channels;
  const auto add_pair = [&](size_t level, double inputs) {
    const double pixels = whole / std::pow(4.0, static_cast<double>(level));
    const auto own = static_cast<double>(channels[level]);
    add_convolution(cost, pixels, inputs, own, 3);
    add_convolution(cost, pixels, own, own, 3);
  };
  for (size_t i = 0; i < channels.size(); ++i)
    add_pair(i, static_cast<double>(i == 0 ? PhotographBlending::kInputs : channels[i - 1]));
  for (size_t i = 0; i + 1 < channels.size(); ++i)
    add_pair(i, static_cast<double>(channels[i] + channels[i + 1]));
  add_convolution(cost, whole, static_cast<double>(channels.front()), 1 + static_cast<double>(kHypotheses),
                  3);
  // Colours of all hypotheses, what the network sees of them, and its widest maps.
  cost.working_bytes =
      bytes_of_floats(whole * static_cast<double>(4 * (1 + kHypotheses) + PhotographBlending::kInputs +
                                                  4 * channels.front()));
  return cost;
}

BlendingCandidates blending_candidates(const PlacedPhotographs& placed, const PhotographView& view) {
  const int64_t height = view.height, width = view.width;
  std::vector<float> known(view.variance.size());
  for (size_t pixel = 0; pixel < known.size(); ++pixel) known[pixel] = view.shown(pixel) ? 1.0F : 0.0F;
  std::vector<torch::Tensor> colours = {plane(filled(view), height, width, 3)};
  std::vector<torch::Tensor> shown = {plane(known, height, width, 1)}, disagreement;
  for (const double factor : kDepthFactors) {
    const DepthHypothesis hypothesis = depth_hypothesis(placed, factor);
    colours.push_back(plane(hypothesis.rgb, height, width, 3));
    shown.push_back(plane(hypothesis.shown, height, width, 1));
    disagreement.push_back(plane(hypothesis.disagreement, height, width, 1));
  }
  return {torch::stack(colours), torch::cat(shown), torch::cat(disagreement), relative_depth(placed.depth)};
}

torch::Tensor blending_inputs(const BlendingCandidates& views) {
  const auto rule = views.colours.narrow(1, 0, 1);
  const auto hypotheses = views.colours.narrow(1, 1, kHypotheses),
             shown = views.shown.narrow(1, 1, kHypotheses);
  const auto off = torch::where(shown.unsqueeze(2) > 0, hypotheses - rule, torch::zeros({}, rule.options()));
  // All about as large as 1, where they say much.
  return torch::cat({rule.squeeze(1) - 0.5, views.shown.narrow(1, 0, 1), views.depth, 2 * off.flatten(1, 2),
                     8 * views.disagreement, shown - 0.5},
                    1);
}

torch::Tensor blending_shares(const BlendingCandidates& views, const torch::Tensor& logits) {
  const auto absent = torch::cat({torch::zeros_like(views.shown.narrow(1, 0, 1), torch::kBool),
                                  views.shown.narrow(1, 1, kHypotheses) <= 0},
                                 1);
  return logits.masked_fill(absent, -std::numeric_limits<float>::infinity()).softmax(1);
}

torch::Tensor blended(const BlendingCandidates& views, const torch::Tensor& shares) {
  return (views.colours * shares.unsqueeze(2)).sum(1);
}

torch::Tensor chosen_shares(const PhotographBlending& blending, const BlendingCandidates& views) {
  return blending_shares(views, blending.forward(blending_inputs(views)));
}

}  // namespace gld
