#include "models/decoders/rgb_decoder.h"

#include "gld/base/configuration.h"
#include "gld/tensors/weight_tensors.h"
#include "models/decoders/pixel_refinement.h"
#include "models/layers/imagenet.h"
#include "models/weights/weight_loading.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

RgbDecoderOptions small_rgb_decoder() {
  RgbDecoderOptions options;
  options.in_channels = 20;
  options.hidden_size = 24;
  options.num_layers = 2;
  options.num_heads = 3;
  options.intermediate_size = 40;
  options.patch_size = 4;
  options.base_image_size = 24;
  return options;
}

std::shared_ptr<RgbDecoder> random_decoder(const RgbDecoderOptions& options) {
  auto decoder = std::make_shared<RgbDecoder>(options, ParameterPlacement());
  decoder->initialise(at::detail::createCPUGenerator(4));
  return decoder;
}

TEST(RgbDecoder, InitialPositionsAreThePublishedOnes) {
  const auto published = read_tensor(
      *WeightFile::open(test::test_data() / "reference_cases" / "rgb_decoder" / "weights.safetensors"),
      "decoder.decoder_pos_embed");
  RgbDecoderOptions options;
  options.in_channels = 8;
  options.hidden_size = published.size(2);
  options.num_heads = 3;
  options.num_layers = 1;
  options.intermediate_size = 8;
  options.base_image_size = 112;
  const auto decoder = random_decoder(options);
  const LatentGrid base = {1, 8, 8};
  // The case stores them as multiples of 1/256; shared_cases_test compares unrounded ones.
  EXPECT_LE((decoder->position_embedding(base) - published).abs().max().item<double>(), 0x1p-9 + 1e-6);
}

TEST(RgbDecoder, UnpatchifyPutsEveryPixelInItsPlace) {
  const auto decoder = random_decoder(small_rgb_decoder());
  const LatentGrid grid = {2, 3, 2};
  const auto logits = torch::arange(2 * 6 * 48, torch::kFloat32).view({2, 6, 48});
  const auto image = decoder->unpatchify(logits, grid);
  ASSERT_EQ(image.sizes(), (std::vector<int64_t>{2, 3, 12, 8}));
  // View 1, patch row 2, patch column 1, pixel (row 3, column 2) of the patch, blue.
  EXPECT_EQ(image[1][2][2 * 4 + 3][4 + 2].item<float>(), 1 * 6 * 48 + 5 * 48 + (3 * 4 + 2) * 3 + 2);
}

TEST(RgbDecoder, AViewDoesNotDependOnTheOthersOrOnItsChunk) {
  torch::NoGradGuard no_grad;
  const auto decoder = random_decoder(small_rgb_decoder());
  // 1025 tokens a view: five views are cut into 3 + 2.
  const LatentGrid grid = {5, 32, 32}, one = {1, 32, 32};
  const auto features = torch::randn({5, 1024, 20}, at::detail::createCPUGenerator(5));
  const auto all = decoder->decode(features, grid);
  EXPECT_EQ(all.sizes(), (std::vector<int64_t>{5, 3, 128, 128}));
  for (const int64_t view : {0, 2, 4}) {
    const auto alone = decoder->decode(features.narrow(0, view, 1), one);
    EXPECT_LT((alone[0] - all[view]).abs().max().item<double>(), 1e-5);
  }
}

