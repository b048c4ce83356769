#include "datasets/loading/batching.h"

#include "datasets/synthetic/synthetic_scene.h"
#include "tests/support/error_of.h"

#include <limits>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(Batching, ImagesAndDepthKeepTheirPlaces) {
  Image image(3, 2);
  for (size_t i = 0; i < image.rgb.size(); ++i) image.rgb[i] = static_cast<uint8_t>(10 * i);
  const torch::Tensor tensor = to_tensor(image);
  EXPECT_EQ(tensor.sizes(), (std::vector<int64_t>{3, 2, 3}));
  EXPECT_FLOAT_EQ(tensor[1][1][2].item<float>(), image.pixel(2, 1)[1] / 255.0F);
  EXPECT_EQ(to_image(tensor).rgb, image.rgb);
  EXPECT_EQ(to_image(tensor * 100).pixel(2, 1)[0], 255);

  DepthMap depth(3, 2);
  depth.at(2, 1) = 7.5F;
  EXPECT_EQ(to_tensor(depth)[1][2].item<float>(), 7.5F);
  EXPECT_EQ(to_depth_map(to_tensor(depth)).metres, depth.metres);
  EXPECT_EQ(test::error_of([&] {
              to_image(torch::zeros({4, 2, 2}));
            }),
            "image: expected a tensor (3, height, width), found 3 dimensions.");
}

TEST(Batching, AnImageIsRoundedClampedAndBlackWhereItIsNoNumber) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinite = std::numeric_limits<float>::infinity();
  // Two pixels: red plane, green plane, blue plane.
  const auto planes = torch::tensor({0.5F, nan, -1.0F, infinite, 2.0F, 0.001F}).view({3, 1, 2});
  EXPECT_EQ(to_image(planes).rgb, (std::vector<uint8_t>{128, 0, 255, 0, 255, 0}));
}

TEST(Batching, ASceneBecomesTensors) {
  const Scene scene = make_synthetic_scene(SyntheticOptions(), 0);
  SceneImages loaded;
  loaded.num_sources = 1;
  for (size_t i : {0U, 5U, 9U}) {
    loaded.views.push_back(load_sized(scene.frames[i], {28, 14}, FrameParts::kImageAndDepth));
  }
  loaded.views[2].validity = ValidityMask(28, 14);
  loaded.views[2].validity.valid[3] = 0;
  const SceneTensors tensors = to_tensors(loaded);
  EXPECT_EQ(tensors.images.sizes(), (std::vector<int64_t>{3, 3, 14, 28}));
  EXPECT_EQ(tensors.depth.sizes(), (std::vector<int64_t>{3, 14, 28}));
  EXPECT_EQ(tensors.views.size(), 3);
  EXPECT_EQ(tensors.views.num_targets(), 2);
  EXPECT_EQ(tensors.validity[2][0][3].item<float>(), 0);
  EXPECT_EQ(tensors.validity.sum().item<float>(), 3 * 14 * 28 - 1);
  loaded.views[0].depth = DepthMap();
  EXPECT_FALSE(to_tensors(loaded).depth.defined());
}

}  // namespace
}  // namespace gld
