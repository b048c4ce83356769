// The parts of training that live in models/: perceptual stand-in, discriminators, activation checkpointing.
#include "gld/tensors/weight_tensors.h"
#include "models/layers/activation_checkpoint.h"
#include "models/losses/dino_discriminator.h"
#include "models/losses/discriminator.h"
#include "models/losses/perceptual_standin.h"
#include "models/weights/weight_loading.h"
#include "tests/support/error_of.h"
#include "tests/support/small_dit.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <map>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>
#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

torch::Generator generator(uint64_t seed) { return at::detail::createCPUGenerator(seed); }

torch::Tensor random_images(int64_t batch, int64_t side, uint64_t seed) {
  return torch::rand({batch, 3, side, side}, generator(seed), torch::kFloat32);
}

TEST(PerceptualStandin, IsZeroForEqualImagesAndGrowsWithBlur) {
  const auto image = random_images(2, 32, 1);
  EXPECT_LT(perceptual_standin(image, image, {}).abs().max().item<float>(), 1e-6F);
  const auto slightly = 0.9 * image + 0.1 * image.mean();
  const auto strongly = 0.3 * image + 0.7 * image.mean();
  const auto little = perceptual_standin(image, slightly, {}), much = perceptual_standin(image, strongly, {});
  EXPECT_EQ(little.sizes(), (std::vector<int64_t>{2}));
  EXPECT_TRUE(much.gt(little).all().item<bool>());
}

TEST(PerceptualStandin, ItsGradientMatchesDifferences) {
  const auto image = random_images(1, 16, 2).to(torch::kFloat64);
  auto prediction = random_images(1, 16, 3).to(torch::kFloat64).requires_grad_(true);
  PerceptualStandinOptions options;
  options.edge_weight = 1;
  perceptual_standin(image, prediction, options).sum().backward();
  const auto direction = torch::randn(prediction.sizes(), generator(4), torch::kFloat64);
  const double step = 1e-6;
  const torch::NoGradGuard no_grad;
  const auto up = perceptual_standin(image, prediction + step * direction, options).sum();
  const auto down = perceptual_standin(image, prediction - step * direction, options).sum();
  EXPECT_NEAR((prediction.grad() * direction).sum().item<double>(), ((up - down) / (2 * step)).item<double>(),
              1e-5);
}

// Of an edge whose place is not known to a few pixels, a blurred picture is the best guess by differences of pixels; by
// the strength of edges a sharp one somewhere is.
TEST(PerceptualStandin, EdgesAsStrongElsewhereAreBetterThanBlurredOnes) {
  const auto edge_at = [](int64_t column) {
    auto image = torch::zeros({1, 3, 32, 32});
    image.slice(3, column).fill_(1);
    return image;
  };
  const auto blurred = (edge_at(14) + edge_at(16) + edge_at(18)) / 3;
  PerceptualStandinOptions edges;
  edges.scales = 1;
  edges.gradient_weight = edges.similarity_weight = 0;
  edges.edge_weight = 1;
  const auto distance = [&](const torch::Tensor& image) {
    return perceptual_standin(edge_at(16), image, edges).item<double>();
  };
  EXPECT_EQ(distance(edge_at(16)), 0);
  EXPECT_LT(distance(edge_at(17)), 0.7 * distance(blurred));
  EXPECT_LT(distance(blurred), 0.7 * distance(torch::full({1, 3, 32, 32}, 0.5)));
  PerceptualStandinOptions differences;
  differences.scales = 1;
  differences.similarity_weight = 0;
  const auto expected = [&](const torch::Tensor& image) {
    double sum = 0;
    for (const int64_t column : {14, 16, 18}) {
      sum += perceptual_standin(edge_at(column), image, differences).item<double>();
    }
    return sum;
  };
  EXPECT_LE(expected(blurred), expected(edge_at(16)) + 1e-6);
}

// The strength of both: where an image has no edge at all the root's slope is still finite.
TEST(PerceptualStandin, TheStrengthOfEdgesHasAGradientOnFlatImages) {
  PerceptualStandinOptions edges;
  edges.edge_weight = 1;
  auto flat = torch::full({1, 3, 16, 16}, 0.5).requires_grad_(true);
  perceptual_standin(random_images(1, 16, 2), flat, edges).sum().backward();
  EXPECT_TRUE(flat.grad().isfinite().all().item<bool>());
}

TEST(PerceptualStandin, RefusesImagesSmallerThanItsWindow) {
  const auto image = random_images(1, 6, 1);
  EXPECT_EQ(test::error_of([&] { perceptual_standin(image, image, {}); }),
            "perceptual loss: expected two batches of images of one shape with sides of at least 7 pixels, "
            "found [1, 3, 6, 6] and [1, 3, 6, 6]; check the image size.");
}

