#include "infer/bench/sample_benchmark.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "gld/tensors/weight_tensors.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <sstream>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

using Rows = std::vector<std::map<std::string, std::string>>;

std::vector<std::string> cells(const std::string& line) {
  std::vector<std::string> result(1);
  bool quoted = false;
  for (const char c : line) {
    if (c == '"') {
      quoted = !quoted;
    } else if (c == ',' && !quoted) {
      result.emplace_back();
    } else {
      result.back() += c;
    }
  }
  return result;
}

Rows read_rows(const std::filesystem::path& file) {
  std::istringstream text(read_file(file));
  std::string line;
  std::getline(text, line);
  const auto names = cells(line);
  Rows rows;
  while (std::getline(text, line)) {
    const auto values = cells(line);
    EXPECT_EQ(values.size(), names.size());
    rows.emplace_back();
    for (size_t i = 0; i < values.size(); ++i) rows.back()[names[i]] = values[i];
  }
  return rows;
}

// Of the first row with these cells and this count; NaN without one.
double number(const Rows& rows, const std::map<std::string, std::string>& wanted, int count,
              const std::string& column) {
  for (const auto& row : rows) {
    const bool matches = std::all_of(wanted.begin(), wanted.end(),
                                     [&](const auto& cell) { return row.at(cell.first) == cell.second; });
    if (matches && row.at("count") == std::to_string(count)) return std::stod(row.at(column));
  }
  return std::numeric_limits<double>::quiet_NaN();
}

// A small random model on a real scene: every variant has a row, errors refer to the converged solve of the same noise,
// and they fall with the evaluations.
TEST(SampleBenchmark, MeasuresEveryVariantAgainstTheReference) {
  const test::TemporaryFolder folder;
  const auto bundle = folder.path() / "bundle";
  write_random_bundle(bundle, small_bundle_options(), 5);
  SampleBenchmarkOptions options;
  options.model = bundle.string();
  options.scenes = {(test::test_data() / "scenes" / "gld_layout_5e040cd0758dcc96").string()};
  options.views.sources = {0, 7};
  options.views.targets = {3};
  options.size = "56x56";
  options.counts = {4, 32};
  options.guidance_scales = {1.5};
  options.reference_tolerance = 1e-4;
  options.threads = 1;
  options.out = (folder.path() / "run").string();
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_sample_benchmark(options), 0);
  const auto text = testing::internal::GetCapturedStdout();
  EXPECT_THAT(text, testing::HasSubstr("reference"));
  const std::filesystem::path run = options.out;
  for (const char* name :
       {"config.yaml", "sample.csv", "sample.md", "sample.svg", "sample.png", "report.json"}) {
    EXPECT_TRUE(std::filesystem::exists(run / name)) << name;
  }
  const Rows rows = read_rows(run / "sample.csv");
  EXPECT_EQ(rows.size(), 15u);  // the reference, and seven variants at two counts
  const auto level0_error = [&](const std::string& solver, const std::string& schedule, int count) {
    return number(rows, {{"solver", solver}, {"schedule", schedule}, {"guidance", "everywhere"}}, count,
                  "level0_error");
  };
  const double few = level0_error("unipc3", "logsnr", 4), many = level0_error("unipc3", "logsnr", 32);
  EXPECT_LT(many, 0.01);
  EXPECT_LT(many, few / 5);
  EXPECT_LT(many, level0_error("euler", "published", 32));
  // Something is fastest, something is nearest, and without weights there is no LPIPS.
  int64_t on_front = 0;
  for (const auto& row : rows) {
    if (row.at("pareto").find("error") == 0) ++on_front;
    EXPECT_EQ(row.at("lpips"), "");
  }
  EXPECT_GE(on_front, 1);
  EXPECT_EQ(rows[0].at("solver"), "reference");
  EXPECT_EQ(rows[0].at("pareto"), "");
}

// Random weights in the two files that LPIPS comes in.
void write_random_lpips(const std::filesystem::path& folder) {
  LpipsOptions options;
  options.net = LpipsNet::kSqueeze;
  const Lpips lpips(options, ParameterPlacement{});
  std::map<std::string, torch::Tensor> backbone, heads;
  torch::manual_seed(3);
  for (const auto& parameter : lpips.named_parameters()) {
    const bool head = parameter.key().rfind("lin", 0) == 0;
    (head ? heads : backbone)[parameter.key()] = torch::rand(parameter.value().sizes());
  }
  save_safetensors(folder / "backbone.safetensors", backbone);
  save_safetensors(folder / "heads.safetensors", heads);
}

