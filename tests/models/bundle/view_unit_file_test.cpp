#include "models/bundle/view_unit_file.h"

#include "gld/tensors/weight_tensors.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

SingleViewUnit some_unit() {
  SingleViewUnit unit;
  unit.mean = torch::tensor({1.0, 2.0}, torch::kFloat64);
  unit.deviation = torch::tensor({0.5, 0.25}, torch::kFloat64);
  unit.weights = torch::tensor({0.1, -0.2}, torch::kFloat64);
  unit.offset = 1.2;
  unit.least = 0.9;
  unit.largest = 1.5;
  unit.log_deviation = 0.09;
  return unit;
}

TEST(ViewUnitFile, BelongsToItsBackboneAndHead) {
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path(), small_bundle_options(), 3);
  const auto bundle = ModelBundle::open(folder.path());
  EXPECT_EQ(read_single_view_unit(bundle), nullptr);
  EXPECT_EQ(bundle.load_geometry_head()->single_view_unit(), nullptr);
  const std::string hash = bundle.content_hash();
  write_single_view_unit(bundle, some_unit());
  EXPECT_NE(bundle.content_hash(), hash);  // other pictures come of one source
  const auto read = read_single_view_unit(bundle);
  ASSERT_NE(read, nullptr);
  EXPECT_TRUE(torch::equal(read->mean, some_unit().mean));
  EXPECT_TRUE(torch::equal(read->deviation, some_unit().deviation));
  EXPECT_TRUE(torch::equal(read->weights, some_unit().weights));
  EXPECT_EQ(read->offset, 1.2);
  EXPECT_EQ(read->least, 0.9);
  EXPECT_EQ(read->largest, 1.5);
  EXPECT_EQ(read->log_deviation, 0.09);
  ASSERT_NE(bundle.load_geometry_head()->single_view_unit(), nullptr);

  // Of another head it says nothing.
  auto tensors = read_all(bundle.file(BundlePart::geometry_head()));
  tensors.begin()->second = tensors.begin()->second + 1;
  save_safetensors(bundle.file(BundlePart::geometry_head()), tensors);
  EXPECT_EQ(read_single_view_unit(bundle), nullptr);
}

TEST(ViewUnitFile, DamagedOnesAreRefused) {
  const test::TemporaryFolder folder;
  write_random_bundle(folder.path(), small_bundle_options(), 3);
  const auto bundle = ModelBundle::open(folder.path());
  const auto file = folder.path() / kSingleViewUnitFile;
  const auto refusal = [&] { return test::error_of([&] { read_single_view_unit(bundle); }); };
  save_safetensors(file, {{"mean", torch::zeros({2})}});
  EXPECT_EQ(refusal(),
            file.string() +
                ": expected gld single view unit 1, found no format; remove it, or make it anew with "
                "gld stats.");
  SingleViewUnit unit = some_unit();
  unit.weights = torch::zeros({3}, torch::kFloat64);
  write_single_view_unit(bundle, unit);
  const std::string other_numbers =
      file.string() +
      ": expected vectors of finite 64-bit numbers, as many weights as features, found others; remove it, or "
      "make it anew with gld stats.";
  EXPECT_EQ(refusal(), other_numbers);
  unit = some_unit();
  unit.mean = unit.mean.to(torch::kFloat32);
  write_single_view_unit(bundle, unit);
  EXPECT_EQ(refusal(), other_numbers);
  unit = some_unit();
  unit.largest = std::numeric_limits<double>::infinity();
  write_single_view_unit(bundle, unit);
  EXPECT_EQ(refusal(), other_numbers);
}

}  // namespace
}  // namespace gld
