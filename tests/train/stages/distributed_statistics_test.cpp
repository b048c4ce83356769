#include "gld/base/atomic_file.h"
#include "models/bundle/random_bundle.h"
#include "models/bundle/view_unit_file.h"
#include "tests/support/forked_processes.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/stages/latent_stages.h"

#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

TEST(DistributedStatistics, OneTwoAndThreeProcessesGiveTheSameBits) {
  const test::TemporaryFolder folder;
  test::in_processes(1, folder.path(), [&](const ProcessesOptions&) {
    write_random_bundle(folder.path() / "model", test::small_model(), 3);
  });
  for (const int64_t count : {1, 2, 3}) {
    test::in_processes(count, folder.path(), [&](const ProcessesOptions& processes) {
      StatsOptions options;
      options.model = (folder.path() / "model").string();
      options.out = (folder.path() / std::to_string(count)).string();
      options.scene_count = 17;  // not the last batch's second scene
      options.data = test::small_data();
      options.data.loading.batch_size = 2;
      options.processes = processes;
      compute_statistics(options);
    });
  }
  for (const char* file : {"report.json", "model/model.yaml", "model/seen_scenes.json",
                           "model/statistics_level0.safetensors", "model/statistics_level1.safetensors"}) {
    const auto one = read_file(folder.path() / "1" / file);
    EXPECT_EQ(read_file(folder.path() / "2" / file), one) << file;
    EXPECT_EQ(read_file(folder.path() / "3" / file), one) << file;
  }
  // Drawn rooms are in metres, and this model has a head: what its unit is long stands in the bundle.
  const BundleOptions options = ModelBundle::open(folder.path() / "1" / "model").options();
  EXPECT_GT(options.single_source_unit, 0);
  EXPECT_GT(options.single_source_unit_deviation, 0);
  const auto report = nlohmann::json::parse(read_file(folder.path() / "1" / "report.json"));
  EXPECT_EQ(report.at("single_source_unit").at("metres"), options.single_source_unit);
  EXPECT_EQ(report.at("single_source_unit").at("log_deviation"), options.single_source_unit_deviation);
  EXPECT_EQ(report.at("single_source_unit").at("scenes"), 17);
  const auto unit_of = [&](const char* run) {
    return read_single_view_unit(ModelBundle::open(folder.path() / run / "model"));
  };
  const auto unit = unit_of("1");
  ASSERT_NE(unit, nullptr);
  EXPECT_NEAR(report.at("single_source_unit").at("log_deviation_by_view").get<double>(), unit->log_deviation,
              1e-4);
  for (const char* run : {"2", "3"}) {
    EXPECT_NEAR(unit_of(run)->log_deviation, unit->log_deviation, 1e-5);
    EXPECT_TRUE(torch::allclose(unit_of(run)->weights, unit->weights, 1e-3, 1e-6));
  }
}

}  // namespace
}  // namespace gld
