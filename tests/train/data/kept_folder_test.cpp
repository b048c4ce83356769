#include "train/data/kept_folder.h"

#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/data/kept_batch.h"

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;

std::vector<fs::path> files_in(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file()) files.push_back(entry.path());
  }
  return files;
}

TrainingDataOptions two_batches() {
  TrainingDataOptions options = test::small_data();
  options.distinct_batches = 2;
  options.loading.batch_size = 2;
  return options;
}

TrainingBatch batch_kept_in(const fs::path& folder, int64_t index,
                            const TrainingDataOptions& options = two_batches(),
                            FrameParts parts = FrameParts::kImageAndDepth) {
  DatasetBatches batches(options, {{56, 56}}, parts);
  if (!folder.empty()) batches.keep_in(folder);
  return batches.batch(index);
}

void expect_same(const TrainingBatch& batch, const TrainingBatch& expected) {
  EXPECT_EQ(batch.index, expected.index);
  ASSERT_EQ(batch.scenes.size(), expected.scenes.size());
  for (size_t i = 0; i < batch.scenes.size(); ++i) {
    const TrainingScene &scene = batch.scenes[i], &other = expected.scenes[i];
    EXPECT_EQ(scene.name, other.name);
    EXPECT_EQ(scene.metric, other.metric);
    EXPECT_TRUE(torch::equal(scene.images, other.images));
    EXPECT_EQ(scene.images.scalar_type(), torch::kFloat32);
    ASSERT_EQ(scene.depth.defined(), other.depth.defined());
    if (scene.depth.defined()) {
      EXPECT_TRUE(torch::equal(scene.depth, other.depth));
    }
    EXPECT_EQ(scene.views.num_sources, other.views.num_sources);
    ASSERT_EQ(scene.views.size(), other.views.size());
    for (size_t view = 0; view < scene.views.cameras.size(); ++view) {
      const Camera &camera = scene.views.cameras[view], &other_camera = other.views.cameras[view];
      EXPECT_EQ(camera.world_from_camera.matrix(), other_camera.world_from_camera.matrix());
      EXPECT_EQ(camera.intrinsics, other_camera.intrinsics);
      EXPECT_EQ(camera.width, other_camera.width);
      EXPECT_EQ(camera.height, other_camera.height);
    }
  }
}

TEST(KeptFolder, GivesBackWhatWasKeptOfTheSameMaking) {
  const TemporaryFolder folder;
  const KeptFolder first(folder.path(), "a"), same(folder.path(), "a"), other(folder.path(), "b");
  const auto values = torch::tensor({1.0F, -0.0F, std::nanf("")});
  EXPECT_FALSE(first.find("key"));
  first.keep("key", {{{"values", values}}, {{"name", "room"}}});
  first.keep("nothing came of it", {});
  EXPECT_FALSE(other.find("key"));
  EXPECT_FALSE(same.find("another key"));
  const auto found = same.find("key");
  ASSERT_TRUE(found);
  EXPECT_EQ(found->text.at("name"), "room");
  EXPECT_TRUE(torch::equal(found->tensors.at("values").view(torch::kInt32), values.view(torch::kInt32)));
  const auto nothing = same.find("nothing came of it");
  ASSERT_TRUE(nothing);
  EXPECT_TRUE(nothing->tensors.empty());
}

TEST(KeptFolder, ATornFileIsMadeAnew) {
  const TemporaryFolder folder;
  const KeptFolder kept(folder.path(), "a");
  kept.keep("key", {{{"values", torch::ones({100})}}, {}});
  const auto files = files_in(folder.path());
  ASSERT_EQ(files.size(), 1U);
  fs::resize_file(files.front(), fs::file_size(files.front()) / 2);
  EXPECT_FALSE(kept.find("key"));
  kept.keep("key", {{{"values", torch::zeros({2})}}, {}});
  ASSERT_TRUE(kept.find("key"));
  EXPECT_EQ(kept.find("key")->tensors.at("values").numel(), 2);
}

