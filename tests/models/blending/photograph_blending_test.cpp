#include "models/blending/photograph_blending.h"

#include "gld/cameras/resized_camera.h"
#include "models/blending/blended_view.h"
#include "tests/support/error_of.h"
#include "tests/support/photograph_error.h"
#include "tests/support/textured_plane.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::camera_between;
using test::TexturedPlane;
using test::two_views_of_plane;

PixelUnetOptions small_blending() {
  PixelUnetOptions options;
  options.channels = {6, 8, 10};
  options.side = 96;
  return options;
}

std::shared_ptr<PhotographBlending> blending_of(const PixelUnetOptions& options) {
  auto blending = std::make_shared<PhotographBlending>(options, ParameterPlacement{});
  blending->initialise(at::detail::createCPUGenerator(3));
  return blending;
}

// The network chooses the hypothesis of that number (0: the rule's picture) everywhere.
std::shared_ptr<PhotographBlending> always(int64_t number) {
  auto blending = blending_of(small_blending());
  const torch::NoGradGuard no_grad;
  auto bias = blending->named_parameters()["choice.bias"];
  bias.zero_();
  bias[number] = 60;
  return blending;
}

// The plane is laid into the view between by a depth that is `off` times too large; there is no matching that would
// mend it.
PlacedPhotographs placed_plane(double off, int64_t times = 1) {
  std::vector<PicturedView> sources = two_views_of_plane();
  const Camera target =
      resized_camera(camera_between(), times * camera_between().width, times * camera_between().height);
  PlacedPhotographs placed =
      place_photographs(sources, std::vector<ColourGains>(sources.size(), ColourGains{1, 1, 1}), target);
  const PicturedView truth = TexturedPlane().seen_by(target, 1);
  for (size_t i = 0; i < placed.depth.values.size(); ++i)
    placed.depth.values[i] = off * static_cast<double>(truth.depth.values[i]);
  return placed;
}

double error_of_view(const PhotographView& view, const Camera& camera) {
  return test::mean_error(view, TexturedPlane().seen_by(camera, 1).rgb);
}

BlendingCandidates one_view(const PlacedPhotographs& placed) {
  BlendingCandidates views = blending_candidates(nearest_photographs(placed), view_from_photographs(placed));
  for (torch::Tensor* part : views.parts()) *part = part->unsqueeze(0);
  return views;
}

TEST(PhotographBlending, BeginsWithTheRulesPicture) {
  const auto views = one_view(placed_plane(1.06));
  const torch::NoGradGuard no_grad;
  const auto picture = blended(views, chosen_shares(*blending_of(small_blending()), views));
  // exp(5) / (exp(5) + 11) of it: the rest is of hypotheses that differ by .1 or so.
  EXPECT_LT((picture - views.colours.select(1, 0)).abs().mean().item<double>(), 0.02);
}

TEST(PhotographBlending, NoColourIsDrawnThatPhotographsDoNotHave) {
  const auto views = one_view(placed_plane(1.06));
  const std::vector<int64_t> shape = {1, views.colours.size(1), views.colours.size(3), views.colours.size(4)};
  const auto logits = 3 * torch::randn(shape, at::detail::createCPUGenerator(1), torch::kFloat32);
  auto shown = views.shown > 0;
  shown.select(1, 0).fill_(true);
  const auto hidden = shown.logical_not().unsqueeze(2);
  const auto picture = blended(views, blending_shares(views, logits));
  EXPECT_GE((picture - views.colours.masked_fill(hidden, 2).amin(1)).min().item<double>(), -1e-5);
  EXPECT_LE((picture - views.colours.masked_fill(hidden, -2).amax(1)).max().item<double>(), 1e-5);
}

TEST(PhotographBlending, WhatIsNotShownHasNoShare) {
  BlendingCandidates views = one_view(placed_plane(1.06));
  ASSERT_TRUE((views.shown == 0).any().item<bool>());
  const auto logits = torch::zeros({1, views.colours.size(1), views.colours.size(3), views.colours.size(4)});
  const auto before = blended(views, blending_shares(views, logits));
  const auto hidden = (views.shown.narrow(1, 1, views.shown.size(1) - 1) == 0).unsqueeze(2);
  auto hypotheses = views.colours.narrow(1, 1, views.colours.size(1) - 1);
  hypotheses.masked_fill_(hidden, 7);
  EXPECT_TRUE(torch::equal(blended(views, blending_shares(views, logits)), before));
}

TEST(PhotographBlending, TheDepthThatMendsAWrongOneIsChosen) {
  const PlacedPhotographs placed = placed_plane(1 / 0.82);
  const PhotographView rule = view_from_photographs(placed);
  PhotographView mended = rule, same = rule;
  const auto place = std::find(kDepthFactors.begin(), kDepthFactors.end(), 0.82) - kDepthFactors.begin();
  blend_photographs(*always(1 + place), placed, mended);
  blend_photographs(*always(0), placed, same);
  EXPECT_GT(error_of_view(rule, placed.target), 0.03);
  EXPECT_LT(error_of_view(mended, placed.target), 0.01);
  EXPECT_EQ(same.rgb, rule.rgb);
  // What is expected of its errors is that of what was chosen.
  double before = 0, after = 0;
  for (size_t pixel = 0; pixel < rule.variance.size(); ++pixel) {
    if (!rule.shown(pixel)) continue;
    EXPECT_NEAR(same.variance[pixel], rule.variance[pixel], 1e-6 + 1e-3 * rule.variance[pixel]);
    before += rule.variance[pixel];
    after += mended.variance[pixel];
  }
  EXPECT_LT(after, before / 4);
}

