#include "models/bundle/seen_scenes.h"

#include "gld/base/atomic_file.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <torch/types.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(SeenScenes, AreWhatMostScenesAreNearerThan) {
  std::vector<double> divergences;
  for (int i = 100; i >= 0; --i) divergences.push_back(0.01 * i);
  const SeenLevel level = seen_level(1, divergences);
  EXPECT_EQ(level.level, 1);
  EXPECT_NEAR(level.median, 0.5, 1e-12);
  EXPECT_NEAR(level.usual, 0.99, 1e-12);
  EXPECT_NEAR(level.largest, 1, 1e-12);
}

TEST(SeenScenes, BelongToTheirStatistics) {
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path(), small_bundle_options(), 3);
  const auto bundle = ModelBundle::open(folder.path());
  EXPECT_FALSE(read_seen_scenes(bundle).has_value());
  const std::string hash = bundle.content_hash();
  SeenScenes seen;
  seen.drawn = true;
  seen.scenes = 512;
  seen.levels = {{1, 0.02, 0.07, 0.1}, {0, 0.03, 0.09, 0.2}};
  write_seen_scenes(bundle, seen);
  EXPECT_EQ(bundle.content_hash(), hash);  // errors that were measured with these weights hold
  const auto read = read_seen_scenes(bundle);
  ASSERT_TRUE(read.has_value());
  EXPECT_TRUE(read->drawn);
  EXPECT_EQ(read->scenes, 512);
  ASSERT_EQ(read->levels.size(), 2U);
  EXPECT_EQ(read->levels[1].level, 0);
  EXPECT_EQ(read->levels[1].usual, 0.09);

  // Of other statistics they say nothing.
  const auto channels = small_bundle_options().backbone.level_channels();
  save_bundle_part(folder.path(), BundlePart::statistics(1),
                   {{"mean", torch::full({channels}, 3.0F)}, {"var", torch::ones({channels})}});
  EXPECT_FALSE(read_seen_scenes(bundle).has_value());

  write_file_atomically(folder.path() / kSeenScenesFile, "{\"format\": \"gld seen scenes 1\"}\n");
  EXPECT_THAT(test::error_of([&] { read_seen_scenes(bundle); }),
              testing::HasSubstr("a key that is missing or has a value of another kind"));
}

// Without them no run says that its photographs are like nothing that the model has seen.
TEST(SeenScenes, ShippedModelsHaveThem) {
  for (const char* model : {"configs/tiny", "configs/splat"}) {
    const ModelBundle bundle = ModelBundle::open(test::source_root() / model);
    const auto seen = read_seen_scenes(bundle);
    ASSERT_TRUE(seen.has_value()) << model;
    EXPECT_TRUE(seen->drawn);
    EXPECT_EQ(seen->levels.size(), bundle.options().generators.size());
  }
}

}  // namespace
}  // namespace gld
