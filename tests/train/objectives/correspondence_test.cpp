#include "train/objectives/correspondence.h"

#include "tests/train/wall_scene.h"

#include <cmath>

#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::wall_scene;

TEST(Correspondence, SharesAreWhereTheSurfaceIsSeen) {
  // Without the turns, the wall moves by 50 * 0.28 / 2 = 7 pixels to the left from view to view: half a token.
  TrainingScene scene = wall_scene();
  for (Camera& camera : scene.views.cameras) camera.world_from_camera.linear().setIdentity();
  scene.depth.fill_(2);
  const auto shares = token_correspondence(scene, 14).shares;
  ASSERT_EQ(shares.sizes(), (std::vector<int64_t>{3, 16, 3, 16}));
  const auto share = [&](int64_t from, int64_t token, int64_t to, int64_t other) {
    return shares[from][token][to][other].item<double>();
  };
  EXPECT_EQ(share(0, 5, 1, 5), 0.5);
  EXPECT_EQ(share(0, 5, 1, 4), 0.5);
  EXPECT_EQ(share(0, 4, 1, 4), 0.5);  // its left half has left the picture
  EXPECT_EQ(shares[0][4][1].sum().item<double>(), 0.5);
  EXPECT_EQ(share(0, 5, 2, 4), 1.0);
  EXPECT_EQ(share(2, 4, 0, 5), 1.0);
  EXPECT_EQ(shares[1].select(1, 1).sum().item<double>(), 0.0);  // nothing within a view
  // A thing in front of the wall in view 1 hides it there.
  scene.depth[1].narrow(0, 14, 14).fill_(1);
  EXPECT_EQ(token_correspondence(scene, 14).shares[0][5][1].sum().item<double>(), 0.0);
}

TEST(Correspondence, TheLossIsLeastWhereAttentionLooksAtTheRightPlace) {
  TrainingScene scene = wall_scene();
  for (Camera& camera : scene.views.cameras) camera.world_from_camera.linear().setIdentity();
  scene.depth.fill_(2);
  const auto truth = token_correspondence(scene, 14);
  const int64_t tokens = 3 * 17;  // one special token a view in front
  AttentionTap tap;
  tap.query = torch::zeros({1, tokens, 2, 8}).requires_grad_(true);
  tap.key = torch::ones({1, tokens, 2, 8});
  // With all keys alike, targets choose among 2 x 16 source tokens, sources among the 16 of the other source.
  const auto uniform = correspondence_loss(tap, truth, {1, 2});
  int64_t from_sources = 0, from_targets = 0;
  for (int64_t view = 0; view < 3; ++view) {
    const auto seen = truth.shares[view].narrow(1, 0, 2).sum(std::vector<int64_t>{1, 2}) > 0;
    (view < 2 ? from_sources : from_targets) += seen.sum().item<int64_t>();
  }
  const double expected = (static_cast<double>(from_sources) * std::log(16.0) +
                           static_cast<double>(from_targets) * std::log(32.0)) /
                          static_cast<double>(from_sources + from_targets);
  EXPECT_NEAR(uniform.item<double>(), expected, 1e-5);
  uniform.backward();
  EXPECT_TRUE(torch::isfinite(tap.query.grad()).all().item<bool>());
  // Keys that stand for their place on the wall, and queries that ask for theirs.
  const auto place = [&](double sharpness) {
    auto features = torch::zeros({1, tokens, 2, 8});
    for (int64_t view = 0; view < 3; ++view) {
      for (int64_t token = 0; token < 16; ++token) {
        const double x = static_cast<double>(token % 4) + 0.5 * static_cast<double>(view);
        const int64_t row = token / 4;
        const auto y = static_cast<double>(row);
        for (int64_t head = 0; head < 2; ++head) {
          auto feature = features[0][view * 17 + 1 + token][head];
          feature[0] = sharpness * std::cos(x);
          feature[1] = sharpness * std::sin(x);
          feature[2] = sharpness * std::cos(y);
          feature[3] = sharpness * std::sin(y);
        }
      }
    }
    return features;
  };
  tap.query = tap.key = place(2);
  const double right = correspondence_loss(tap, truth, {1, 2}).item<double>();
  EXPECT_LT(right, 0.8 * expected);
  tap.query = -tap.key;
  EXPECT_GT(correspondence_loss(tap, truth, {1, 2}).item<double>(), expected);
  // Nothing is seen twice where a single view is the key of itself alone.
  TrainingScene one = scene;
  one.views.cameras.resize(1);
  one.depth = scene.depth.narrow(0, 0, 1);
  one.images = scene.images.narrow(0, 0, 1);
  tap.query = tap.key = torch::ones({1, 17, 2, 8});
  EXPECT_FALSE(correspondence_loss(tap, token_correspondence(one, 14), {1, 1}).defined());
}

}  // namespace
}  // namespace gld