// Of two colours in equal shares the variance has what they are apart.
TEST(PhotographBlending, WhatIsMixedOfDifferentColoursIsLessSure) {
  const PlacedPhotographs placed = placed_plane(1);
  const PhotographView rule = view_from_photographs(placed);
  PhotographView mixed = rule;
  blend_photographs(*blending_of(small_blending()), placed, mixed);
  double more = 0;
  for (size_t pixel = 0; pixel < rule.variance.size(); ++pixel) {
    if (!rule.shown(pixel)) continue;
    EXPECT_TRUE(mixed.shown(pixel)) << pixel;
    more += mixed.variance[pixel] > rule.variance[pixel] ? 1 : -1;
  }
  EXPECT_GT(more, 0);
}

// At the size that the network looks at a view is what training makes of it.
TEST(PhotographBlending, AViewIsLaidTogetherAsInTraining) {
  const PlacedPhotographs placed = placed_plane(1.06);
  auto blending = blending_of(small_blending());
  {
    const torch::NoGradGuard no_grad;
    auto weight = blending->named_parameters()["choice.weight"];
    weight.normal_(0, 8, at::detail::createCPUGenerator(2));
  }
  PhotographView view = view_from_photographs(placed);
  const PhotographView rule = view;
  blend_photographs(*blending, placed, view);
  const torch::NoGradGuard no_grad;
  const auto views = one_view(placed);
  const auto trained = blended(views, chosen_shares(*blending, views))[0].permute({1, 2, 0}).contiguous();
  EXPECT_NE(view.rgb, rule.rgb);
  for (size_t i = 0; i < view.rgb.size(); ++i) {
    if (view.shown(i / 3)) {
      ASSERT_NEAR(view.rgb[i], trained.data_ptr<float>()[i], 0.003) << i;
    }
  }
}

// Larger pictures are chosen for in smaller ones and keep their own colours.
TEST(PhotographBlending, LargePicturesKeepTheirResolution) {
  const PlacedPhotographs placed = placed_plane(1 / 0.82, 3);
  PhotographView view = view_from_photographs(placed);
  const auto place = std::find(kDepthFactors.begin(), kDepthFactors.end(), 0.82) - kDepthFactors.begin();
  blend_photographs(*always(1 + place), placed, view);
  EXPECT_EQ(view.width, 3 * camera_between().width);
  EXPECT_LT(error_of_view(view, placed.target), 0.02);
}

TEST(PhotographBlending, WhatIsNotShownStaysSo) {
  PlacedPhotographs placed = placed_plane(1);
  for (size_t i = 0; i < placed.depth.reached.size() / 2; ++i) placed.depth.reached[i] = 0;
  const PhotographView rule = view_from_photographs(placed);
  PhotographView view = rule;
  blend_photographs(*always(3), placed, view);
  for (size_t pixel = 0; pixel < rule.variance.size() / 2; ++pixel) {
    EXPECT_FALSE(view.shown(pixel));
    EXPECT_EQ(view.rgb[3 * pixel], rule.rgb[3 * pixel]);
  }
  PhotographView empty = view_from_photographs(PlacedPhotographs{{}, placed.target, {}, {}});
  blend_photographs(*always(3), PlacedPhotographs{{}, placed.target, {}, {}}, empty);
  EXPECT_EQ(empty.shown_share(), 0);
}

TEST(PhotographBlending, TakesPicturesOfAnySize) {
  const auto blending = blending_of(small_blending());
  const torch::NoGradGuard no_grad;
  for (const auto& [height, width] :
       std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {1, 9}, {7, 5}, {30, 41}}) {
    const auto logits = blending->forward(torch::zeros({2, PhotographBlending::kInputs, height, width}));
    EXPECT_EQ(logits.sizes(),
              (std::vector<int64_t>{2, 1 + static_cast<int64_t>(kDepthFactors.size()), height, width}));
  }
}

TEST(PhotographBlending, HasItsNamesAndItsCost) {
  std::vector<std::string> names;
  int64_t weights = 0;
  for (const auto& item : blending_of(small_blending())->named_parameters()) {
    names.push_back(item.key());
    if (item.value().dim() == 4) weights += item.value().numel();
  }
  EXPECT_THAT(names, testing::IsSupersetOf({"encoder.0.first.weight", "encoder.2.second.bias",
                                            "decoder.1.first.weight", "choice.weight"}));
  const Cost cost = blending_cost(small_blending(), 32, 48);
  EXPECT_EQ(cost.weight_bytes, 4 * weights);
  // It costs four times as much for four times the pixels, and beyond the side that it looks at no more.
  EXPECT_DOUBLE_EQ(blending_cost(small_blending(), 64, 96).flop(), 4 * cost.flop());
  EXPECT_DOUBLE_EQ(blending_cost(small_blending(), 640, 960).flop(), 4 * cost.flop());
  EXPECT_EQ(blending_cost(PixelUnetOptions(), 32, 48).flop(), 0);
}

TEST(PhotographBlending, RefusesANetworkOfOneSize) {
  PixelUnetOptions options;
  options.channels = {8};
  EXPECT_EQ(
      test::error_of([&] { blending_of(options); }),
      "channels: expected none, or 2 to 8 numbers, found 1; write for example channels: [24, 32, 48, 64].");
}

}  // namespace
}  // namespace gld
