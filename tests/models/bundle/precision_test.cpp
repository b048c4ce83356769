#include "gld/files/weight_file.h"
#include "gld/tensors/weight_tensors.h"
#include "models/backbones/da3_backbone.h"
#include "models/decoders/dpt_head.h"
#include "models/decoders/rgb_decoder.h"
#include "models/weights/weight_loading.h"
#include "tests/support/data_folders.h"

#include <map>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Backbone, DPT head and RGB decoder of the reference pipeline.
struct FrozenModules {
  std::shared_ptr<Backbone> backbone;
  std::shared_ptr<DptHead> head;
  std::shared_ptr<RgbDecoder> decoder;
};

void load(torch::nn::Module& module, const std::string& prefix, const WeightFile& file) {
  WeightSelection selection;
  selection.prefix = prefix;
  load_strict(module, file, selection);
}

FrozenModules reference_modules(torch::Dtype dtype) {
  ParameterPlacement placement;
  placement.dtype = dtype;
  Da3BackboneOptions backbone;
  backbone.embed_dim = 32;
  backbone.num_heads = 2;
  backbone.pos_embed_grid = 6;
  DptHeadOptions head;
  head.dim_in = 64;
  head.features = 8;
  head.out_channels = {8, 8, 12, 16};
  RgbDecoderOptions decoder;
  decoder.in_channels = 256;
  decoder.hidden_size = 32;
  decoder.num_layers = 2;
  decoder.num_heads = 2;
  decoder.intermediate_size = 64;
  decoder.base_image_size = 84;
  FrozenModules modules = {std::make_shared<Da3Backbone>(backbone, placement),
                           std::make_shared<DptHead>(head, placement),
                           std::make_shared<RgbDecoder>(decoder, placement)};
  const auto weights =
      WeightFile::open(test::test_data() / "reference_cases" / "pipeline" / "weights.safetensors");
  load(*modules.backbone, backbone.published_prefix(), *weights);
  load(*modules.head, DptHead::kPrefix, *weights);
  load(*modules.decoder, RgbDecoder::kPrefix, *weights);
  return modules;
}

// Makes of images, (views, 3, height, width) in [0, 1], the levels, the maps and the images.
std::map<std::string, torch::Tensor> run(const FrozenModules& modules, const torch::Tensor& images) {
  const auto grid = modules.backbone->architecture().grid_of(images.size(0), images.size(2), images.size(3));
  std::map<std::string, torch::Tensor> results;
  std::vector<torch::Tensor> decodable;
  for (const auto& level : modules.backbone->encode(images, 3)) {
    results["level" + std::to_string(decodable.size())] = level;
    decodable.push_back(modules.backbone->decodable(level).patches);
  }
  const auto maps = modules.head->forward(decodable, grid, GeometryMaps::kDepthAndRays);
  results["depth"] = maps.depth;
  results["depth_confidence"] = maps.depth_confidence;
  results["rays"] = maps.rays;
  results["ray_confidence"] = maps.ray_confidence;
  results["image"] = modules.decoder->decode(torch::cat(decodable, -1), grid);
  return results;
}

TEST(Precision, SinglePrecisionIsWithin1e5OfDouble) {
  torch::NoGradGuard no_grad;
  const auto images = torch::rand({3, 3, 70, 42}, at::detail::createCPUGenerator(11));
  const auto single = run(reference_modules(torch::kFloat32), images);
  const auto twice = run(reference_modules(torch::kFloat64), images.to(torch::kFloat64));
  ASSERT_EQ(single.size(), 9u);
  for (const auto& [name, reference] : twice) {
    ASSERT_EQ(reference.scalar_type(), torch::kFloat64) << name;
    const auto error = (single.at(name).to(torch::kFloat64) - reference).abs().max() / reference.abs().max();
    EXPECT_LT(error.item<double>(), 1e-5) << name;
  }
}

TEST(Precision, ConstantAndExtremeImagesGiveFiniteResults) {
  torch::NoGradGuard no_grad;
  const auto modules = reference_modules(torch::kFloat32);
  std::vector<torch::Tensor> cases;
  for (const double value : {0.0, 1.0, 0.5, 1e6, -1e6}) cases.push_back(torch::full({2, 3, 28, 42}, value));
  cases.push_back(torch::rand({1, 3, 14, 112}, at::detail::createCPUGenerator(12)));  // 1:8
  cases.push_back(torch::rand({1, 3, 112, 14}, at::detail::createCPUGenerator(13)));
  for (const auto& images : cases) {
    for (const auto& [name, result] : run(modules, images)) {
      EXPECT_TRUE(torch::isfinite(result).all().item<bool>()) << name << " of " << images.sizes();
    }
  }
}

}  // namespace
}  // namespace gld
