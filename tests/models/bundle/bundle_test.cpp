#include "models/bundle/bundle.h"

#include "gld/base/atomic_file.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/inspection.h"
#include "models/bundle/random_bundle.h"
#include "models/decoders/dpt_head.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <string>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

// One small bundle for all tests; those that change something copy it.
class Bundles : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new test::TemporaryFolder;
    write_random_bundle(original(), small_bundle_options(), 7);
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }
  static std::filesystem::path original() { return folder_->path() / "bundle"; }
  std::filesystem::path copy() const {
    auto target = own_.path() / "copy";
    std::filesystem::copy(original(), target, std::filesystem::copy_options::recursive);
    return target;
  }

  static test::TemporaryFolder* folder_;
  test::TemporaryFolder own_;
};

test::TemporaryFolder* Bundles::folder_ = nullptr;

TEST_F(Bundles, AnImpossibleSetOfLevelsIsRefusedWhenItOpens) {
  const auto folder = copy();
  const auto yaml = folder / "model.yaml";
  std::string text = read_file(yaml);
  const std::string now = "boundary_level: 1";
  ASSERT_NE(text.find(now), std::string::npos);
  write_file_atomically(yaml, text.replace(text.find(now), now.size(), "boundary_level: 2"));
  EXPECT_EQ(
      error_of([&] { ModelBundle::open(folder); }),
      yaml.string() +
          ", generated: expected a part that generates boundary_level 2, which propagation starts from, "
          "found none in generated; add 2 to generated or change boundary_level.");
}

TEST_F(Bundles, StatisticsOfAnotherBackboneAreRefused) {
  const auto bundle = ModelBundle::open(copy());
  const auto file = bundle.file(BundlePart::statistics(1));
  save_safetensors(file, {{"mean", torch::zeros({64})}, {"var", torch::ones({64})}});
  EXPECT_EQ(error_of([&] { bundle.load_statistics(level_model(1)); }),
            file.string() +
                ": expected 128 channels, found 64; compute the statistics with this bundle's backbone.");
}

TEST_F(Bundles, EveryPartLoads) {
  const auto bundle = ModelBundle::open(original());
  EXPECT_EQ(bundle.options().backbone.level_channels(), 128);
  EXPECT_EQ(bundle.options().image_sizes().at(3).width, 504);
  EXPECT_EQ(bundle.options().image_sizes().at(3).height, 280);
  EXPECT_EQ(bundle.load_backbone()->architecture().blocks(), 12);
  EXPECT_EQ(bundle.options().geometry_head.as<DptHeadOptions>().features, 32);
  EXPECT_NE(bundle.load_geometry_head(), nullptr);
  EXPECT_EQ(bundle.load_rgb_decoder()->options().num_layers, 3);
  EXPECT_EQ(bundle.load_generator(cascade(1, 0))->options().conditioning, DitConditioning::kDeeperLevel);
  EXPECT_EQ(bundle.load_statistics(level_model(1)).patches.channels(), 128);
  const auto level1 = bundle.load_generator(level_model(1));
  const auto stored = WeightFile::open(bundle.file(BundlePart::of(level_model(1))));
  for (const auto& [name, tensor] : named_tensors(*level1)) {
    EXPECT_TRUE(tensor.equal(read_tensor(*stored, name))) << name;
    EXPECT_GT(tensor.to(torch::kFloat32).abs().max().item<float>(), 0) << name << " is zero";
  }
  ParameterPlacement half;
  half.dtype = torch::kBFloat16;
  EXPECT_EQ(named_tensors(*bundle.load_generator(level_model(1), half)).begin()->second.scalar_type(),
            torch::kBFloat16);
}

TEST_F(Bundles, TheSameSeedGivesTheSameBytes) {
  const auto again = own_.path() / "again", other = own_.path() / "other";
  write_random_bundle(again, small_bundle_options(), 7);
  write_random_bundle(other, small_bundle_options(), 8);
  const std::string hash = ModelBundle::open(original()).content_hash();
  EXPECT_EQ(hash.size(), 64U);
  EXPECT_EQ(ModelBundle::open(again).content_hash(), hash);
  EXPECT_NE(ModelBundle::open(other).content_hash(), hash);
}

TEST_F(Bundles, TheHashSeesOptionsAndWeights) {
  const auto folder = copy();
  const std::string hash = ModelBundle::open(folder).content_hash();
  auto tensors = read_all(ModelBundle::open(folder).file(BundlePart::of(level_model(1))));
  tensors.at("s_projector.bias")[0] += 1;
  save_bundle_part(folder, BundlePart::of(level_model(1)), tensors);
  const std::string changed = ModelBundle::open(folder).content_hash();
  EXPECT_NE(changed, hash);
  write_file_atomically(folder / "model.yaml", read_file(folder / "model.yaml") + "\n");
  EXPECT_NE(ModelBundle::open(folder).content_hash(), changed);
}

