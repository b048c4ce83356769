#include "models/depth_refinement/refined_source_depth.h"

#include "tests/support/error_of.h"
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

using test::two_views_of_plane;

PixelUnetOptions small_network() {
  PixelUnetOptions options;
  options.channels = {6, 8, 10};
  options.side = 96;
  return options;
}

std::shared_ptr<DepthRefinement> refinement_of(const PixelUnetOptions& options) {
  auto refinement = std::make_shared<DepthRefinement>(options, ParameterPlacement{});
  refinement->initialise(at::detail::createCPUGenerator(3));
  return refinement;
}

// The network says exp(correction) everywhere, whatever it sees.
std::shared_ptr<DepthRefinement> always(double correction,
                                        const PixelUnetOptions& options = small_network()) {
  auto refinement = refinement_of(options);
  const torch::NoGradGuard no_grad;
  refinement->named_parameters()["correction.bias"].fill_(correction);
  return refinement;
}

// The plane whose depth is said to be `off` times as deep; nothing confirms it, and the head says the truth.
ToldDepth told_of_plane(double off) {
  ToldDepth told;
  told.photographs = two_views_of_plane();
  for (PicturedView& view : told.photographs) {
    told.head.push_back(view.depth);
    for (float& value : view.depth.values) value = static_cast<float>(off * static_cast<double>(value));
    told.confidence.emplace_back();
  }
  return told;
}

// Returns, of all pixels that are shown at the factor, the mean of how far colours are apart there.
double mean_difference(const DepthEvidence& evidence, double factor) {
  const auto place = std::find(kDepthFactors.begin(), kDepthFactors.end(), factor) - kDepthFactors.begin();
  const auto shown = evidence.shown.select(1, place) > 0;
  const auto apart = evidence.differences.select(1, place).abs().mean(1);
  return apart.masked_select(shown).mean().item<double>();
}

TEST(RefinedSourceDepth, BeginsWithTheDepthAsItIs) {
  const ToldDepth told = told_of_plane(1.1);
  const auto refined = refined_depths(*refinement_of(small_network()), told);
  ASSERT_EQ(refined.size(), told.photographs.size());
  for (size_t view = 0; view < refined.size(); ++view)
    EXPECT_EQ(refined[view].values, told.photographs[view].depth.values);
}

TEST(RefinedSourceDepth, WhatPhotographsConfirmStaysAsItIs) {
  ToldDepth told = told_of_plane(1);
  PlanarDepth& depth = told.photographs[0].depth;
  ConfidenceMap confidence(depth.width, depth.height);
  const size_t half = depth.values.size() / 2;
  std::fill(confidence.values.begin(), confidence.values.begin() + static_cast<ptrdiff_t>(half), 1.0F);
  std::fill(confidence.values.begin() + static_cast<ptrdiff_t>(half), confidence.values.end(), 0.25F);
  told.confidence[0] = confidence;
  depth.values[half] = 0;  // not known
  const auto refined = refined_depths(*always(0.2), told);
  const double mended = std::exp(0.75 * 0.2);
  EXPECT_EQ(refined[0].values[half], 0);
  for (size_t i = 0; i < depth.values.size(); ++i) {
    const double factor = i < half ? 1 : mended;
    ASSERT_NEAR(refined[0].values[i], factor * static_cast<double>(depth.values[i]), 1e-5) << i;
  }
  ASSERT_NEAR(refined[1].values[0], std::exp(0.2) * static_cast<double>(told.photographs[1].depth.values[0]),
              1e-5);
}

TEST(RefinedSourceDepth, HalfIsTakenWhereTheHeadIsNotBorneOut) {
  ToldDepth told = told_of_plane(1);
  const auto mended_at = [&](double belief) {
    told.belief = belief;
    return static_cast<double>(refined_depths(*always(0.2), told)[0].values[0]);
  };
  const auto before = static_cast<double>(told.photographs[0].depth.values[0]);
  EXPECT_NEAR(mended_at(1), std::exp(0.2) * before, 1e-5);
  EXPECT_NEAR(mended_at(0), std::exp(0.1) * before, 1e-5);
}

TEST(RefinedSourceDepth, TheNetworkSeesWhichDepthPhotographsAgreeAt) {
  ToldDepth told = told_of_plane(1 / 0.82);
  const DepthEvidence evidence = depth_evidence(told, 96);
  EXPECT_LT(mean_difference(evidence, 0.82), 0.02);
  EXPECT_GT(mean_difference(evidence, 1.0), 0.05);
  EXPECT_GT(mean_difference(evidence, 0.74), 0.03);
  // The head says the truth.
  EXPECT_NEAR(evidence.head.mean().item<double>(), std::log(0.82), 1e-5);
  EXPECT_NEAR(evidence.log_depth.median().item<double>(), 0, 1e-6);
  EXPECT_EQ(evidence.confidence.abs().max().item<double>(), 0);
}

