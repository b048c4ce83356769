#include "ablate/run/assembled_bundle.h"

#include "gld/base/sha256.h"
#include "models/bundle/bundle.h"
#include "models/bundle/random_bundle.h"
#include "models/bundle/view_unit_file.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

// A bundle, and what gld stats made of it: statistics and a unit of other scenes.
struct MeasuredAgain {
  const test::TemporaryFolder folder;
  const std::filesystem::path first = folder.path() / "first", stats = folder.path() / "stats",
                              assembled = folder.path() / "assembled";

  MeasuredAgain() {
    BundleOptions options = small_bundle_options();
    options.single_source_unit = 2;
    options.single_source_unit_deviation = 0.25;
    write_random_bundle(first, options, 3);
    options.single_source_unit = 3;
    options.single_source_unit_deviation = 0.125;
    write_random_bundle(stats, options, 3);
    const auto channels = options.backbone.level_channels();
    save_bundle_part(stats, BundlePart::statistics(1),
                     {{"mean", torch::full({channels}, 3.0F)}, {"var", torch::ones({channels})}});
  }

  BundleOptions assemble(const BundleOptions& options) const {
    assemble_bundle(options, first, {stats}, assembled);
    return ModelBundle::open(assembled).options();
  }
};

TEST(AssembledBundle, TakesTheUnitWithTheStatistics) {
  const MeasuredAgain given;
  const BundleOptions made = given.assemble(ModelBundle::open(given.first).options());
  const auto file_of = [](const std::filesystem::path& folder) {
    return sha256_of_file(ModelBundle::open(folder).file(BundlePart::statistics(1)));
  };
  EXPECT_EQ(file_of(given.assembled), file_of(given.stats));
  EXPECT_EQ(made.single_source_unit, 3);
  EXPECT_EQ(made.single_source_unit_deviation, 0.125);
}

TEST(AssembledBundle, AUnitThatIsAskedForStays) {
  const MeasuredAgain given;
  BundleOptions asked = ModelBundle::open(given.first).options();
  asked.single_source_unit = asked.single_source_unit_deviation = 0;
  EXPECT_EQ(given.assemble(asked).single_source_unit, 0);
}

TEST(AssembledBundle, WithoutOtherStatisticsTheUnitIsTheFirsts) {
  const MeasuredAgain given;
  std::filesystem::remove(given.stats / "statistics_level1.safetensors");
  const BundleOptions made = given.assemble(ModelBundle::open(given.first).options());
  EXPECT_EQ(made.single_source_unit, 2);
}

// What guesses a unit by the view goes with the backbone and the head that are taken.
TEST(AssembledBundle, TakesTheGuessOfItsHead) {
  const MeasuredAgain given;
  SingleViewUnit unit;
  unit.mean = unit.deviation = unit.weights = torch::ones({2}, torch::kFloat64);
  const auto offset_of = [](const std::filesystem::path& folder) {
    const auto read = read_single_view_unit(ModelBundle::open(folder));
    return read ? read->offset : -1;
  };
  const BundleOptions options = ModelBundle::open(given.first).options();
  unit.offset = 1;
  write_single_view_unit(ModelBundle::open(given.first), unit);
  assemble_bundle(options, given.first, {given.stats}, given.folder.path() / "of_first");
  EXPECT_EQ(offset_of(given.folder.path() / "of_first"), 1);
  unit.offset = 2;
  write_single_view_unit(ModelBundle::open(given.stats), unit);
  assemble_bundle(options, given.first, {given.stats}, given.folder.path() / "of_stats");
  EXPECT_EQ(offset_of(given.folder.path() / "of_stats"), 2);
  // Of a head that none of them has seen there is none.
  const auto other_head = given.folder.path() / "other_head";
  write_random_bundle(other_head, options, 4);
  assemble_bundle(options, given.first, {given.stats, other_head}, given.folder.path() / "of_other_head");
  EXPECT_EQ(offset_of(given.folder.path() / "of_other_head"), -1);
  EXPECT_FALSE(std::filesystem::exists(given.folder.path() / "of_other_head" / kSingleViewUnitFile));
}

}  // namespace
}  // namespace gld
