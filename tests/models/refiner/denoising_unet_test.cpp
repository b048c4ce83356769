#include "models/refiner/denoising_unet.h"

#include "models/refiner/one_step_update.h"
#include "models/refiner/reference_views.h"
#include "models/refiner/view_grid.h"
#include "tests/support/error_of.h"

#include <cmath>
#include <string>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using testing::ElementsAre;

RefinerOptions small_refiner(ViewAttention attention) {
  RefinerOptions options;
  options.channels = {8, 16};
  options.heads = {2, 2};
  options.norm_groups = 4;
  options.prompt_channels = 6;
  options.attention = attention;
  return options;
}

DenoisingUnet random_unet(const RefinerOptions& options) {
  const torch::NoGradGuard no_grad;
  DenoisingUnet unet(options, {});
  auto generator = at::detail::createCPUGenerator(5);
  unet.initialise(generator);
  // What initialise() leaves at 0 would hide everything.
  for (auto& parameter : unet.parameters()) {
    if (parameter.dim() > 1 && parameter.abs().max().item<float>() == 0)
      parameter.copy_(0.1 * torch::randn(parameter.sizes(), generator));
  }
  return unet;
}

torch::Tensor random_views(int64_t views, int64_t height, int64_t width) {
  auto generator = at::detail::createCPUGenerator(6);
  return torch::randn({1, views, 4, height, width}, generator, torch::kFloat32);
}

TEST(OneStepUpdate, GainsAreThoseOfTheSchedule) {
  // Of the product in 40 decimal digits.
  struct Row {
    int64_t timestep;
    double signal, latent, noise;
  };
  for (const Row& row :
       {Row{10, 0.9904313091, 1.004818956, 0.098291074}, Row{100, 0.8942234776, 1.057491697, 0.343931226},
        Row{300, 0.5905010588, 1.301336646, 0.832752703}, Row{500, 0.2763326838, 1.902321308, 1.618278826},
        Row{900, 0.0141511420, 8.406287828, 8.346596615}}) {
    EXPECT_NEAR(alpha_bar(row.timestep), row.signal, 1e-9) << row.timestep;
    const OneStepGains published = one_step_gains(row.timestep, OneStepForm::kPublished);
    const OneStepGains identity = one_step_gains(row.timestep, OneStepForm::kIdentity);
    EXPECT_NEAR(published.latent, row.latent, 1e-8) << row.timestep;
    EXPECT_NEAR(published.prediction, -row.noise, 1e-8) << row.timestep;
    EXPECT_EQ(identity.latent, 1);
    EXPECT_EQ(identity.prediction, -published.prediction);
  }
  EXPECT_THAT(error_of([] { alpha_bar(1000); }),
              testing::StrEq("timestep: expected 0 to 999, found 1000; choose one of them."));
}

TEST(OneStepUpdate, WhoSeesTheNoiseGivesTheLatentBack) {
  const auto latent = random_views(1, 3, 5), noise = random_views(1, 3, 5).flip(3);
  for (const OneStepForm form : {OneStepForm::kIdentity, OneStepForm::kPublished}) {
    for (const int64_t timestep : {0, 300, 999}) {
      const OneStepGains gains = one_step_gains(timestep, form);
      const auto seen = noised_latent(latent, noise, timestep, form);
      const auto prediction = gains.prediction < 0 ? noise : -noise;
      EXPECT_LT((one_step_update(seen, prediction, gains) - latent).abs().max().item<double>(),
                1e-6 * (1 + gains.latent * seen.abs().max().item<double>()))
          << timestep;
    }
  }
  const double left = alpha_bar(500);
  const auto published = noised_latent(latent, noise, 500, OneStepForm::kPublished);
  EXPECT_LT((published - std::sqrt(left) * latent - std::sqrt(1 - left) * noise).abs().max().item<double>(),
            1e-6);
}

TEST(ViewGrid, LaysViewsOutRowByRow) {
  EXPECT_EQ(view_grid(1).columns, 1);
  EXPECT_EQ(view_grid(2).rows, 2);
  EXPECT_EQ(view_grid(4).rows, 2);
  EXPECT_EQ(view_grid(6).columns, 3);
  const auto views = torch::arange(4).view({1, 4, 1, 1, 1}).expand({1, 4, 2, 3, 5});
  const auto picture = as_grid(views);
  ASSERT_TRUE(picture.sizes().equals({1, 2, 6, 10}));
  EXPECT_EQ(picture[0][0][0][0].item<int64_t>(), 0);
  EXPECT_EQ(picture[0][1][2][9].item<int64_t>(), 1);
  EXPECT_EQ(picture[0][0][3][4].item<int64_t>(), 2);
  EXPECT_EQ(picture[0][0][5][5].item<int64_t>(), 3);
  EXPECT_TRUE(views_of_grid(picture, view_grid(4)).equal(views));
  EXPECT_THAT(
      error_of([] { view_grid(3); }),
      testing::StrEq("references: expected 0 or an odd number, so that with the degraded view no cell of the "
                     "grid is empty, found 2; take one more or one less, or attention self or cross."));
  EXPECT_EQ(views_in_whole_grid(5), 4);
  EXPECT_EQ(views_in_whole_grid(2), 2);
  EXPECT_EQ(views_in_whole_grid(1), 1);
}

TEST(DenoisingUnet, BeginsAsTheIdentity) {
  for (const auto attention : {ViewAttention::kGrid, ViewAttention::kSelf, ViewAttention::kCross}) {
    DenoisingUnet unet(small_refiner(attention), {});
    unet.initialise(at::detail::createCPUGenerator(1));
    const auto views = random_views(4, 5, 6);
    EXPECT_TRUE(refined_latents(unet, views).equal(views.select(1, 0)));
  }
}