// Both discriminators must learn to tell noise from smooth images.
void learns_to_tell(Discriminator& discriminator, int64_t side, double rate) {
  discriminator.initialise(generator(5));
  discriminator.train();
  const auto real = 2.0 * random_images(4, side, 6) - 1.0;
  const auto ramp = torch::linspace(-1.0, 1.0, side).expand({4, 3, side, side});
  const auto fake = 0.9 * ramp + 0.1 * (2.0 * random_images(4, side, 7) - 1.0);
  double first = 0.0, last = 0.0;
  for (int step = 0; step < 30; ++step) {
    for (auto& parameter : discriminator.parameters()) {
      if (parameter.grad().defined()) parameter.mutable_grad().zero_();
    }
    const auto loss = torch::relu(1.0 - discriminator.logits(real)).mean() +
                      torch::relu(1.0 + discriminator.logits(fake)).mean();
    loss.backward();
    const torch::NoGradGuard no_grad;
    for (auto& parameter : discriminator.parameters()) parameter.sub_(rate * parameter.grad());
    if (step == 0) first = loss.item<double>();
    last = loss.item<double>();
  }
  EXPECT_LT(last, 0.7 * first);
}

TEST(Discriminator, TheConvolutionalOneLearns) {
  ConvolutionalDiscriminatorOptions options;
  options.channels = 8;
  ConvolutionalDiscriminator discriminator(options, {});
  learns_to_tell(discriminator, 32, 0.05);
  EXPECT_EQ(discriminator.logits(random_images(2, 32, 8)).sizes(), (std::vector<int64_t>{2, 16}));
}

DinoDiscriminatorOptions small_dino() {
  DinoDiscriminatorOptions options;
  options.embed_dim = 32;
  options.depth = 3;
  options.num_heads = 2;
  options.image_size = 32;
  options.key_depths = {0, 2};
  options.kernel_size = 3;
  return options;
}

// Writes a file with DINO's names, as torch.hub publishes them.
std::filesystem::path write_small_dino(const std::filesystem::path& folder) {
  std::map<std::string, torch::Tensor> tensors;
  const auto draw = [&tensors](const std::string& name, const std::vector<int64_t>& shape) {
    tensors[name] = 0.2 * torch::randn(shape, generator(tensors.size() + 1), torch::kFloat32);
  };
  draw("patch_embed.proj.weight", {32, 3, 8, 8});
  draw("patch_embed.proj.bias", {32});
  draw("cls_token", {1, 1, 32});
  draw("pos_embed", {1, 17, 32});
  for (int block = 0; block < 3; ++block) {
    const std::string prefix = "blocks." + std::to_string(block) + ".";
    for (const char* norm : {"norm1", "norm2"}) {
      draw(prefix + norm + ".weight", {32});
      draw(prefix + norm + ".bias", {32});
    }
    draw(prefix + "attn.qkv.weight", {96, 32});
    draw(prefix + "attn.qkv.bias", {96});
    draw(prefix + "attn.proj.weight", {32, 32});
    draw(prefix + "attn.proj.bias", {32});
    draw(prefix + "mlp.fc1.weight", {128, 32});
    draw(prefix + "mlp.fc1.bias", {128});
    draw(prefix + "mlp.fc2.weight", {32, 128});
    draw(prefix + "mlp.fc2.bias", {32});
  }
  draw("norm.weight", {32});
  draw("norm.bias", {32});
  save_safetensors(folder / "dino.safetensors", tensors);
  return folder / "dino.safetensors";
}

TEST(Discriminator, TheDinoOneTrainsItsHeadsOnly) {
  const test::TemporaryFolder folder;
  DinoDiscriminator discriminator(small_dino(), {});
  discriminator.load_dino(*WeightFile::open(write_small_dino(folder.path())));
  for (const auto& item : discriminator.named_parameters()) {
    EXPECT_EQ(item.key().rfind("heads.", 0), 0U) << item.key();
  }
  const auto names = named_tensors(discriminator);
  for (const char* name :
       {"heads.0.0.0.weight_orig", "heads.2.1.fn.0.weight_u", "heads.1.1.fn.1.bias", "heads.0.2.weight_v"}) {
    EXPECT_EQ(names.count(name), 1U) << name;
  }
  learns_to_tell(discriminator, 48, 0.5);
  // One logit a token of each of three depths.
  EXPECT_EQ(discriminator.logits(random_images(2, 48, 8)).sizes(), (std::vector<int64_t>{2, 48}));
}

TEST(Discriminator, TheDinoOneNamesABlockThatIsNotThere) {
  DinoDiscriminatorOptions options = small_dino();
  options.key_depths = {0, 3};
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "discriminator.key_depths: expected blocks from 0 to 2, ascending, each once, found 3 behind 0; name blocks of "
      "that network.");
  options.key_depths = {1, 1};
  EXPECT_NE(test::error_of([&] { options.check(); }), "");
}

