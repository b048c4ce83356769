#include "models/scene_geometry/photograph_depth.h"

#include "gld/tensors/tensor_pictures.h"
#include "tests/support/textured_plane.h"

#include <cmath>
#include <memory>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// Two photographs of a plane, and what a geometry head of another unit says of them: the truth.
struct PhotographedPlane {
  Views views;
  torch::Tensor images;
  GeometryOutput head;

  explicit PhotographedPlane(const std::vector<PicturedView>& photographs = test::two_views_of_plane()) {
    constexpr double kHeadUnit = 2.5;
    std::vector<torch::Tensor> pictures, depths;
    for (const PicturedView& view : photographs) {
      views.cameras.push_back(view.camera);
      pictures.push_back(picture_of(view.rgb, view.width, view.height));
      depths.push_back(planes_of(view.depth.values, 1, view.width, view.height)[0] / kHeadUnit);
    }
    views.num_sources = views.size();
    images = torch::stack(pictures);
    head.depth = torch::stack(depths);
  }
  PhotographDepth found(const PhotographDepthOptions& options = {}) const {
    return photograph_depth(views, images, photographs_of_images(views, images), &head, options);
  }
};

// exp(by) times as deep, whatever it sees.
std::shared_ptr<DepthRefinement> deepening_network(double by = 0.2) {
  PixelUnetOptions options;
  options.channels = {4, 6};
  auto refinement = std::make_shared<DepthRefinement>(options, ParameterPlacement{});
  refinement->initialise(at::detail::createCPUGenerator(3));
  const torch::NoGradGuard no_grad;
  refinement->named_parameters()["correction.bias"].fill_(by);
  return refinement;
}

TEST(PhotographDepth, TheHeadsDepthIsToldInTheUnitOfTheCameras) {
  const PhotographedPlane plane;
  const PhotographDepth found = plane.found();
  ASSERT_TRUE(found.depth.known()) << found.depth.doubt;
  ASSERT_EQ(found.head.size(), 2U);
  const auto truth = test::two_views_of_plane();
  for (size_t i = 0; i < truth[0].depth.values.size(); ++i)
    ASSERT_NEAR(found.head[0].values[i] / truth[0].depth.values[i], 1, 0.03) << i;
}

TEST(PhotographDepth, WhatPhotographsDoNotConfirmIsMended) {
  const PhotographedPlane plane;
  const auto network = deepening_network();
  PhotographDepthOptions options;
  options.follows_edges = false;
  const PhotographDepth found = plane.found(options);
  options.refinement = network.get();
  const PhotographDepth mended = plane.found(options);
  EXPECT_EQ(mended.depth.from, "photographs and geometry head, mended by a network");
  double confirmed = 0, open = 0;
  for (size_t view = 0; view < 2; ++view) {
    const auto& confidence = found.stereo.views[view].confidence.values;
    const auto &before = found.depth.views[view].values, &after = mended.depth.views[view].values;
    for (size_t i = 0; i < before.size(); ++i) {
      const double factor = std::exp(0.2 * (1 - static_cast<double>(confidence[i])));
      ASSERT_NEAR(after[i], factor * static_cast<double>(before[i]), 1e-4) << i;
      (confidence[i] > 0.9F ? confirmed : open) += 1;
    }
  }
  EXPECT_GT(confirmed, 1000);
  EXPECT_GT(open, 100);
}

// The head says that the sky is a wall, and the network brings all nearer.
TEST(PhotographDepth, WhatIsFarIsBroughtNoNearer) {
  std::vector<Camera> cameras;
  for (const double x : {0.0, 0.4, 0.8}) cameras.push_back(test::camera_before_plane({x, 0, 0}, -0.1 * x));
  const PhotographedPlane sky(test::wall_before_sky(cameras, 6));
  const auto network = deepening_network(-1);
  PhotographDepthOptions options;
  options.refinement = network.get();
  const PhotographDepth found = sky.found(options);
  ASSERT_TRUE(found.depth.known()) << found.depth.doubt;
  int64_t far = 0, nearer = 0;
  for (size_t view = 0; view < 3; ++view) {
    const auto& depth = found.depth.views[view].values;
    const auto& least = found.stereo.views[view].least.values;
    ASSERT_EQ(depth.size(), least.size());
    for (size_t i = 0; i < depth.size(); ++i) {
      ASSERT_GE(depth[i], least[i]) << i;
      if (least[i] > 0) ++far;
      if (least[i] == 0 && depth[i] < 4) ++nearer;
    }
  }
  EXPECT_GT(far, 2500);
  EXPECT_GT(nearer, 1000);  // all that is not
}