// A photograph that was exposed for less time is compared in the brightness of the view.
TEST(RefinedSourceDepth, ADarkPhotographIsBrightened) {
  ToldDepth told = told_of_plane(1);
  for (float& value : told.photographs[1].rgb) value *= 0.6F;
  const DepthEvidence evidence = depth_evidence(told, 96);
  EXPECT_LT(mean_difference(evidence, 1.0), 0.02);
  EXPECT_EQ(evidence.colours[1].max().item<float>(),
            *std::max_element(told.photographs[1].rgb.begin(), told.photographs[1].rgb.end()));
}

TEST(RefinedSourceDepth, DepthThatIsNotKnownIsNoEvidence) {
  ToldDepth told = told_of_plane(1);
  for (PicturedView& view : told.photographs)
    std::fill(view.depth.values.begin(), view.depth.values.end(), 0);
  const DepthEvidence evidence = depth_evidence(told, 96);
  EXPECT_EQ(evidence.shown.max().item<double>(), 0);
  EXPECT_EQ(evidence.differences.abs().max().item<double>(), 0);
  EXPECT_EQ(evidence.head.abs().max().item<double>(), 0);
  EXPECT_EQ(evidence.log_depth.abs().max().item<double>(), 0);
  EXPECT_EQ(evidence.confidence.min().item<double>(), 1);
  const auto refined = refined_depths(*always(0.2), told);
  EXPECT_EQ(*std::max_element(refined[0].values.begin(), refined[0].values.end()), 0);
}

// Looked at in small, mended in its own size.
TEST(RefinedSourceDepth, LargeDepthKeepsItsSize) {
  PixelUnetOptions options = small_network();
  options.side = 24;
  const ToldDepth told = told_of_plane(1);
  const DepthEvidence evidence = depth_evidence(told, options.side);
  EXPECT_EQ(evidence.colours.size(3), 24);
  const auto refined = refined_depths(*always(-0.1, options), told);
  const PlanarDepth& depth = told.photographs[0].depth;
  ASSERT_EQ(refined[0].width, depth.width);
  ASSERT_EQ(refined[0].values.size(), depth.values.size());
  for (size_t i = 0; i < depth.values.size(); ++i)
    ASSERT_NEAR(refined[0].values[i], std::exp(-0.1) * static_cast<double>(depth.values[i]), 1e-5) << i;
}

// A head's map of another size covers the same picture.
TEST(RefinedSourceDepth, TheHeadsMapMayBeSmaller) {
  ToldDepth told = told_of_plane(1);
  for (PlanarDepth& head : told.head) {
    const PlanarDepth whole = head;
    head = {whole.width / 2, whole.height / 2, {}};
    for (int64_t row = 0; row < head.height; ++row) {
      for (int64_t column = 0; column < head.width; ++column)
        head.values.push_back(whole.values[static_cast<size_t>(2 * row * whole.width + 2 * column)]);
    }
  }
  EXPECT_LT(depth_evidence(told, 96).head.abs().max().item<double>(), 0.02);
}

TEST(DepthRefinement, HasItsNamesAndItsCost) {
  std::vector<std::string> names;
  int64_t weights = 0;
  for (const auto& item : refinement_of(small_network())->named_parameters()) {
    names.push_back(item.key());
    if (item.value().dim() == 4) weights += item.value().numel();
  }
  EXPECT_THAT(names, testing::IsSupersetOf({"encoder.0.first.weight", "encoder.2.second.bias",
                                            "decoder.1.first.weight", "correction.weight"}));
  const Cost cost = depth_refinement_cost(small_network(), 32, 48);
  EXPECT_EQ(cost.weight_bytes, 4 * weights);
  EXPECT_DOUBLE_EQ(depth_refinement_cost(small_network(), 640, 960).flop(), 4 * cost.flop());
  EXPECT_EQ(depth_refinement_cost(PixelUnetOptions(), 32, 48).flop(), 0);
}

TEST(DepthRefinement, TakesPicturesOfAnySize) {
  const auto refinement = refinement_of(small_network());
  const torch::NoGradGuard no_grad;
  const auto factors = static_cast<int64_t>(kDepthFactors.size());
  for (const auto& [height, width] :
       std::vector<std::pair<int64_t, int64_t>>{{1, 1}, {1, 9}, {7, 5}, {30, 41}}) {
    const auto map = torch::zeros({2, 1, height, width});
    const DepthEvidence evidence{
        torch::zeros({2, 3, height, width}),      map, map, map, torch::zeros({2, factors, 3, height, width}),
        torch::zeros({2, factors, height, width})};
    EXPECT_EQ(refinement->forward(evidence).sizes(), map.sizes());
  }
}

TEST(DepthRefinement, RefusesANetworkOfOneSize) {
  PixelUnetOptions options;
  options.channels = {8};
  EXPECT_EQ(
      test::error_of([&] { refinement_of(options); }),
      "channels: expected none, or 2 to 8 numbers, found 1; write for example channels: [24, 32, 48, 64].");
}

}  // namespace
}  // namespace gld