TEST(ActivationCheckpoint, GivesTheSameValuesAndGradients) {
  const auto draw = [](uint64_t seed) { return torch::randn({5, 5}, generator(seed), torch::kFloat32); };
  auto weight = draw(1).requires_grad_(true);
  auto input = draw(2).requires_grad_(true), conditioning = draw(3).requires_grad_(true);
  const PartFunction block = [&weight](const torch::Tensor& x, const torch::Tensor& c) {
    return torch::tanh(torch::mm(x, weight)) * c + x;
  };
  std::vector<torch::Tensor> plain, again;
  for (auto* gradients : {&plain, &again}) {
    for (auto* tensor : {&weight, &input, &conditioning}) tensor->mutable_grad() = torch::Tensor();
    torch::Tensor y = input;
    for (int repeat = 0; repeat < 3; ++repeat) {
      y = gradients == &plain ? block(y, conditioning) : checkpointed(block, y, conditioning);
    }
    y.square().sum().backward();
    for (const auto* tensor : {&weight, &input, &conditioning}) gradients->push_back(tensor->grad().clone());
  }
  for (size_t i = 0; i < plain.size(); ++i) EXPECT_TRUE(torch::equal(plain[i], again[i]));
}

TEST(ActivationCheckpoint, WorksWithoutConditioningAndWithoutGradients) {
  auto weight = torch::full({2, 2}, 0.5F).requires_grad_(true);
  const PartFunction block = [&weight](const torch::Tensor& x, const torch::Tensor& /*c*/) {
    return torch::mm(x, weight);
  };
  auto input = torch::ones({2, 2}).requires_grad_(true);
  checkpointed(block, input).sum().backward();
  EXPECT_EQ(weight.grad().sum().item<float>(), 8.0F);
  const torch::NoGradGuard no_grad;
  EXPECT_FALSE(checkpointed(block, input).requires_grad());
}

TEST(ActivationCheckpoint, PartsThatTreatViewsAloneMeetFewOfThemAtATime) {
  constexpr int64_t kViews = 5, kTokens = 500;
  auto weight = torch::randn({4, 4}, generator(1), torch::kFloat32).requires_grad_(true);
  auto input = torch::randn({kViews, kTokens, 4}, generator(2), torch::kFloat32).requires_grad_(true);
  int64_t most = 0;
  const PartFunction part = [&](const torch::Tensor& x, const torch::Tensor& c) {
    if (torch::GradMode::is_enabled()) most = std::max(most, x.size(0));
    return torch::tanh(torch::matmul(x, weight)) * c;
  };
  for (const int64_t rows : {int64_t{1}, kViews}) {
    auto conditioning = torch::randn({rows, 1, 4}, generator(3), torch::kFloat32).requires_grad_(true);
    const std::vector<torch::Tensor*> all{&weight, &input, &conditioning};
    const auto gradients = [&](const torch::Tensor& y) {
      for (auto* tensor : all) tensor->mutable_grad() = torch::Tensor();
      y.square().sum().backward();
      std::vector<torch::Tensor> result;
      result.reserve(all.size());
      for (const auto* tensor : all) result.push_back(tensor->grad().clone());
      return result;
    };
    const auto plain = gradients(part(input, conditioning));
    most = 0;
    const auto again = gradients(checkpointed_by_views(part, input, conditioning));
    EXPECT_EQ(most, 2);  // of 500 tokens each
    for (size_t i = 0; i < plain.size(); ++i) {
      EXPECT_LT(test::relative_difference(again[i], plain[i]), 1e-6) << i << " with " << rows << " rows";
    }
  }
}

TEST(ActivationCheckpoint, ADiffusionModelGetsTheSameGradients) {
  auto options = test::small_dit_options();
  options.depth = {3, 2};  // two blocks that share a kept input, and one that has its own
  const auto model = test::random_dit(options);
  for (auto& parameter : model->parameters()) parameter.set_requires_grad(true);
  // 3 views of 400 tokens: more than one group of views.
  const auto scene = test::random_dit_scene(options, {3, 1, 280, 280});
  for (const int64_t rows : {1, 3}) {
    std::vector<std::map<std::string, torch::Tensor>> gradients;
    for (const auto storage : {ActivationStorage::kKeep, ActivationStorage::kRecompute}) {
      model->set_activation_storage(storage);
      for (auto& parameter : model->parameters()) parameter.mutable_grad() = torch::Tensor();
      const auto time = model->time_rows({0.4}, rows).front();
      model->velocity(model->prepare_scene(scene.inputs), scene.noisy, time).square().mean().backward();
      auto& stored = gradients.emplace_back();
      for (const auto& item : model->named_parameters()) {
        if (item.value().grad().defined()) stored[item.key()] = item.value().grad().clone();
      }
    }
    ASSERT_EQ(gradients[0].size(), gradients[1].size());
    EXPECT_GT(gradients[0].size(), 40U);
    for (const auto& [name, kept] : gradients[0]) {
      const double scale = std::max(1e-6, kept.abs().max().item<double>());
      EXPECT_LT((gradients[1].at(name) - kept).abs().max().item<double>(), 2e-5 * scale) << name;
    }
  }
}

}  // namespace
}  // namespace gld
