#include "infer/export/ray_export.h"

#include "gld/base/atomic_file.h"
#include "gld/files/npy.h"
#include "tests/support/error_of.h"
#include "tests/support/exported_files.h"
#include "tests/support/temporary_folder.h"

#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

RayMap numbered(int64_t width, int64_t height) {
  RayMap rays(width, height);
  for (size_t i = 0; i < rays.values.size(); ++i) rays.values[i] = 0.25F * static_cast<float>(i) - 3;
  return rays;
}

TEST(RayExport, KeepsEveryBitAndSaysWhereItComesFrom) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "view_00.npz";
  const RayMap rays = numbered(5, 3);
  ConfidenceMap confidence(5, 3);
  for (size_t i = 0; i < 15; ++i) confidence.values[i] = 1.0F + static_cast<float>(i);
  Provenance provenance;
  provenance.program = "gld test";
  provenance.seed = 3;
  EXPECT_EQ(export_rays(file, rays, confidence, provenance), 0);
  EXPECT_EQ(export_rays(folder.path() / "again.npz", rays, confidence, provenance), 0);
  EXPECT_EQ(read_file(file), read_file(folder.path() / "again.npz"));
  const test::RayFile read = test::read_rays(file);
  EXPECT_EQ(read.rays.width, 5);
  EXPECT_EQ(read.rays.height, 3);
  EXPECT_EQ(read.rays.values, rays.values);
  EXPECT_EQ(read.confidence.values, confidence.values);
  EXPECT_EQ(read.provenance, provenance_items(provenance));
  EXPECT_THAT(NpzFile::open(file).read("rays").shape, testing::ElementsAre(3, 5, 6));
}

TEST(RayExport, MarksRaysThatAreNotFinite) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "view_00.npz";
  RayMap rays = numbered(3, 1);
  rays.ray(0, 0)[4] = std::numeric_limits<float>::quiet_NaN();
  ConfidenceMap confidence(3, 1);
  confidence.values = {5, 6, std::numeric_limits<float>::infinity()};
  EXPECT_EQ(export_rays(file, rays, confidence, {}), 2);
  const test::RayFile read = test::read_rays(file);
  EXPECT_THAT(read.confidence.values, testing::ElementsAre(0, 6, 0));
  for (int i = 0; i < 6; ++i) {
    EXPECT_EQ(read.rays.ray(0, 0)[i], 0);
    EXPECT_EQ(read.rays.ray(1, 0)[i], rays.ray(1, 0)[i]);
    EXPECT_EQ(read.rays.ray(2, 0)[i], 0);
  }
  EXPECT_EQ(export_rays(file, numbered(2, 2), ConfidenceMap(), {}), 0);
  EXPECT_THAT(test::read_rays(file).confidence.values, testing::Each(1.0F));
}

TEST(RayExport, RefusesWhatDoesNotFit) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "view_00.npz";
  EXPECT_EQ(test::error_of([&] { export_rays(file, numbered(3, 2), ConfidenceMap(2, 3), {}); }),
            file.string() + ": expected confidences of the rays' size 3x2, found 2x3; check what made them.");
  EXPECT_EQ(test::error_of([&] { export_rays(file, RayMap(), ConfidenceMap(), {}); }),
            file.string() + ": expected a ray map with values, found an empty one; check what made it.");
  EXPECT_FALSE(std::filesystem::exists(file));
}

}  // namespace
}  // namespace gld
