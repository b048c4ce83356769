// The full reference cases of the shared data; tests/data/reference_cases holds small ones of every kind.
#include "gld/files/weight_file.h"
#include "gld/tensors/weight_tensors.h"
#include "models/decoders/rgb_decoder.h"
#include "tests/support/data_folders.h"
#include "verify/reference_runners.h"
#include "verify/verification.h"

#include <filesystem>
#include <set>
#include <string>

#include <ATen/CPUGeneratorImpl.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

class SharedCases : public testing::TestWithParam<std::string> {};

TEST_P(SharedCases, EveryTensorIsWithinItsTolerance) {
  const auto result = verify_case(test::shared_data() / "goldens" / GetParam(), reference_runners());
  EXPECT_TRUE(result.passed()) << case_text(result);
  EXPECT_FALSE(result.tensors.empty());
}

INSTANTIATE_TEST_SUITE_P(Goldens, SharedCases,
                         testing::Values("backbone_da3", "camera", "dit_cascade", "dit_cascade_split",
                                         "dit_level1", "dit_special_cascade", "dit_special_level1",
                                         "dpt_head_da3", "lpips_squeeze", "metrics_image_depth", "pipeline",
                                         "rgb_decoder", "sample_level1", "train_diffusion"));

TEST(SharedCasesThatCameLater, EveryTensorIsWithinItsTolerance) {
  std::set<std::string> names;
  for (const auto& folder : std::filesystem::directory_iterator(test::shared_data() / "goldens_later")) {
    names.insert(folder.path().filename().string());
    const auto result = verify_case(folder.path(), reference_runners());
    EXPECT_TRUE(result.passed()) << case_text(result);
    EXPECT_FALSE(result.tensors.empty()) << folder.path();
  }
  EXPECT_THAT(names, testing::IsSupersetOf(
                         {"backbone_dinov2", "backbone_vggt", "dpt_head_vggt", "metrics_trajectory"}));
}

// Unrounded, where the case of the tree has multiples of 1/256.
TEST(SharedWeights, InitialPositionsOfTheDecoderAreThePublishedOnes) {
  const auto published =
      read_tensor(*WeightFile::open(test::shared_data() / "goldens" / "rgb_decoder" / "weights.safetensors"),
                  "decoder.decoder_pos_embed");
  RgbDecoderOptions options;
  options.in_channels = 8;
  options.hidden_size = published.size(2);
  options.num_heads = 4;
  options.num_layers = 1;
  options.intermediate_size = 8;
  RgbDecoder decoder(options, ParameterPlacement());
  decoder.initialise(at::detail::createCPUGenerator(4));
  const LatentGrid base = {1, 36, 36};
  EXPECT_LT((decoder.position_embedding(base) - published).abs().max().item<double>(), 1e-6);
}

// A whole third-party autoencoder, of which the tree has the first tensors.
TEST(SharedWeights, Taef2Loads) {
  struct Expected {
    const char* file;
    double sum;  // of all elements, computed independently in double
  };
  for (const auto& expected :
       {Expected{"taef2_decoder.pth", -627.3743234873}, Expected{"taef2_encoder.pth", 251.8470769525}}) {
    const auto file = WeightFile::open(test::shared_data() / "weights" / expected.file);
    EXPECT_EQ(file->format(), "PyTorch zip") << expected.file;
    ASSERT_EQ(file->entries().size(), 79U) << expected.file;
    double sum = 0;
    for (const auto& [name, tensor] : read_all(*file)) sum += tensor.to(torch::kFloat64).sum().item<double>();
    EXPECT_NEAR(sum, expected.sum, 1e-6) << expected.file;
  }
}

}  // namespace
}  // namespace gld
