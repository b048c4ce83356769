// Every part of a model away from the CPU. On LibTorch's meta device tensors are shapes without numbers, and one that
// was left on the CPU is an error as it would be on a GPU. On a GPU (ctest -L gpu) the numbers are compared with the
// CPU's too.
#include "gld/tensors/device.h"
#include "models/backbones/da3_backbone.h"
#include "models/backbones/vggt_backbone.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"
#include "models/decoders/vggt_heads.h"
#include "models/dit/dit_field.h"
#include "models/dit/flow_matching_loss.h"
#include "models/layers/layer_precision.h"
#include "models/losses/perceptual_standin.h"
#include "tests/support/meta_device.h"
#include "tests/support/small_dit.h"

#include <string>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using Outputs = std::vector<std::pair<std::string, torch::Tensor>>;

constexpr int64_t kViews = 3, kSources = 2, kHeight = 28, kWidth = 42;  // pixels
const LatentGrid kGrid = {kViews, kHeight / 14, kWidth / 14};

bool is_meta(const torch::Device& device) { return device.type() == torch::kMeta; }

// Returns a module of the same weights on a device.
template <class Module, class Options>
std::shared_ptr<Module> on(const torch::Device& device, const Options& options) {
  const auto random = std::make_shared<Module>(options, ParameterPlacement());
  random->initialise(at::detail::createCPUGenerator(1));
  auto placed = std::make_shared<Module>(options, ParameterPlacement{device});
  if (!is_meta(device)) load_strict(*placed, named_tensors(*random), "the same on the CPU");
  return placed;
}

torch::Tensor random(torch::IntArrayRef shape, uint64_t seed, const torch::Device& device) {
  return torch::rand(shape, at::detail::createCPUGenerator(seed)).to(device);
}

DitOptions dit_options(DitConditioning conditioning, FlowPrediction prediction, int64_t special_tokens) {
  DitOptions options = test::small_dit_options();
  options.conditioning = conditioning;
  options.prediction = prediction;
  options.warped_sources = 2;
  options.carried_error = 0.1;
  options.num_special_tokens = special_tokens;
  if (special_tokens > 0) options.hidden_size[1] = options.in_channels;
  return options;
}

test::DitTestScene scene_on(const torch::Device& device, const DitOptions& options) {
  auto scene = test::random_dit_scene(options, {kViews, kSources, kWidth, kHeight});
  for (torch::Tensor* tensor : {&scene.noisy, &scene.inputs.source_features, &scene.inputs.deeper_level,
                                &scene.inputs.warp_agreement, &scene.inputs.warped_features}) {
    if (tensor->defined()) *tensor = tensor->to(device);
  }
  return scene;
}

// Sampling: both branches apart, in one pass, guided; with encoder and decoder of every kind of DiT^DH.
Outputs velocities(const torch::Device& device) {
  const torch::NoGradGuard no_grad;
  Outputs outputs;
  for (const int64_t special_tokens : {0, 1}) {
    for (const auto conditioning : {DitConditioning::kNone, DitConditioning::kDeeperLevel}) {
      for (const auto prediction : {FlowPrediction::kVelocity, FlowPrediction::kData}) {
        const auto options = dit_options(conditioning, prediction, special_tokens);
        const auto model = test::random_dit(options);
        auto placed = std::make_shared<DitDh>(options, ParameterPlacement{device});
        if (!is_meta(device)) load_strict(*placed, named_tensors(*model), "the same on the CPU");
        const auto scene = scene_on(device, options);
        DitField field(*placed, placed->prepare_scene(scene.inputs));
        field.prepare_times({1.0, 0.4});
        const int64_t reads = test::meta_reads();
        outputs.emplace_back("conditional", field.conditional(scene.noisy, 1.0));
        outputs.emplace_back("unconditional", field.unconditional(scene.noisy, 0.4));
        outputs.emplace_back("guided", field.guided(scene.noisy, 0.4, 1.5));
        field.set_batched(true);
        outputs.emplace_back("guided in one pass", field.guided(scene.noisy, 0.4, 1.5));
        EXPECT_EQ(test::meta_reads(), reads)
            << "the host waited for the device in the midst of an evaluation";
      }
    }
  }
  return outputs;
}

