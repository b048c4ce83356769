#include "models/losses/lpips_features.h"

#include "models/layers/convolution.h"

#include <memory>

namespace gld {
namespace {

// SqueezeNet's module (Iandola et al. 2016): a 1x1 layer, then 1x1 and 3x3 layers side by side.
class Fire : public torch::nn::Module {
 public:
  struct Sizes {
    int64_t inputs = 0;
    int64_t squeezed = 0;
    int64_t expanded = 0;  // of each of the two
  };
  Fire(const Sizes& sizes, const ParameterPlacement& placement) {
    squeeze_ = register_module(
        "squeeze",
        std::make_shared<Convolution>(same_size_convolution(sizes.inputs, sizes.squeezed, 1), placement));
    expand1_ = register_module(
        "expand1x1",
        std::make_shared<Convolution>(same_size_convolution(sizes.squeezed, sizes.expanded, 1), placement));
    expand3_ = register_module(
        "expand3x3",
        std::make_shared<Convolution>(same_size_convolution(sizes.squeezed, sizes.expanded, 3), placement));
  }
  torch::Tensor forward(const torch::Tensor& x) const {
    const auto squeezed = torch::relu(squeeze_->forward(x));
    return torch::relu(torch::cat({expand1_->forward(squeezed), expand3_->forward(squeezed)}, 1));
  }

 private:
  std::shared_ptr<Convolution> squeeze_, expand1_, expand3_;
};

}  // namespace

LpipsFeatures::LpipsFeatures(LpipsNet net, const ParameterPlacement& placement) {
  if (net == LpipsNet::kSqueeze) build_squeeze(placement);
  if (net == LpipsNet::kVgg) build_vgg(placement);
  if (net == LpipsNet::kAlex) build_alex(placement);
}

void LpipsFeatures::add_tap(int64_t channels) {
  taps_.push_back(steps_.size());
  channels_.push_back(channels);
}

void LpipsFeatures::build_squeeze(const ParameterPlacement& placement) {
  minimum_side_ = 17;
  auto stem = same_size_convolution(3, 64, 3);
  stem.stride = 2;
  stem.padding = 0;
  const auto first = register_module("0", std::make_shared<Convolution>(stem, placement));
  steps_.push_back([first](const torch::Tensor& x) { return torch::relu(first->forward(x)); });
  add_tap(64);
  const auto pool = [this] {
    steps_.push_back([](const torch::Tensor& x) {
      return torch::max_pool2d(x, {3, 3}, {2, 2}, {0, 0}, {1, 1}, /*ceil_mode=*/true);
    });
  };
  const auto fire = [&](const char* name, const Fire::Sizes& sizes) {
    const auto layer = register_module(name, std::make_shared<Fire>(sizes, placement));
    steps_.push_back([layer](const torch::Tensor& x) { return layer->forward(x); });
  };
  pool();
  fire("3", {64, 16, 64});
  fire("4", {128, 16, 64});
  add_tap(128);
  pool();
  fire("6", {128, 32, 128});
  fire("7", {256, 32, 128});
  add_tap(256);
  pool();
  fire("9", {256, 48, 192});
  add_tap(384);
  fire("10", {384, 48, 192});
  add_tap(384);
  fire("11", {384, 64, 256});
  add_tap(512);
  fire("12", {512, 64, 256});
  add_tap(512);
}

void LpipsFeatures::build_vgg(const ParameterPlacement& placement) {
  minimum_side_ = 16;
  struct Stage {
    int64_t channels;
    int64_t convolutions;
  };
  const std::vector<Stage> stages = {{64, 2}, {128, 2}, {256, 3}, {512, 3}, {512, 3}};
  int64_t inputs = 3;
  int64_t number = 0;  // torchvision counts activations and poolings as layers
  for (size_t stage = 0; stage < stages.size(); ++stage) {
    if (stage > 0) {
      steps_.push_back([](const torch::Tensor& x) { return torch::max_pool2d(x, {2, 2}, {2, 2}); });
      ++number;
    }
    for (int64_t i = 0; i < stages[stage].convolutions; ++i, number += 2) {
      const auto layer = register_module(
          std::to_string(number),
          std::make_shared<Convolution>(same_size_convolution(inputs, stages[stage].channels, 3), placement));
      steps_.push_back([layer](const torch::Tensor& x) { return torch::relu(layer->forward(x)); });
      inputs = stages[stage].channels;
    }
    add_tap(stages[stage].channels);
  }
}

void LpipsFeatures::build_alex(const ParameterPlacement& placement) {
  minimum_side_ = 31;
  const auto layer = [&](const char* name, const ConvolutionSizes& sizes) {
    const auto convolution = register_module(name, std::make_shared<Convolution>(sizes, placement));
    steps_.push_back([convolution](const torch::Tensor& x) { return torch::relu(convolution->forward(x)); });
    add_tap(sizes.out_channels);
  };
  const auto pool = [this] {
    steps_.push_back([](const torch::Tensor& x) { return torch::max_pool2d(x, {3, 3}, {2, 2}); });
  };
  auto stem = same_size_convolution(3, 64, 11);
  stem.stride = 4;
  stem.padding = 2;
  layer("0", stem);
  pool();
  layer("3", same_size_convolution(64, 192, 5));
  pool();
  layer("6", same_size_convolution(192, 384, 3));
  layer("8", same_size_convolution(384, 256, 3));
  layer("10", same_size_convolution(256, 256, 3));
}

std::vector<torch::Tensor> LpipsFeatures::forward(const torch::Tensor& x) const {
  std::vector<torch::Tensor> maps;
  auto current = x;
  size_t tap = 0;
  for (size_t step = 0; step < steps_.size(); ++step) {
    current = steps_[step](current);
    if (tap < taps_.size() && taps_[tap] == step + 1) {
      maps.push_back(current);
      ++tap;
    }
  }
  return maps;
}

}  // namespace gld