TEST(KeptFolder, AFileInItsPlaceIsRefused) {
  const TemporaryFolder folder;
  const fs::path file = folder.path() / "file";
  std::ofstream(file) << "text";
  EXPECT_EQ(test::error_of([&] { KeptFolder(file, "a"); }),
            "--kept-scenes " + file.string() +
                ": expected a folder that can be written, found a file of that name; choose another.");
}

TEST(KeptBatches, AreTheSameToTheBit) {
  const TemporaryFolder folder;
  for (const int64_t index : {0, 1, 2, 3, 0}) {
    const TrainingBatch drawn = batch_kept_in({}, index);
    expect_same(batch_kept_in(folder.path(), index), drawn);
    expect_same(batch_kept_in(folder.path(), index), drawn);
  }
  EXPECT_EQ(files_in(folder.path()).size(), 2U);
}

// The second one reads: it shows what somebody else put there.
TEST(KeptBatches, AreTakenFromTheFolder) {
  const TemporaryFolder folder, of_others;
  batch_kept_in(folder.path(), 0);
  auto others = two_batches();
  others.synthetic.seed = 7;
  batch_kept_in(of_others.path(), 0, others);
  const auto files = files_in(folder.path());
  ASSERT_EQ(files.size(), 1U);
  fs::copy_file(files_in(of_others.path()).front(), files.front(), fs::copy_options::overwrite_existing);
  expect_same(batch_kept_in(folder.path(), 0), batch_kept_in({}, 0, others));
}

// A folder's things lie in folders of two hexadecimal digits: files of those names are a disk that takes nothing.
TEST(KeptBatches, StayInMemoryWhereTheFolderTakesNothing) {
  const TemporaryFolder folder;
  for (int i = 0; i < 256; ++i) std::ofstream(folder.path() / fmt::format("{:02x}", i)) << "taken";
  DatasetBatches batches(two_batches(), {{56, 56}}, FrameParts::kImageAndDepth);
  batches.keep_in(folder.path());
  for (int64_t index = 0; index < 6; ++index) expect_same(batches.batch(index), batch_kept_in({}, index));
  EXPECT_EQ(batches.report().batches, 2);
}

TEST(KeptBatches, ComeFromTheFolderAndAreDrawnOnce) {
  const TemporaryFolder folder;
  DatasetBatches batches(two_batches(), {{56, 56}}, FrameParts::kImageAndDepth);
  batches.keep_in(folder.path());
  for (int64_t index = 0; index < 6; ++index) batches.batch(index);
  EXPECT_EQ(batches.report().batches, 2);
}

TEST(KeptBatches, OtherOptionsAreOtherBatches) {
  const TemporaryFolder folder;
  const auto files = [&] { return files_in(folder.path()).size(); };
  batch_kept_in(folder.path(), 0);
  auto longer = two_batches();
  longer.distinct_batches = 5;  // the first are the same, however many come before they come again
  longer.validation_seed += 1;
  batch_kept_in(folder.path(), 0, longer);
  EXPECT_EQ(files(), 1U);
  auto other = two_batches();
  other.synthetic.seed = 7;
  batch_kept_in(folder.path(), 0, other);
  EXPECT_EQ(files(), 2U);
  EXPECT_FALSE(batch_kept_in(folder.path(), 0, two_batches(), FrameParts::kImage).scenes[0].depth.defined());
  EXPECT_EQ(files(), 3U);
  // Batches that do not come again are not kept.
  auto endless = two_batches();
  endless.distinct_batches = 0;
  batch_kept_in(folder.path(), 0, endless);
  EXPECT_EQ(files(), 3U);
}

TEST(KeptBatches, AForeignThingIsNoBatch) {
  EXPECT_FALSE(batch_of({}, 0));
  KeptThing kept = kept_batch(batch_kept_in({}, 0));
  ASSERT_TRUE(batch_of(kept, 0));
  kept.tensors.erase("1.images");
  EXPECT_FALSE(batch_of(kept, 0));
}

}  // namespace
}  // namespace gld