// Sampling in bfloat16: kernels of ours on the CPU, LibTorch's elsewhere.
Outputs velocities_in_bfloat16(const torch::Device& device) {
  const torch::NoGradGuard no_grad;
  DitOptions options = dit_options(DitConditioning::kDeeperLevel, FlowPrediction::kData, 1);
  const auto model = test::random_dit(options);
  auto placed = std::make_shared<DitDh>(options, ParameterPlacement{device});
  if (!is_meta(device)) load_strict(*placed, named_tensors(*model), "the same on the CPU");
  const auto scene = scene_on(device, options);
  LayerPrecision layers = layer_precision(ComputePrecision::kBFloat16, ModelKind::kGenerator);
  layers.originals = PackedOriginals::kRelease;
  use_precision(*placed, layers);
  int64_t rounded = 0;
  for (const auto& parameter : placed->parameters()) {
    rounded += parameter.dim() == 2 && parameter.storage().nbytes() == 4 ? 1 : 0;
  }
  EXPECT_GT(rounded, 10) << "layers that multiply in bfloat16";
  DitField field(*placed, placed->prepare_scene(scene.inputs));
  field.prepare_times({0.4});
  return {{"guided", field.guided(scene.noisy, 0.4, 1.5)}};
}

// Training: the loss and all gradients, activations kept and computed again.
Outputs gradients(const torch::Device& device) {
  Outputs outputs;
  const auto options = dit_options(DitConditioning::kNone, FlowPrediction::kData, 1);
  const auto model = test::random_dit(options);
  for (const auto storage : {ActivationStorage::kKeep, ActivationStorage::kRecompute}) {
    auto placed = std::make_shared<DitDh>(options, ParameterPlacement{device});
    if (!is_meta(device)) load_strict(*placed, named_tensors(*model), "the same on the CPU");
    placed->set_activation_storage(storage);
    const auto scene = scene_on(device, options);
    FlowMatchingDraw draw;
    draw.clean = random(scene.noisy.sizes(), 3, device);
    draw.noise = scene.noisy;
    draw.time = 0.4;
    const int64_t reads = test::meta_reads();
    const auto errors = flow_matching_errors(*placed, scene.inputs, draw);
    errors.all.backward();
    EXPECT_EQ(test::meta_reads(), reads) << "the host waited for the device in the midst of a step";
    outputs.emplace_back("loss", errors.all.detach());
    for (const auto& item : placed->named_parameters()) {
      if (!item.value().requires_grad()) continue;
      EXPECT_TRUE(item.value().grad().defined()) << item.key();
      if (item.value().grad().defined()) outputs.emplace_back(item.key(), item.value().grad());
    }
  }
  return outputs;
}

template <class BackboneModule, class Options>
void add_backbone(const torch::Device& device, const Options& options, Outputs& outputs) {
  const torch::NoGradGuard no_grad;
  const auto backbone = on<BackboneModule>(device, options);
  const auto images = random({kViews, 3, kHeight, kWidth}, 5, device);
  const auto levels = backbone->encode(images, 3);
  for (const auto& level : levels) outputs.emplace_back("level", level);
  const int64_t leading = backbone->architecture().leading_tokens();
  outputs.emplace_back("leading tokens for propagation",
                       backbone->leading_for_propagation(images.narrow(0, 0, 1), 1));
  PropagationStart start;
  start.level = 1;
  start.tokens = levels[1];
  start.grid = kGrid;
  for (const auto& level : backbone->propagate(start)) {
    outputs.emplace_back("propagated", level.patches);
    EXPECT_EQ(level.leading.size(1), leading);
  }
}

Outputs backbones(const torch::Device& device) {
  Outputs outputs;
  Da3BackboneOptions da3;
  da3.embed_dim = 48;
  da3.num_heads = 3;
  da3.pos_embed_grid = 5;
  add_backbone<Da3Backbone>(device, da3, outputs);
  VggtBackboneOptions vggt;
  vggt.embed_dim = 32;
  vggt.num_heads = 2;
  vggt.depth = 4;
  vggt.pos_embed_grid = 4;
  vggt.out_layers = {0, 1, 2, 3};
  vggt.patch_embed.sizes.depth = 1;
  add_backbone<VggtBackbone>(device, vggt, outputs);
  return outputs;
}