TEST_F(Bundles, PartsAreStoredInTheChosenPrecision) {
  const auto folder = copy();
  const auto tensors = named_tensors(*ModelBundle::open(folder).load_generator(level_model(1)));
  save_bundle_part(folder, BundlePart::of(level_model(1)), tensors, DType::kBFloat16);
  const auto bundle = ModelBundle::open(folder);
  EXPECT_EQ(WeightFile::open(bundle.file(BundlePart::of(level_model(1))))->entries().front().dtype,
            DType::kBFloat16);
  const auto loaded = named_tensors(*bundle.load_generator(level_model(1)));
  const auto& before = tensors.at("s_projector.weight");
  const auto& after = loaded.at("s_projector.weight");
  EXPECT_EQ(after.scalar_type(), torch::kFloat32);
  // bfloat16 keeps eight bits.
  EXPECT_LE((after - before).abs().max().item<float>(), before.abs().max().item<float>() / 256);
  // Only what is stored in another type is in memory as float32 numbers before it is packed.
  int64_t numbers = 0;
  for (const auto& [name, tensor] : tensors) numbers += tensor.is_floating_point() ? tensor.numel() : 0;
  EXPECT_EQ(bundle.converted_bytes(BundlePart::of(level_model(1))), 4 * numbers);
  EXPECT_EQ(bundle.converted_bytes(BundlePart::backbone()), 0);
}

TEST_F(Bundles, RefusesWhatIsNoBundle) {
  EXPECT_EQ(error_of([&] { ModelBundle::open(own_.path() / "nowhere"); }),
            (own_.path() / "nowhere").string() +
                ": expected a model bundle, a folder with model.yaml, found no such folder; make one with "
                "gld convert or gld train, or check the path.");
  EXPECT_EQ(error_of([&] { ModelBundle::open(own_.path()); }),
            own_.path().string() +
                ": expected a model bundle, a folder with model.yaml, found a folder without it; "
                "make one with gld convert or gld train, or check the path.");
}

TEST_F(Bundles, NamesAMissingPart) {
  const auto folder = copy();
  std::filesystem::remove(folder / "cascade.safetensors");
  const auto bundle = ModelBundle::open(folder);
  EXPECT_FALSE(bundle.has(BundlePart::of(cascade(1, 0))));
  EXPECT_EQ(error_of([&] { bundle.load_generator(cascade(1, 0)); }),
            folder.string() +
                ": expected a file cascade.safetensors, found none; add the part with gld convert or gld "
                "train.");
}

TEST_F(Bundles, RefusesOtherOptionsForExistingWeights) {
  const auto folder = copy();
  auto options = small_bundle_options();
  save_bundle_options(folder, options);
  options.generator(level_model(1)).dit.depth = {4, 2};
  EXPECT_EQ(error_of([&] { save_bundle_options(folder, options); }),
            (folder / "model.yaml").string() +
                ": expected the options that the bundle is written with, found others; "
                "choose another folder or delete this bundle.");
}

TEST_F(Bundles, PartsMustFitEachOther) {
  struct Mismatch {
    void (*change)(BundleOptions&);
    const char* sentence;
  };
  const std::vector<Mismatch> mismatches = {
      {[](BundleOptions& options) { options.generator(level_model(1)).dit.in_channels = 96; },
       "level1.in_channels: expected 128, the channels of the backbone's levels, found 96; change one of "
       "them."},
      {[](BundleOptions& options) { options.rgb_decoder.in_channels = 128; },
       "rgb_decoder.in_channels: expected 512, the channels of all levels together, found 128; change one of "
       "them."},
      {[](BundleOptions& options) { options.generator(cascade(1, 0)).dit.camera_patch_size = 16; },
       "cascade.camera_patch_size: expected 14, the backbone's patch size, found 16; change one of them."},
      {[](BundleOptions& options) {
         options.generator(cascade(1, 0)).dit.conditioning = DitConditioning::kNone;
       },
       "cascade.conditioning: expected deeper_level, found none; set it to deeper_level."},
      {[](BundleOptions& options) {
         options.geometry_head = GeometryHeadOptions::none();
         options.generator(level_model(1)).dit.warped_sources = 2;
       },
       "warped_sources: expected 0 for a model without a geometry head, whose depth carries the photographs, found 2; "
       "set it to 0, or give the model a dpt_head."},
      {[](BundleOptions& options) {
         options.geometry_head = GeometryHeadOptions::none();
         options.depth_refinement.channels = {24, 32};
       },
       "depth_refinement.channels: expected none for a model without a geometry head, whose depth carries the "
       "photographs, found 2 numbers; leave them out, or give the model a dpt_head."},
      {[](BundleOptions& options) { options.boundary_level = 4; },
       "boundary_level: expected a level below 4, found 4; choose one of the backbone's levels."},
      {[](BundleOptions& options) { options.trained_sizes = {}; },
       "trained_sizes: expected at least one size, found none; write for example trained_sizes: [504x280]."},
      {[](BundleOptions& options) { options.trained_sizes = {"504x281"}; },
       "trained_sizes: expected sides that are multiples of 14, found 504x281; choose whole patches."},
      {[](BundleOptions& options) { options.trained_sizes = {"504 x 280"}; },
       "trained_sizes: expected WIDTHxHEIGHT in pixels, sides from 1 to 65536, found '504 x 280'; write for example 504x280."},
      {[](BundleOptions& options) { options.trained_sizes = {"-504x280"}; },
       "trained_sizes: expected WIDTHxHEIGHT in pixels, sides from 1 to 65536, found '-504x280'; write for example 504x280."},
  };
  for (const auto& mismatch : mismatches) {
    auto options = small_bundle_options();
    mismatch.change(options);
    EXPECT_EQ(error_of([&] { options.check(); }), mismatch.sentence);
  }
}

