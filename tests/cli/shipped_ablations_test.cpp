// The descriptions in configs/ablations: their options exist, and what they have in common runs once.
#include "ablate/configuration/ablation.h"
#include "ablate/plan/stage_plan.h"
#include "cli/ablate_command.h"
#include "gld/base/configuration.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <filesystem>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

namespace fs = std::filesystem;

// Descriptions name files by their paths in the repository.
class ShippedAblations : public testing::Test {
 protected:
  ShippedAblations() { fs::current_path(test::source_root()); }
  ~ShippedAblations() override { fs::current_path(before_); }

  static AblationPlan plan(const fs::path& file) {
    AblateOptions options;
    read_ablate_options(file, options);
    options.out = "run";
    return plan_ablation(read_ablation(file, options), this_program());
  }

 private:
  const fs::path before_ = fs::current_path();
};

// The description of an autoencoder that is not ours to ship (docs/WEIGHTS.md).
constexpr const char* kOfGivenAutoencoder = "splatent_baselines";

std::vector<fs::path> descriptions_in(const fs::path& folder) {
  std::vector<fs::path> files;
  for (const auto& item : fs::directory_iterator(folder)) {
    if (item.path().extension() == ".yaml") files.push_back(fs::absolute(item.path()));
  }
  std::sort(files.begin(), files.end());
  return files;
}

TEST_F(ShippedAblations, ArePlanned) {
  const auto files = descriptions_in("configs/ablations");
  EXPECT_GE(files.size(), 20U);
  for (const fs::path& file : files) {
    if (file.stem() == kOfGivenAutoencoder) continue;
    SCOPED_TRACE(file);
    EXPECT_FALSE(plan(file).tasks.empty());
  }
}

TEST_F(ShippedAblations, ArePlannedWhereWeightsAndScenesAreGiven) {
  auto files = descriptions_in("configs/ablations/paper");
  for (const fs::path& file : descriptions_in("configs/ablations")) {
    if (file.stem() == kOfGivenAutoencoder) files.push_back(file);
  }
  BundleOptions taef2;
  load_yaml(taef2, "configs/ablations/latents/taef2/model.yaml");
  const fs::path recipes = fs::absolute("configs");
  const test::TemporaryFolder given;
  fs::current_path(given.path());
  fs::create_directory_symlink(recipes, "configs");
  write_random_bundle("bundles/gld-da3", small_bundle_options(), 1);
  write_random_bundle("bundles/taef2", taef2, 1);
  for (const char* scenes : {"data/re10k_test/scene", "data/scannet_test", "data/scannet_test_1500"})
    fs::create_directories(scenes);
  for (const fs::path& file : files) {
    SCOPED_TRACE(file);
    EXPECT_FALSE(plan(file).tasks.empty());
  }
}

std::set<std::string> keys_of(const AblationPlan& plan, const std::string& stage) {
  std::set<std::string> keys;
  for (const StageTask& task : plan.tasks) {
    if (task.stage == stage) keys.insert(task.key);
  }
  return keys;
}

// Tables 2 and 8 are of the same M0 and M1: these take hours, and are trained once where both have one --cache.
TEST_F(ShippedAblations, BoundaryAndCascadeShareTheirTrainings) {
  const AblationPlan boundary = plan("configs/ablations/boundary.yaml"),
                     cascade = plan("configs/ablations/cascade.yaml");
  EXPECT_EQ(keys_of(boundary, "statistics"), keys_of(cascade, "statistics"));
  for (const char* stage : {"m0", "m1"}) {
    EXPECT_EQ(keys_of(boundary, stage).size(), 3U) << stage;  // one a seed
    EXPECT_EQ(keys_of(boundary, stage), keys_of(cascade, stage)) << stage;
  }
}

// So are the latent spaces of Tables 3, 7 and 13, of Figure 1c, and of ours that train a DiT in DA3's.
TEST_F(ShippedAblations, TablesOfLatentSpacesShareTheirTrainings) {
  const AblationPlan latents = plan("configs/ablations/latents.yaml");
  EXPECT_EQ(keys_of(latents, "backbone").size(), 9U);  // of three spaces, one a seed
  EXPECT_EQ(keys_of(latents, "autoencoder").size(), 3U);
  const std::vector<std::pair<std::string, size_t>> others{
      {"convergence", 6}, {"decoders", 6}, {"conventions", 3}, {"regression", 3}, {"warping", 3}};
  for (const auto& [name, backbones] : others) {
    SCOPED_TRACE(name);
    const AblationPlan other = plan("configs/ablations/" + name + ".yaml");
    const auto within = [&](const std::string& stage) {
      const auto all = keys_of(latents, stage), some = keys_of(other, stage);
      return std::includes(all.begin(), all.end(), some.begin(), some.end());
    };
    EXPECT_EQ(keys_of(other, "backbone").size(), backbones);
    EXPECT_TRUE(within("backbone"));
    EXPECT_TRUE(within("autoencoder"));
    EXPECT_EQ(keys_of(other, "autoencoder").size(), backbones == 6 ? 3U : 0U);
    if (name != "decoders") {
      EXPECT_EQ(keys_of(other, "decoder").size(), backbones);
      EXPECT_TRUE(within("decoder"));
    }
  }
}

}  // namespace
}  // namespace gld
