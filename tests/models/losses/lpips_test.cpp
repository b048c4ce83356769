#include "models/losses/lpips.h"

#include "gld/tensors/weight_tensors.h"
#include "models/layers/initialisation.h"
#include "models/weights/weight_loading.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <map>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

struct Network {
  LpipsNet net;
  const char* heads_file;
  int64_t taps;
  int64_t minimum_side;
};

const std::vector<Network> kNetworks = {{LpipsNet::kSqueeze, "lpips_v0.1_squeeze.pth", 7, 17},
                                        {LpipsNet::kVgg, "lpips_v0.1_vgg.pth", 5, 16},
                                        {LpipsNet::kAlex, "lpips_v0.1_alex.pth", 5, 31}};

std::shared_ptr<Lpips> make_lpips(LpipsNet net) {
  LpipsOptions options;
  options.net = net;
  auto lpips = std::make_shared<Lpips>(options, ParameterPlacement());
  initialise_parameters(*lpips, MatrixInitialisation::kFanInUniform, at::detail::createCPUGenerator(7));
  return lpips;
}

torch::Tensor random_images(int64_t batch, int64_t height, int64_t width, uint64_t seed) {
  return torch::rand({batch, 3, height, width}, at::detail::createCPUGenerator(seed));
}

TEST(Lpips, LoadsThePublishedHeadsAndATorchvisionBackbone) {
  torch::NoGradGuard no_grad;
  const test::TemporaryFolder folder;
  for (const auto& network : kNetworks) {
    const auto source = make_lpips(network.net);
    std::map<std::string, torch::Tensor> torchvision;
    for (const auto& [name, tensor] : named_tensors(*source)) {
      if (name.rfind("features.", 0) == 0) torchvision[name] = tensor;
    }
    torchvision["classifier.1.weight"] = torch::zeros({2, 2});
    const auto file = folder.path() / "backbone.safetensors";
    save_safetensors(file, torchvision);
    const auto heads = WeightFile::open(test::test_data() / "weights" / network.heads_file);

    const auto loaded = make_lpips(network.net);
    load_lpips(*loaded, *WeightFile::open(file), *heads);
    for (int64_t k = 0; k < network.taps; ++k) {
      const auto name = "lin" + std::to_string(k) + ".model.1.weight";
      EXPECT_TRUE(torch::equal(named_tensors(*loaded).at(name), read_tensor(*heads, name))) << name;
    }
    // The published heads are non-negative, so the distance is a sum of squares.
    const auto a = random_images(2, 40, 36, 8), b = random_images(2, 40, 36, 9);
    const auto distance = loaded->forward(a, b);
    ASSERT_EQ(distance.sizes(), (std::vector<int64_t>{2}));
    EXPECT_GT(distance.min().item<double>(), 0);
    EXPECT_EQ(loaded->forward(a, a).abs().max().item<double>(), 0);
    EXPECT_LT((loaded->forward(b, a) - distance).abs().max().item<double>(), 1e-6);
    EXPECT_LT(
        (loaded->distance(loaded->features(a), loaded->features(b)) - distance).abs().max().item<double>(),
        1e-6);
  }
}

TEST(Lpips, WorksDownToItsMinimumSide) {
  torch::NoGradGuard no_grad;
  for (const auto& network : kNetworks) {
    const auto lpips = make_lpips(network.net);
    ASSERT_EQ(lpips->minimum_side(), network.minimum_side);
    const int64_t side = network.minimum_side;
    EXPECT_EQ(lpips->features(random_images(1, side, side, 1)).size(), static_cast<size_t>(network.taps));
    EXPECT_EQ(test::error_of([&] { lpips->features(random_images(1, side, side - 1, 1)); }),
              "LPIPS: expected RGB images (batch, 3, height, width) with sides of at least " +
                  std::to_string(side) + " pixels, found a tensor of shape [1, 3, " + std::to_string(side) +
                  ", " + std::to_string(side - 1) + "]; give larger images.");
  }
}

TEST(Lpips, GradientIsFiniteWhereAllFeaturesAreZero) {
  const auto lpips = make_lpips(LpipsNet::kVgg);
  {
    torch::NoGradGuard no_grad;
    for (auto& item : named_tensors(*lpips)) {
      if (item.first.find("bias") != std::string::npos) item.second.fill_(-100);  // every activation is off
    }
  }
  auto prediction = random_images(1, 24, 24, 3).requires_grad_();
  lpips->forward(random_images(1, 24, 24, 4), prediction).sum().backward();
  EXPECT_TRUE(torch::isfinite(prediction.grad()).all().item<bool>());
}

TEST(Lpips, RefusesOtherVersionsAndSizes) {
  LpipsOptions options;
  options.version = "0.0";
  EXPECT_EQ(test::error_of([&] { options.check(); }),
            "version: expected 0.1, found 0.0; use the heads of LPIPS version 0.1.");
  const auto lpips = make_lpips(LpipsNet::kSqueeze);
  EXPECT_EQ(test::error_of([&] { lpips->forward(random_images(1, 20, 20, 1), random_images(1, 20, 21, 1)); }),
            "LPIPS: expected two image batches of one shape, found [1, 3, 20, 20] and [1, 3, 20, 21]; "
            "compare images of the same size.");
}

}  // namespace
}  // namespace gld