TEST(RgbDecoder, ARefinementBeginsWithNothing) {
  const torch::NoGradGuard no_grad;
  RgbDecoderOptions options = small_rgb_decoder();
  const auto published = random_decoder(options);
  for (const auto& item : published->named_parameters()) {
    EXPECT_EQ(item.key().find("refinement"), std::string::npos) << item.key();
  }
  options.refinement_channels = 5;
  options.refinement_layers = 3;
  const auto decoder = random_decoder(options);
  const LatentGrid grid = {2, 3, 4};
  const auto features = torch::randn({2, 12, 20}, at::detail::createCPUGenerator(5));
  const auto drawn = imagenet_denormalise(decoder->unpatchify(decoder->logits(features, grid), grid));
  EXPECT_TRUE(torch::equal(decoder->decode(features, grid), drawn));

  auto parameters = decoder->named_parameters();
  ASSERT_EQ(parameters["refinement.0.weight"].sizes(), (std::vector<int64_t>{5, 3, 3, 3}));
  ASSERT_EQ(parameters["refinement.1.weight"].sizes(), (std::vector<int64_t>{5, 5, 3, 3}));
  ASSERT_EQ(parameters["refinement.2.weight"].sizes(), (std::vector<int64_t>{3, 5, 3, 3}));
  parameters["refinement.2.weight"].fill_(0.1);
  const auto refined = decoder->decode(features, grid);
  ASSERT_EQ(refined.sizes(), drawn.sizes());
  EXPECT_GT((refined - drawn).abs().mean().item<double>(), 1e-3);
  const auto alone = decoder->decode(features.narrow(0, 1, 1), {1, 3, 4});
  EXPECT_LT((alone[0] - decoder->decode(features, grid)[1]).abs().max().item<double>(), 1e-5);
}

TEST(PixelRefinement, LooksAsFarAsItsLayersReach) {
  const torch::NoGradGuard no_grad;
  PixelRefinement refinement({6, 3}, ParameterPlacement());
  refinement.initialise(at::detail::createCPUGenerator(2));
  refinement.named_parameters()["2.weight"].fill_(0.3);
  const auto pixels = torch::randn({1, 3, 16, 16}, at::detail::createCPUGenerator(3));
  auto touched = pixels.clone();
  touched[0][1][8][8] += 10;
  const auto moved = (refinement.forward(touched) - refinement.forward(pixels)).abs().sum(1)[0];
  EXPECT_GT(moved[8][5].item<float>(), 0);
  EXPECT_GT(moved[11][11].item<float>(), 0);
  EXPECT_EQ(moved[8][4].item<float>(), 0);
  EXPECT_EQ(moved[12][8].item<float>(), 0);
}

TEST(RgbDecoder, NeverTrainsItsPositions) {
  const auto decoder = random_decoder(small_rgb_decoder());
  const LatentGrid grid = {1, 2, 3};
  decoder->decode(torch::randn({1, 6, 20}), grid).sum().backward();
  for (const auto& item : decoder->named_parameters()) {
    EXPECT_NE(item.key(), "decoder_pos_embed");
    EXPECT_TRUE(item.value().grad().defined()) << item.key();
  }
  EXPECT_FALSE(decoder->position_embedding(grid).requires_grad());
}

TEST(RgbDecoder, ImagenetNormalisationIsInverted) {
  const auto images = torch::rand({2, 3, 4, 5}, at::detail::createCPUGenerator(6));
  EXPECT_LT((imagenet_denormalise(imagenet_normalise(images)) - images).abs().max().item<double>(), 1e-6);
  EXPECT_NEAR(imagenet_normalise(torch::ones({1, 3, 1, 1}))[0][2][0][0].item<double>(), (1 - 0.406) / 0.225,
              1e-6);
  EXPECT_EQ(test::error_of([] {
              imagenet_normalise(torch::zeros({1, 1, 2, 2}));
            }),
            "ImageNet normalisation: expected floating-point RGB images (views, 3, height, width), "
            "found a tensor of shape [1, 1, 2, 2]; convert the images to RGB in [0, 1].");
}

TEST(RgbDecoder, RefusesWhatDoesNotFitInOneSentence) {
  const auto decoder = random_decoder(small_rgb_decoder());
  const LatentGrid grid = {2, 2, 2};
  EXPECT_EQ(test::error_of([&] {
              decoder->logits(torch::zeros({2, 5, 20}), grid);
            }),
            "RGB decoder: expected features of shape [2, 4, 20], found [2, 5, 20]; "
            "concatenate the four decodable levels on channels.");
  auto options = small_rgb_decoder();
  options.num_heads = 5;
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "hidden_size: expected a multiple of num_heads 5 and of 4, found 24; change hidden_size or num_heads.");
  options = small_rgb_decoder();
  options.base_image_size = 30;
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "base_image_size: expected a multiple of patch_size 4, found 30; "
            "change base_image_size or patch_size.");
}

}  // namespace
}  // namespace gld
