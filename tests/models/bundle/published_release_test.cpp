// gld convert --release: the published files by their own names.
#include "models/bundle/published_release.h"

#include "gld/base/atomic_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

class PublishedRelease : public testing::Test {
 protected:
  // The files are as the snapshot and the clone it is put into lie on disk; what is in them is looked at later.
  PublishedRelease() {
    for (const auto model : {ReleasedModel::kDa3, ReleasedModel::kVggt}) {
      for (const auto& file : release_files(model)) put(file.path);
    }
    options_.release = folder().string();
    options_.out = path("out");
  }

  const std::filesystem::path& folder() const { return folder_.path(); }
  std::string path(const std::string& name) const { return (folder() / name).string(); }
  void put(const std::string& name) const {
    std::filesystem::create_directories((folder() / name).parent_path());
    write_file_atomically(folder() / name, "");
  }
  void move(const std::string& from, const std::string& to) const {
    std::filesystem::create_directories((folder() / to).parent_path());
    std::filesystem::rename(folder() / from, folder() / to);
  }

  test::TemporaryFolder folder_;
  ConversionOptions options_;
};

TEST_F(PublishedRelease, FilesHaveOneOptionEach) {
  for (const auto model : {ReleasedModel::kDa3, ReleasedModel::kVggt}) {
    std::set<std::string> paths;
    for (const auto& file : release_files(model)) EXPECT_TRUE(paths.insert(file.path).second) << file.path;
    EXPECT_EQ(paths.size(), 7U);
  }
}

TEST_F(PublishedRelease, GivesTheModelOnDa3) {
  const auto filled = with_release(options_);
  EXPECT_EQ(filled.backbones.at("da3"), path("pretrained_models/da3/model.safetensors"));
  EXPECT_EQ(filled.dpt_decoder, path("pretrained_models/da3/dpt_decoder.pt"));
  EXPECT_EQ(filled.rgb_decoder, path("pretrained_models/mae_decoder.pt"));
  EXPECT_EQ(filled.level1, path("checkpoints/da3_level1.pt"));
  EXPECT_EQ(filled.cascade, path("checkpoints/da3_cascade.pt"));
  EXPECT_EQ(filled.statistics_level0, path("model_stats/da3/normalization_stats_level0.pt"));
  EXPECT_EQ(filled.statistics_level1, path("model_stats/da3/normalization_stats_level1.pt"));
  EXPECT_EQ(filled.special_statistics_level0, "");
  EXPECT_NO_THROW(options_.check());
}

TEST_F(PublishedRelease, GivesTheModelOnVggtWhereVggtIsGiven) {
  options_.backbones["vggt"] = "vggt_1b.safetensors";
  const auto filled = with_release(options_);
  EXPECT_EQ(filled.backbones.at("vggt"), "vggt_1b.safetensors");
  EXPECT_EQ(filled.backbones.count("da3"), 0U);
  EXPECT_EQ(filled.dpt_decoder, "");
  EXPECT_EQ(filled.rgb_decoder, path("pretrained_models/vggt/mae_decoder.pt"));
  EXPECT_EQ(filled.level1, path("checkpoints/vggt_level1.pt"));
  EXPECT_EQ(filled.cascade, path("checkpoints/vggt_cascade.pt"));
  EXPECT_EQ(filled.special_statistics_level1, path("model_stats/vggt/special_stats_level1.pt"));
}

// What a snapshot is unpacked to differs; what one name is of, it is of wherever it lies.
TEST_F(PublishedRelease, IsFoundWithoutItsFirstFolderAndInOneFolder) {
  move("model_stats/da3/normalization_stats_level0.pt", "da3/normalization_stats_level0.pt");
  move("checkpoints/da3_level1.pt", "da3_level1.pt");
  move("pretrained_models/da3/dpt_decoder.pt", "dpt_decoder.pt");
  move("pretrained_models/mae_decoder.pt", "mae_decoder.pt");
  const auto filled = with_release(options_);
  EXPECT_EQ(filled.statistics_level0, path("da3/normalization_stats_level0.pt"));
  EXPECT_EQ(filled.level1, path("da3_level1.pt"));
  EXPECT_EQ(filled.dpt_decoder, path("dpt_decoder.pt"));
  EXPECT_EQ(filled.rgb_decoder, path("mae_decoder.pt"));
  // The decoder of DA3 is not taken for that of VGGT, whose name is the same.
  std::filesystem::remove(folder() / "pretrained_models/vggt/mae_decoder.pt");
  options_.backbones["vggt"] = "vggt_1b.safetensors";
  EXPECT_THAT(error_of([&] { with_release(options_); }),
              testing::HasSubstr("found none of the name pretrained_models/vggt/mae_decoder.pt;"));
}

TEST_F(PublishedRelease, MissingFilesGetOneSentence) {
  std::filesystem::remove(folder() / "checkpoints/da3_cascade.pt");
  std::filesystem::remove(folder() / "pretrained_models/da3/model.safetensors");
  EXPECT_EQ(error_of([&] { convert(options_); }),
            folder().string() +
                ": expected the files of the published model on DA3, found none of the name "
                "pretrained_models/da3/model.safetensors, checkpoints/da3_cascade.pt; download the snapshot "
                "whole, or give the file by its own option (see gld convert --help).");
  EXPECT_FALSE(std::filesystem::exists(options_.out));
  // One that is given is none that is missing.
  options_.cascade = "my_cascade.pt";
  options_.backbones["da3"] = "da3.safetensors";
  EXPECT_EQ(with_release(options_).cascade, "my_cascade.pt");
  std::filesystem::remove_all(folder() / "model_stats");
  EXPECT_EQ(
      error_of([&] { with_release(options_); }),
      folder().string() +
          ": expected the files of the published model on DA3, found none of the name "
          "model_stats/da3/normalization_stats_level0.pt, model_stats/da3/normalization_stats_level1.pt; "
          "model_stats/ is in the Git repository of the release, not in its snapshot: copy it beside "
          "checkpoints/.");
  options_.release = path("nowhere");
  EXPECT_EQ(error_of([&] { with_release(options_); }),
            "--release: expected the folder of the published snapshot, found '" + path("nowhere") +
                "'; name the folder that holds checkpoints/ and pretrained_models/.");
  options_.release.clear();
  EXPECT_EQ(with_release(options_).statistics_level0, "");
}

// Converted from the release's folder, real statistics are what they are by their own options.
TEST_F(PublishedRelease, IsReadAsTheFilesAreByTheirOptions) {
  for (const char* level : {"0", "1"}) {
    const std::string name = std::string("normalization_stats_level") + level + ".pt";
    std::filesystem::copy_file(test::test_data() / "stats/da3" / name, folder() / "model_stats/da3" / name,
                               std::filesystem::copy_options::overwrite_existing);
  }
  const auto filled = with_release(options_);
  ConversionOptions statistics;
  statistics.statistics_level0 = filled.statistics_level0;
  statistics.statistics_level1 = filled.statistics_level1;
  statistics.out = path("out");
  EXPECT_EQ(convert(statistics)["parts"].size(), 2U);
  // The other files are empty: the first of them is named.
  options_.out = path("whole");
  EXPECT_THAT(error_of([&] { convert(options_); }),
              testing::HasSubstr("pretrained_models/da3/model.safetensors"));
}

}  // namespace
}  // namespace gld