Outputs decoders(const torch::Device& device) {
  Outputs outputs;
  RgbDecoderOptions rgb;
  rgb.in_channels = 20;
  rgb.hidden_size = 24;
  rgb.num_layers = 2;
  rgb.num_heads = 3;
  rgb.intermediate_size = 40;
  rgb.base_image_size = 28;
  rgb.refinement_channels = 8;
  const auto decoder = on<RgbDecoder>(device, rgb);
  const auto images =
      decoder->decode(random({kViews, kGrid.tokens_per_view(), rgb.in_channels}, 7, device), kGrid);
  const auto truth = random(images.sizes(), 8, device);
  const auto loss = perceptual_standin(truth, images, {}).mean() + (images - truth).abs().mean();
  outputs.emplace_back("images", images.detach());
  outputs.emplace_back("loss", loss.detach());

  const torch::NoGradGuard no_grad;
  const auto levels = [&](int64_t tokens, int64_t channels) {
    std::vector<torch::Tensor> made;
    for (uint64_t level = 0; level < 4; ++level) {
      made.push_back(random({kViews, tokens, channels}, 10 + level, device));
    }
    return made;
  };
  DptHeadOptions dpt;
  dpt.dim_in = 24;
  dpt.features = 16;
  dpt.out_channels = {8, 12, 16, 20};
  const auto maps = on<DptHead>(device, dpt)
                        ->forward(levels(kGrid.tokens_per_view(), 24), kGrid, GeometryMaps::kDepthAndRays);
  VggtHeadsOptions vggt;
  vggt.dim_in = 32;
  vggt.features = 16;
  vggt.out_channels = {8, 8, 12, 16};
  vggt.camera.trunk_depth = 1;
  vggt.camera.num_heads = 2;
  GeometryInputs inputs;
  inputs.levels = levels(kGrid.tokens_per_view(), 32);
  inputs.leading = random({kViews, 5, 32}, 20, device);
  const auto vggt_maps = on<VggtHeads>(device, vggt)->forward(inputs, kGrid, GeometryMaps::kDepthAndRays);
  for (const auto* made : {&maps, &vggt_maps}) {
    outputs.emplace_back("depth", made->depth);
    outputs.emplace_back("depth confidence", made->depth_confidence);
    outputs.emplace_back("rays", made->rays);
  }
  return outputs;
}

class ModelsOnDevice : public testing::TestWithParam<torch::DeviceType> {
 protected:
  // Products of a GPU sum in another order, over at most a few hundred terms a layer.
  static void check(Outputs (*parts)(const torch::Device&), double tolerance = 1e-4) {
    const torch::Device device = GetParam() == torch::kCUDA ? device_from_text("cuda") : GetParam();
    const Outputs expected = parts(torch::kCPU), found = parts(device);
    ASSERT_EQ(found.size(), expected.size());
    for (size_t i = 0; i < found.size(); ++i) {
      const auto& [name, tensor] = found[i];
      EXPECT_EQ(tensor.device().type(), device.type()) << name;
      EXPECT_EQ(tensor.sizes(), expected[i].second.sizes()) << name;
      EXPECT_EQ(tensor.scalar_type(), torch::kFloat32) << name;
      if (is_meta(device)) continue;
      const auto reference = expected[i].second.to(torch::kFloat64);
      const auto error = (tensor.to(torch::kCPU, torch::kFloat64) - reference).norm().item<double>();
      EXPECT_LE(error, tolerance * std::max(1e-3, reference.norm().item<double>())) << name;
    }
  }
};

TEST_P(ModelsOnDevice, FlowsAreSampled) { check(velocities); }
TEST_P(ModelsOnDevice, FlowsAreSampledInBfloat16) { check(velocities_in_bfloat16, 2e-2); }
TEST_P(ModelsOnDevice, FlowsAreTrained) { check(gradients); }
TEST_P(ModelsOnDevice, BackbonesEncodeAndPropagate) { check(backbones); }
TEST_P(ModelsOnDevice, DecodersMakePicturesAndGeometry) { check(decoders); }

INSTANTIATE_TEST_SUITE_P(Meta, ModelsOnDevice, testing::Values(torch::kMeta));
INSTANTIATE_TEST_SUITE_P(on_gpu, ModelsOnDevice, testing::Values(torch::kCUDA));

}  // namespace
}  // namespace gld
