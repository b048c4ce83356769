#include "models/conditioning/source_conditioning.h"

#include "gld/photogrammetry/pose_from_rays.h"
#include "models/backbones/da3_backbone.h"
#include "models/scene_geometry/source_warp.h"
#include "tests/support/textured_plane.h"

#include <cmath>
#include <memory>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/autograd.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr double kUnit = 2.5;  // of the head's depth, in the world

LatentSpace small_space() {
  Da3BackboneOptions options;
  options.embed_dim = 48;
  options.num_heads = 3;
  options.pos_embed_grid = 5;
  auto backbone = std::make_shared<Da3Backbone>(options, ParameterPlacement());
  backbone->initialise(at::detail::createCPUGenerator(1));
  return LatentSpace(backbone, 1);
}

// The camera has whole patches of the backbone.
Camera camera_at(double x) { return test::camera_before_plane({x, 0.1 * x, 0}, -0.2 * x, 84, 70); }

// Returns two source views of a plane and a target between them.
SourceScene plane_scene() {
  SourceScene scene;
  scene.views.cameras = {camera_at(0), camera_at(1.2), camera_at(0.5)};
  scene.views.num_sources = 2;
  std::vector<torch::Tensor> images;
  for (size_t i = 0; i < 2; ++i) {
    const PicturedView seen = test::TexturedPlane().seen_by(scene.views.cameras[i], 1);
    images.push_back(torch::tensor(seen.rgb).view({seen.height, seen.width, 3}).permute({2, 0, 1}));
  }
  scene.images = torch::stack(images);
  return scene;
}

// This head knows the plane, in a unit of its own.
class PlaneHead : public GeometryHead {
 public:
  explicit PlaneHead(const SourceScene& scene) : views_(scene.views.num_sources) {
    std::vector<torch::Tensor> depths, rays;
    for (size_t i = 0; i < static_cast<size_t>(views_); ++i) {
      const PlanarDepth depth = test::TexturedPlane().seen_by(scene.views.cameras[i], kUnit).depth;
      depths.push_back(torch::tensor(depth.values).view({depth.height, depth.width}));
      Camera in_model = scene.views.cameras[i];
      in_model.world_from_camera.translation() /= kUnit;
      rays.push_back(torch::tensor(rays_of_camera(in_model, 16, 12).values).view({12, 16, 6}));
    }
    truth_.depth = torch::stack(depths);
    truth_.depth_confidence = torch::full_like(truth_.depth, 2.0F);
    truth_.rays = torch::stack(rays);
    truth_.ray_confidence = torch::full({views_, 12, 16}, 2.0F);
  }
  GeometryOutput forward(const GeometryInputs& inputs, const LatentGrid& grid, GeometryMaps) const override {
    EXPECT_EQ(inputs.levels.size(), 4U);
    EXPECT_EQ(grid.views, views_);
    return truth_;
  }
  void initialise(const torch::Generator&) override {}

 private:
  int64_t views_;
  GeometryOutput truth_;
};

// Depth from elsewhere takes the head's place: where both say the same, so does the conditioning.
TEST(SourceConditioning, GivenDepthIsUsedInThePlaceOfTheHeads) {
  const torch::NoGradGuard no_grad;
  const LatentSpace space = small_space();
  SourceScene scene = plane_scene();
  const PlaneHead head(scene);
  const auto needs = conditioning_needs(scene, 1, 2);
  EXPECT_TRUE(needs.head_depth);
  EXPECT_EQ(deepest_encoded_level(needs, 4), 3);
  const auto by_head = condition_on_sources(space, &head, scene, needs);
  EXPECT_EQ(by_head.warped.doubt, "");
  EXPECT_EQ(by_head.levels.size(), 2U);
  ASSERT_EQ(by_head.warped.levels.size(), 2U);
  EXPECT_EQ(by_head.warped.levels[1].sizes(), (std::vector<int64_t>{1, 30, 96}));
  EXPECT_EQ(by_head.warped.agreement.sizes(), (std::vector<int64_t>{1, 2, 70, 84}));

  scene.depth = source_depth_of_head(scene.views, scene.images, source_geometry(head, by_head), 0);
  EXPECT_EQ(scene.depth->from, "geometry head");
  const auto given_needs = conditioning_needs(scene, 1, 2);
  EXPECT_FALSE(given_needs.head_depth);
  EXPECT_EQ(deepest_encoded_level(given_needs, 4), 1);
  const auto given = condition_on_sources(space, nullptr, scene, given_needs);
  EXPECT_TRUE(given.for_geometry.levels.empty());
  EXPECT_TRUE(given.warped.agreement.equal(by_head.warped.agreement));
  for (size_t level = 0; level < 2; ++level) {
    EXPECT_TRUE(given.levels[level].equal(by_head.levels[level]));
    EXPECT_TRUE(given.warped.levels[level].equal(by_head.warped.levels[level]));
  }
}

