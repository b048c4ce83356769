#include "infer/export/depth_export.h"

#include "datasets/images/image_file.h"
#include "datasets/images/pfm_file.h"
#include "datasets/pictures/depth_preview.h"
#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/exported_files.h"
#include "tests/support/not_finite.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <cstring>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::kInfinity;
using test::kNan;

DepthMap map_of(int64_t width, int64_t height, const std::vector<float>& values) {
  DepthMap map(width, height);
  map.metres = values;
  return map;
}

DepthMap slope(int64_t width, int64_t height) {
  DepthMap map(width, height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) map.at(x, y) = 1.0F + 0.01F * static_cast<float>(x + y * width);
  }
  return map;
}

TEST(DepthUnit, IsARoundNumberThatFitsTheLargestDepth) {
  EXPECT_DOUBLE_EQ(choose_depth_unit({map_of(2, 1, {1.0F, 60.0F})}), 1e-3);
  EXPECT_DOUBLE_EQ(choose_depth_unit({map_of(2, 1, {1.0F, 65.535F})}), 1e-3);
  EXPECT_DOUBLE_EQ(choose_depth_unit({map_of(1, 1, {3.0F}), map_of(1, 1, {2.0F})}), 5e-5);
  EXPECT_DOUBLE_EQ(choose_depth_unit({map_of(1, 1, {1e8F})}), 2e3);
  EXPECT_DOUBLE_EQ(choose_depth_unit({map_of(4, 1, {0, kNan, kInfinity, -1})}), 1e-3);
  EXPECT_DOUBLE_EQ(choose_depth_unit({}), 1e-3);
  // One overflow among 1000 values does not cost the others their digits.
  DepthMap overflow = map_of(1000, 1, std::vector<float>(1000, 2.0F));
  overflow.metres[500] = 3e38F;
  EXPECT_DOUBLE_EQ(choose_depth_unit({overflow}), 5e-5);
}

TEST(DepthPng, ReadsBackToHalfAStep) {
  test::TemporaryFolder folder;
  const DepthMap depth = slope(40, 5);
  const double unit = choose_depth_unit({depth});
  Provenance provenance;
  provenance.program = "gld test";
  for (const char* name : {"a.png", "b.png"}) export_depth_png(folder.path() / name, depth, unit, provenance);
  const DepthMap read = read_depth_png(folder.path() / "a.png", unit);
  ASSERT_EQ(read.width, 40);
  ASSERT_EQ(read.height, 5);
  for (size_t i = 0; i < depth.metres.size(); ++i) {
    EXPECT_NEAR(read.metres[i], depth.metres[i], 0.5001 * unit);
  }
  EXPECT_EQ(read_file(folder.path() / "a.png"), read_file(folder.path() / "b.png"));
  const TextItems texts = test::read_png_texts(folder.path() / "a.png");
  EXPECT_EQ(std::stod(test::find_text(texts, "gld:depth_unit")), unit);
  EXPECT_EQ(test::find_text(texts, "Software"), "gld test");
}

TEST(DepthPng, KeepsUnknownNearAndFarApart) {
  const Grey16 grey =
      quantised_depth(map_of(4, 2, {0, kNan, kInfinity, -kInfinity, -2, 1e-9F, 1e30F, 0.5F}), 1e-3);
  EXPECT_THAT(grey.values, testing::ElementsAre(0, 0, 0, 0, 0, 1, 65535, 500));
  EXPECT_EQ(test::error_of([] { quantised_depth(slope(2, 2), 0); }),
            "depth unit: expected a positive length, found 0; check the depth maps.");
}

TEST(Pfm, KeepsEveryBitAndTurnsWhatIsNoDepthIntoZero) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "depth.pfm";
  const DepthMap depth = map_of(3, 2, {0.1F, kNan, 3e38F, kInfinity, 1e-40F, -5});
  write_pfm(file, depth);
  EXPECT_THAT(test::read_pfm(file).metres, testing::ElementsAre(0.1F, 0, 3e38F, 0, 1e-40F, 0));
  const std::string bytes = read_file(file);
  EXPECT_EQ(bytes.size(), std::string("Pf\n3 2\n-1.0\n").size() + 24);
  EXPECT_EQ(bytes.substr(0, 12), "Pf\n3 2\n-1.0\n");
  // The bottom row comes first.
  float first = 1;
  std::memcpy(&first, bytes.data() + 12 + 4, 4);
  EXPECT_EQ(first, 1e-40F);
  write_pfm(folder.path() / "again.pfm", depth);
  EXPECT_EQ(read_file(folder.path() / "again.pfm"), bytes);
}