// Nothing of it is matched, and what the network mends is a match.
TEST(PhotographDepth, OfOnePhotographTheHeadsDepthStaysAsItIs) {
  PhotographedPlane plane;
  plane.views.num_sources = 1;
  plane.images = plane.images.narrow(0, 0, 1);
  const auto network = deepening_network();
  PhotographDepthOptions options;
  options.refinement = network.get();
  const PhotographDepth unknown = plane.found(options);
  EXPECT_EQ(unknown.depth.doubt, "the depth of a single source view has no scale");
  EXPECT_TRUE(unknown.head.empty());
  EXPECT_FALSE(told_depth(photographs_of_images(plane.views, plane.images), unknown, 112));
  options.single_source_unit = 2.5;
  options.follows_edges = false;
  const PhotographDepth guessed = plane.found(options);
  EXPECT_EQ(guessed.depth.from, "geometry head, in the usual unit");
  const auto truth = test::two_views_of_plane();
  ASSERT_EQ(guessed.depth.views.size(), 1U);
  for (size_t i = 0; i < truth[0].depth.values.size(); ++i)
    ASSERT_NEAR(guessed.depth.views[0].values[i], truth[0].depth.values[i], 1e-4) << i;
  EXPECT_EQ(guessed.head[0].values, guessed.depth.views[0].values);

  // What the view suggests takes the place of what is usual, but not where the unit is not the metre.
  SingleViewUnit unit;
  unit.mean = torch::zeros({2}, torch::kFloat64);
  unit.deviation = torch::ones({2}, torch::kFloat64);
  unit.weights = torch::zeros({2}, torch::kFloat64);
  unit.offset = unit.least = unit.largest = std::log(5);
  plane.head.single_view =
      SingleView{std::make_shared<const SingleViewUnit>(unit), torch::zeros({1}, torch::kFloat64)};
  const PhotographDepth suggested = plane.found(options);
  EXPECT_EQ(suggested.depth.from, "geometry head, in the unit that its view suggests");
  for (size_t i = 0; i < truth[0].depth.values.size(); ++i)
    ASSERT_NEAR(suggested.depth.views[0].values[i], 2 * truth[0].depth.values[i], 2e-4) << i;
  options.single_source_unit = 0;
  EXPECT_FALSE(plane.found(options).depth.known());
}

// The depth of one photograph too, whose head smears an edge of the picture.
TEST(PhotographDepth, FollowsTheEdgesOfThePhotographs) {
  PhotographedPlane plane;
  plane.views.num_sources = 1;
  plane.images = plane.images.narrow(0, 0, 1).clone();
  const int64_t middle = plane.images.size(3) / 2;
  plane.images.slice(3, 0, middle).fill_(0.1);
  plane.images.slice(3, middle).fill_(0.9);
  auto& depth = plane.head.depth;
  depth.slice(2, 0, middle).fill_(1);
  depth.slice(2, middle).fill_(2);
  depth.slice(2, middle - 2, middle + 2).fill_(1.5);
  PhotographDepthOptions options;
  options.single_source_unit = 1;
  const auto edge_of = [&](bool follows_edges) {
    options.follows_edges = follows_edges;
    const PlanarDepth found = plane.found(options).depth.views.at(0);
    const auto row = static_cast<size_t>(found.height / 2 * found.width + middle);
    return std::vector<float>(found.values.begin() + static_cast<std::ptrdiff_t>(row) - 2,
                              found.values.begin() + static_cast<std::ptrdiff_t>(row) + 2);
  };
  EXPECT_EQ(edge_of(false), (std::vector<float>{1.5F, 1.5F, 1.5F, 1.5F}));
  EXPECT_EQ(edge_of(true), (std::vector<float>{1, 1, 2, 2}));
}

// Photographs are looked at reduced, however large they are.
TEST(PhotographDepth, TheNetworkIsToldInItsOwnSize) {
  const PhotographedPlane plane;
  const auto told = told_depth(photographs_of_images(plane.views, plane.images), plane.found(), 48);
  ASSERT_TRUE(told);
  for (const PicturedView& view : told->photographs) EXPECT_EQ(view.width, 48);
  EXPECT_EQ(told->photographs[0].depth.width, 96);
}

}  // namespace
}  // namespace gld