// In the right unit as two sources are; in half of it somewhere else.
TEST(SourceConditioning, ASingleSourceIsCarriedInTheUnitThatIsGuessed) {
  const torch::NoGradGuard no_grad;
  const LatentSpace space = small_space();
  SourceScene scene = plane_scene();
  scene.views.cameras.erase(scene.views.cameras.begin() + 1);
  scene.views.num_sources = 1;
  scene.images = scene.images.slice(0, 0, 1);
  const PlaneHead head(scene);
  const auto carried = [&](double unit) {
    scene.single_source_unit = unit;
    const auto needs = conditioning_needs(scene, 1, 2);
    EXPECT_TRUE(needs.head_depth);
    return condition_on_sources(space, &head, scene, needs).warped;
  };
  const WarpedFeatures right = carried(kUnit), wrong = carried(kUnit / 2);
  EXPECT_EQ(right.doubt, "");
  SourceScene known = scene;
  known.depth = depth_of_scene({test::TexturedPlane().seen_by(scene.views.cameras[0], 1).depth});
  const auto by_truth = condition_on_sources(space, nullptr, known, conditioning_needs(known, 1, 2)).warped;
  ASSERT_EQ(right.levels.size(), 2U);
  EXPECT_LT((right.levels[1] - by_truth.levels[1]).abs().max().item<double>(), 1e-3);
  EXPECT_GT((wrong.levels[1] - by_truth.levels[1]).abs().max().item<double>(), 0.1);
}

// What the view suggests is asked of one view alone, and depends on it.
TEST(SourceConditioning, TheUnitIsGuessedOfASingleView) {
  const torch::NoGradGuard no_grad;
  const LatentSpace space = small_space();
  ConditioningNeeds needs;
  needs.head_depth = true;
  for (const int64_t sources : {1, 2}) {
    SourceScene scene = plane_scene();
    scene.views.num_sources = sources;
    scene.images = scene.images.narrow(0, 0, sources);
    PlaneHead head(scene);
    const auto encoded = encode_sources(space, scene.images, needs);
    EXPECT_FALSE(source_geometry(head, encoded).single_view);
    const Camera& camera = scene.views.cameras.front();
    const auto look =
        look_of_view(encoded.for_geometry.levels.front()[0], source_geometry(head, encoded).depth[0]);
    const auto features = single_view_features(look, camera);
    auto unit = std::make_shared<SingleViewUnit>();
    unit->mean = torch::zeros_like(features);
    unit->deviation = torch::ones_like(features);
    unit->weights = features / features.square().sum();
    unit->offset = 0.5;
    unit->least = -10;
    unit->largest = 10;
    unit->log_deviation = 0.2;
    head.guess_unit_by(unit);
    const auto view = source_geometry(head, encoded).single_view;
    ASSERT_EQ(view.has_value(), sources == 1);
    if (!view) continue;
    EXPECT_NEAR(view->guess(camera).metres, std::exp(1.5), 1e-6);
    EXPECT_EQ(view->guess(camera).log_deviation, 0.2);
    // A view of twice the focal length shows half as wide a place.
    unit->weights.zero_();
    unit->weights[-1] = 1;
    Camera narrow = camera;
    narrow.intrinsics(0, 0) *= 2;
    EXPECT_NEAR(view->guess(narrow).metres, 2 * view->guess(camera).metres, 1e-9);
  }
}

TEST(SourceConditioning, NothingIsCarriedForModelsThatTakeNothingOrBySingleSourcesOfUnknownUnit) {
  const torch::NoGradGuard no_grad;
  const LatentSpace space = small_space();
  SourceScene scene = plane_scene();
  EXPECT_FALSE(conditioning_needs(scene, 1, 0).head_depth);
  scene.views.cameras.erase(scene.views.cameras.begin());
  scene.views.num_sources = 1;
  scene.images = scene.images.slice(0, 1);
  auto needs = conditioning_needs(scene, 1, 2);
  EXPECT_FALSE(needs.head_depth);
  needs.propagation = true;
  const auto alone = condition_on_sources(space, nullptr, scene, needs);
  EXPECT_FALSE(alone.warped.agreement.defined());
  EXPECT_TRUE(alone.leading.equal(alone.levels[1].narrow(1, 0, space.leading_tokens())));
}

}  // namespace
}  // namespace gld
