#include "gld/base/atomic_file.h"
#include "models/bundle/part_lineage.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/train/small_training.h"
#include "train/loop/metrics_log.h"
#include "train/stages/sample_refiner_stage.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using testing::HasSubstr;

class SampleRefinerStage : public testing::Test {
 protected:
  SampleRefinerStage() {
    BundleOptions model = test::small_model();
    model.refiner.degraded = DegradedLatents::kGenerated;
    model.refiner.channels = {32, 32};
    model.refiner.heads = {2, 2};
    model.refiner.norm_groups = 8;
    model.refiner.latent_channels = 2 * model.backbone.level_channels();
    model.refiner.attention = ViewAttention::kCross;
    model.refiner.references = 2;
    write_random_bundle(path("model"), model, 3, DType::kFloat32);
  }
  std::filesystem::path path(const std::string& name) const { return folder_.path() / name; }
  TrainSampleRefinerOptions options(const std::string& out) const {
    auto options = test::training_options<TrainSampleRefinerOptions>(path("model"), path(out));
    options.objective.least_evaluations = options.objective.validation_evaluations = 2;
    options.objective.most_evaluations = 3;
    return options;
  }
  std::vector<std::pair<double, double>> series(const std::string& run, const std::string& key) const {
    return MetricsLog(path(run) / "metrics.jsonl", 1000).series(key);
  }
  test::TemporaryFolder folder_;
};

// The generators' weights are random: what they make is far from the truth, and the network finds much to mend.
TEST_F(SampleRefinerStage, BringsSamplesOfFewEvaluationsNearerToTheTruth) {
  auto training = options("run");
  training.loop.steps = training.loop.validate_every = training.loop.checkpoint_every = 200;
  training.loop.learning_rate.peak = 3e-3;
  training.loop.learning_rate.warmup_steps = 0;
  training.loop.optimiser.ema_decay = 0.5;
  train_sample_refiner(training, {});
  const double sampled = series("run", "validation_sampled_latent_error").back().second;
  const double refined = series("run", "validation_refined_latent_error").back().second;
  EXPECT_GT(sampled, 0.5);
  EXPECT_LT(refined, 0.8 * sampled);
  for (const char* of : {"sampled", "refined", "usual"}) {
    for (const char* what : {"_psnr", "_sharpness"}) {
      EXPECT_TRUE(std::isfinite(series("run", std::string("validation_") + of + what).back().second))
          << of << what;
    }
  }
  const auto trained = ModelBundle::open(path("run/model"));
  EXPECT_TRUE(trained.has(BundlePart::refiner()));
  EXPECT_TRUE(mixed_parts(trained, {BundlePart::refiner()}, /*allow_mixed=*/false).empty());
}

TEST_F(SampleRefinerStage, BeginsWithTheSampleAsItIs) {
  train_sample_refiner(options("run"), {});
  // The last layer is 0 at first; the two are summed in another order.
  EXPECT_NEAR(series("run", "latent").front().second, series("run", "sampled").front().second, 1e-5);
}

TEST_F(SampleRefinerStage, GoesOnWithTheSameBits) {
  auto whole = options("whole");
  whole.loop.steps = 4;
  train_sample_refiner(whole, {});
  auto parts = whole;
  parts.out = path("parts").string();
  parts.loop.steps = 2;
  train_sample_refiner(parts, {});
  parts.loop.steps = 4;
  parts.resume = true;
  train_sample_refiner(parts, {});
  EXPECT_EQ(read_file(path("whole/model/refiner.safetensors")),
            read_file(path("parts/model/refiner.safetensors")));
}

TEST_F(SampleRefinerStage, KnowsWhichGeneratorsItLearntOn) {
  train_sample_refiner(options("run"), {});
  write_random_bundle(path("others"), ModelBundle::open(path("run/model")).options(), 4, DType::kFloat32);
  std::filesystem::copy_file(path("others/level1.safetensors"), path("run/model/level1.safetensors"),
                             std::filesystem::copy_options::overwrite_existing);
  EXPECT_THAT(error_of([&] {
                mixed_parts(ModelBundle::open(path("run/model")), {BundlePart::refiner()},
                            /*allow_mixed=*/false);
              }),
              HasSubstr("level1"));
}

TEST_F(SampleRefinerStage, SaysWhatIsWrongWithItsOptions) {
  auto training = options("run");
  training.objective.most_evaluations = 1;
  EXPECT_EQ(
      error_of([&] { training.check(); }),
      "objective.most_evaluations: expected at least objective.least_evaluations, 2, found 1; raise it.");
  save_bundle_options(path("without"), test::small_model());
  training = options("run");
  training.model = path("without").string();
  EXPECT_EQ(error_of([&] { train_sample_refiner(training, {}); }),
            path("without").string() +
                "/model.yaml: expected a refiner of samples, found none; add for example refiner: {degraded: "
                "generated, channels: [128, 192], heads: [4, 6], latent_channels: 128, attention: cross}.");
}

}  // namespace
}  // namespace gld