TEST_F(Bundles, InspectionCountsAndChecks) {
  const auto inspection = inspect(original());
  EXPECT_EQ(inspection["parts"].size(), 7U);
  EXPECT_EQ(inspection["missing"].size(), 0U);
  EXPECT_EQ(inspection["hash"], ModelBundle::open(original()).content_hash());
  int64_t elements = 0;
  for (const auto& part : inspection["parts"]) elements += part["totals"]["elements"].get<int64_t>();
  EXPECT_EQ(inspection["totals"]["elements"], elements);
  EXPECT_EQ(inspection["totals"]["bytes"], 4 * elements);
  EXPECT_EQ(inspection["options"]["backbone"]["embed_dim"], 64);
  const std::string text = inspection_text(inspection);
  EXPECT_NE(text.find("statistics_level0  2 tensors, 256 elements, 1.0 KiB (256 float32)\n"),
            std::string::npos)
      << text;

  const auto folder = copy();
  save_bundle_part(folder, BundlePart::geometry_head(), {{"norm.weight", torch::zeros({3})}});
  EXPECT_NE(error_of([&] { inspect(folder); }).find("check that the configuration belongs to these weights"),
            std::string::npos);
}

TEST_F(Bundles, InspectionOfAFile) {
  const auto file = own_.path() / "w.safetensors";
  save_safetensors(file, {{"b", torch::zeros({2, 3})}, {"a.long", torch::zeros({}, torch::kInt64)}},
                   {{"by", "me"}});
  const auto inspection = inspect(file);
  EXPECT_EQ(inspection["tensors"][1]["name"], "b");
  EXPECT_EQ(inspection["tensors"][1]["shape"], (std::vector<int64_t>{2, 3}));
  EXPECT_EQ(inspection_text(inspection), file.string() +
                                             " (safetensors)\n"
                                             "  a.long  int64     ()\n"
                                             "  b       float32   (2, 3)\n"
                                             "  metadata by = me\n"
                                             "2 tensors, 7 elements, 32 B (6 float32, 1 int64)\n");
  const auto stats = inspect(test::test_data() / "stats/da3/normalization_stats_level1.pt");
  EXPECT_EQ(stats["values"]["count"], 179568640);
  EXPECT_EQ(stats["format"], "PyTorch zip");
}

// Ours is in metres, and a guess: other scenes have none, and what two sources tell is better.
TEST(BundleOptions, TheUnitOfASingleSourceIsThatOfScenesInMetres) {
  BundleOptions options;
  options.single_source_unit = 3;
  Views views;
  views.cameras.resize(3);
  views.num_sources = 1;
  EXPECT_EQ(options.unit_of_single_source(views, /*metric=*/true), 3);
  EXPECT_EQ(options.unit_of_single_source(views, /*metric=*/false), 0);
  views.num_sources = 2;
  EXPECT_EQ(options.unit_of_single_source(views, /*metric=*/true), 0);
  views.num_sources = 1;
  options.geometry_head = GeometryHeadOptions::none();
  EXPECT_EQ(options.unit_of_single_source(views, /*metric=*/true), 0);
  options = BundleOptions();
  options.single_source_unit_deviation = 0.2;
  EXPECT_EQ(
      test::error_of([&] { options.check(); }),
      "single_source_unit_deviation: expected 0 without single_source_unit, whose error it is, found 0.2; give "
      "both, as gld stats does.");
}

}  // namespace
}  // namespace gld