TEST(DenoisingUnet, OneViewAloneIsTheSameInEveryAttention) {
  const torch::NoGradGuard no_grad;
  const auto view = random_views(1, 6, 7);
  const auto grid = random_unet(small_refiner(ViewAttention::kGrid)).forward(view, 300);
  for (const auto attention : {ViewAttention::kSelf, ViewAttention::kCross})
    EXPECT_LT((random_unet(small_refiner(attention)).forward(view, 300) - grid).abs().max().item<double>(),
              1e-5);
}

// Returns how much what the network predicts of view `of` changes with view `with`.
double influence(ViewAttention attention, int64_t of, int64_t with) {
  const DenoisingUnet unet = random_unet(small_refiner(attention));
  auto views = random_views(4, 4, 4).requires_grad_();
  unet.forward(views, 300).select(1, of).square().sum().backward();
  return views.grad().select(1, with).abs().max().item<double>();
}

TEST(DenoisingUnet, ReferencesDoNotSeeEachOtherAcross) {
  for (int64_t of = 0; of < 4; ++of) {
    for (int64_t with = 0; with < 4; ++with) {
      EXPECT_GT(influence(ViewAttention::kSelf, of, with), 0) << of << with;
      EXPECT_GT(influence(ViewAttention::kGrid, of, with), 0) << of << with;
      const bool sees = of == 0 || of == with;
      EXPECT_EQ(influence(ViewAttention::kCross, of, with) > 0, sees) << of << with;
    }
  }
}

TEST(DenoisingUnet, ScenesOfABatchDoNotSeeEachOther) {
  const torch::NoGradGuard no_grad;
  for (const auto attention : {ViewAttention::kGrid, ViewAttention::kSelf, ViewAttention::kCross}) {
    const DenoisingUnet unet = random_unet(small_refiner(attention));
    const auto one = random_views(4, 4, 6), other = one.flip(3);
    const auto together = unet.forward(torch::cat({one, other}), 300);
    EXPECT_LT((together.slice(0, 0, 1) - unet.forward(one, 300)).abs().max().item<double>(), 1e-5);
    EXPECT_LT((together.slice(0, 1, 2) - unet.forward(other, 300)).abs().max().item<double>(), 1e-5);
  }
}

TEST(DenoisingUnet, CountsWhatItMultiplies) {
  RefinerOptions options = small_refiner(ViewAttention::kSelf);
  options.layers_per_block = 2;
  const DenoisingUnet unet(options, {});
  int64_t weights = 0;
  for (const auto& item : unet.named_parameters()) {
    const std::string& name = item.key();
    // Of the prompt and of the time, which have a row each.
    const bool once = name.find("time_emb") != std::string::npos ||
                      name.find("attn2.to_k") != std::string::npos ||
                      name.find("attn2.to_v") != std::string::npos || name == "prompt";
    if (item.value().dim() > 1 && !once) weights += item.value().numel();
  }
  const Cost cost = refiner_cost(options, 4, 8, 8);
  EXPECT_EQ(cost.weight_bytes, 4 * weights);
  EXPECT_GT(cost.working_bytes, 0);
  EXPECT_NEAR(scored_pairs(4, 64, ViewAttention::kGrid) / scored_pairs(4, 64, ViewAttention::kCross), 8.0 / 3,
              1e-12);
}

TEST(RefinerOptions, SaysWhatDoesNotFit) {
  RefinerOptions options = small_refiner(ViewAttention::kGrid);
  options.references = 2;
  EXPECT_THAT(error_of([&] { options.check(); }),
              testing::HasSubstr("references: expected 0 or an odd number"));
  options.references = 3;
  options.heads = {2};
  EXPECT_THAT(
      error_of([&] { options.check(); }),
      testing::StrEq("heads: expected 2 numbers, one a stage, found 1; write for example heads: [2, 3, 4]."));
  options.heads = {3, 2};
  EXPECT_THAT(error_of([&] { options.check(); }),
              testing::HasSubstr("heads: expected numbers that divide the stage's channels 8, found 3"));
}

Camera camera_at(double x, double turn) {
  Camera camera;
  camera.world_from_camera.translation() = Eigen::Vector3d(x, 0, 0);
  camera.world_from_camera.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitY()).toRotationMatrix();
  return camera;
}

TEST(NearestReferences, WeighTurnsAgainstSpacing) {
  // The spacing is 1: a turn of 1 radian is |R - R'|_F / 2 = sqrt(2) sin(1/2) = .68.
  const std::vector<Camera> cameras = {camera_at(0, 1), camera_at(1, 0), camera_at(2, 0), camera_at(3, 0)};
  EXPECT_THAT(nearest_references(camera_at(0.1, 0), cameras, 3, ReferenceUnit::kSpacing),
              ElementsAre(0, 1, 2));
  // In a unit of a hundredth the scene's own distances weigh a hundred times as much, spacings what they did.
  std::vector<Camera> hundredths = cameras;
  for (Camera& camera : hundredths) camera.world_from_camera.translation() *= 0.01;
  EXPECT_THAT(nearest_references(camera_at(0.001, 0), hundredths, 3, ReferenceUnit::kSpacing),
              ElementsAre(0, 1, 2));
  EXPECT_THAT(nearest_references(camera_at(0.001, 0), hundredths, 4, ReferenceUnit::kScene),
              ElementsAre(1, 2, 3, 0));
  EXPECT_THAT(nearest_references(camera_at(0, 0), {camera_at(5, 0)}, 3, ReferenceUnit::kSpacing),
              ElementsAre(0));
}

}  // namespace
}  // namespace gld