TEST(SampleBenchmark, SamplesGeneratedScenesAndMeasuresLpips) {
  const test::TemporaryFolder folder;
  const auto bundle = folder.path() / "bundle";
  auto model = small_bundle_options();
  model.trained_sizes = {"56x56"};
  write_random_bundle(bundle, model, 5);
  write_random_lpips(folder.path());
  SampleBenchmarkOptions options;
  options.model = bundle.string();
  options.synthetic = 2;
  options.counts = {2};
  options.guidance_scales = {1};
  options.reference_tolerance = 0.01;
  options.lpips.lpips_backbone = (folder.path() / "backbone.safetensors").string();
  options.lpips.lpips_heads = (folder.path() / "heads.safetensors").string();
  options.lpips.lpips.net = LpipsNet::kSqueeze;
  options.threads = 1;
  options.out = (folder.path() / "run").string();
  check_options(options, "test");
  testing::internal::CaptureStdout();
  EXPECT_EQ(run_sample_benchmark(options), 0);
  testing::internal::GetCapturedStdout();
  const Rows rows = read_rows(std::filesystem::path(options.out) / "sample.csv");
  ASSERT_EQ(rows.size(), 12u);  // two scenes, the reference and five variants
  EXPECT_NE(rows[0].at("scene"), rows[6].at("scene"));
  for (const auto& row : rows) {
    EXPECT_GT(std::stod(row.at("lpips")), 0);
    EXPECT_GT(std::stod(row.at("psnr")), 0);
    EXPECT_GT(std::stod(row.at("sharpness")), 0);
  }
}

TEST(SampleBenchmark, MeansAreOverScenesOfEqualVariants) {
  SampleRow one;
  one.scene = "a";
  one.solver = "euler";
  one.schedule = "logsnr";
  one.guidance = "everywhere";
  one.count = 6;
  one.evaluations = 12;
  one.quality["ssim"] = 0.25;  // and no psnr
  one.seconds = 1;
  one.shallowest_error = 0.1;
  one.peak_bytes = 5;
  SampleRow two = one;
  two.scene = "b";
  two.shallowest_error = 0.3;
  two.quality["ssim"] = 0.75;
  two.peak_bytes = 7;
  SampleRow other = one;
  other.count = 12;
  other.evaluations = 24;
  other.seconds = 2;
  const auto means = mean_over_scenes({one, two, other});
  ASSERT_EQ(means.size(), 2u);
  EXPECT_DOUBLE_EQ(means[0].shallowest_error, 0.2);
  EXPECT_DOUBLE_EQ(means[0].quality_of("ssim"), 0.5);
  EXPECT_TRUE(std::isnan(means[0].quality_of("psnr")));
  EXPECT_EQ(means[0].evaluations, 12);
  EXPECT_EQ(means[0].peak_bytes, 7);
  EXPECT_EQ(means[1].evaluations, 24);
  // The slower one is nearer; neither has a truth.
  for (const auto& mean : means) {
    EXPECT_TRUE(mean.on_error_front);
    EXPECT_FALSE(mean.on_quality_front);
  }
  EXPECT_EQ(means[0].variant(), "euler, logsnr");
}

TEST(SampleBenchmark, FrontsAreOfOneSceneAndScale) {
  const auto row = [](const std::string& scene, double seconds, double error, double quality) {
    SampleRow made;
    made.scene = scene;
    made.count = 1;
    made.seconds = seconds;
    made.shallowest_error = error;
    made.quality["psnr"] = quality;
    return made;
  };
  std::vector<SampleRow> rows{row("a", 1, 0.5, 20), row("a", 2, 0.4, 19), row("a", 3, 0.45, 21),
                              row("b", 9, 0.9, 10), row("a", 0.1, 0.01, 50)};
  rows[4].count = 0;  // the reference
  mark_pareto_fronts(rows);
  const std::vector<bool> error{true, true, false, true, false}, quality{true, false, true, true, false};
  for (size_t i = 0; i < rows.size(); ++i) {
    EXPECT_EQ(rows[i].on_error_front, error[i]) << i;
    EXPECT_EQ(rows[i].on_quality_front, quality[i]) << i;
  }
}

TEST(SampleBenchmark, RefusesToRunWithoutAScene) {
  SampleBenchmarkOptions options;
  EXPECT_EQ(error_of([&] { options.check(); }),
            "--scenes, --synthetic: expected either folders of scenes or a number of generated scenes, found "
            "neither; add for example --synthetic 4.");
  options.synthetic = 4;
  options.lpips.lpips_heads = "heads.pth";
  EXPECT_EQ(error_of([&] { options.check(); }),
            "--lpips-backbone, --lpips-heads: expected both files, or neither, found only the heads; "
            "give both files.");
}

}  // namespace
}  // namespace gld