TEST(Pfm, RefusesWhatDoesNotFit) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "depth.pfm";
  EXPECT_EQ(
      test::error_of([&] { write_pfm(file, DepthMap()); }),
      file.string() + ": expected a depth map with values, found 0x0 with 0 values; check what made it.");
}

TEST(DepthRange, IgnoresOutliersAndWidensAFlatScene) {
  std::vector<float> values(1000);
  for (size_t i = 0; i < values.size(); ++i) values[i] = 1.0F + 0.001F * static_cast<float>(i);
  values[0] = 1e-6F;
  values[1] = 3e38F;
  values[2] = kNan;
  const DepthRange range = robust_depth_range({map_of(1000, 1, values)});
  EXPECT_NEAR(range.nearest, 1.01, 0.005);
  EXPECT_NEAR(range.farthest, 1.99, 0.005);
  const DepthRange flat = robust_depth_range({map_of(2, 2, {3, 3, 3, 3})});
  EXPECT_LT(flat.nearest, 3);
  EXPECT_GT(flat.farthest, 3);
  EXPECT_NEAR(flat.farthest / flat.nearest, 1.02, 1e-9);
  const DepthRange none = robust_depth_range({map_of(2, 1, {0, kNan})});
  EXPECT_EQ(none.nearest, 1);
  EXPECT_EQ(none.farthest, 2);
}

TEST(DepthPreview, IsBrightNearDarkFarAndGreyWhereUnknown) {
  const DepthRange range{1, 4};
  const Image image = coloured_depth(map_of(5, 1, {1, 4, kNan, 2, 100}), range);
  const auto pixel = [&](int64_t x) {
    return Rgb{image.pixel(x, 0)[0], image.pixel(x, 0)[1], image.pixel(x, 0)[2]};
  };
  EXPECT_EQ(pixel(0), viridis(1));
  EXPECT_EQ(pixel(1), viridis(0));
  EXPECT_EQ(pixel(2), (Rgb{96, 96, 96}));
  EXPECT_EQ(pixel(3), viridis(0.5));  // logarithmic
  EXPECT_EQ(pixel(4), viridis(0));
  EXPECT_EQ(viridis(kNan), viridis(0));
  const auto brightness = [](const Rgb& c) { return 0.3 * c[0] + 0.59 * c[1] + 0.11 * c[2]; };
  for (int i = 0; i < 20; ++i) EXPECT_LT(brightness(viridis(i / 20.0)), brightness(viridis((i + 1) / 20.0)));
}

TEST(DepthPreview, HasALegendBelowAtAnySize) {
  for (const auto& [width, height] : {std::pair<int64_t, int64_t>{112, 112}, {504, 280}, {16, 128}}) {
    const DepthMap depth = slope(width, height);
    const DepthRange range = robust_depth_range({depth});
    const Image preview = depth_preview(depth, range, "m");
    EXPECT_EQ(preview.width, std::max<int64_t>(width, 240));
    EXPECT_EQ(preview.height, height + 40);
    // The bar: nearest at the left, farthest at the right.
    const uint8_t* left = preview.pixel(12, height + 8);
    const uint8_t* right = preview.pixel(preview.width - 13, height + 8);
    EXPECT_EQ((Rgb{left[0], left[1], left[2]}), viridis(1));
    EXPECT_EQ((Rgb{right[0], right[1], right[2]}), viridis(0));
    // Numbers are written below the bar.
    int64_t ink = 0;
    for (int64_t y = height + 20; y < height + 40; ++y) {
      for (int64_t x = 0; x < preview.width; ++x) ink += preview.pixel(x, y)[0] > 150 ? 1 : 0;
    }
    EXPECT_GT(ink, 20);
  }
}

}  // namespace
}  // namespace gld
