#include "ablate/configuration/ablation.h"

#include "gld/base/atomic_file.h"
#include "gld/base/configuration.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>

#include <gtest/gtest.h>

namespace gld {
namespace {

const char* const kSources = R"(title: sources
seeds: [3, 4]
stages:
  train: {command: train level, options: {level: 1, loop: {steps: 10}}}
  eval: {command: eval, options: {synthetic: 64}}
metrics:
  psnr: {column: sample_psnr}
  seconds: {better: lower, unit: s}
variants:
  one: {options: {eval: {views: {most_sources: 1}}}, columns: {psnr: mean_prediction_psnr}, rows: {solver: euler}}
  two: {label: two sources}
claims:
  more: {metric: psnr, better: two, worse: one, paper: +1 dB}
smoke:
  eval: {synthetic: 2}
)";

struct Described {
  test::TemporaryFolder folder;
  AblateOptions options;

  Ablation read(const std::string& text) {
    const auto file = folder.path() / "a.yaml";
    write_file_atomically(file, text);
    options.out = "run";
    read_ablate_options(file, options);
    check_options(options, "gld ablate");
    return read_ablation(file, options);
  }
  // The error is that of the same text with a line put in the place of another; it is without the folder, which has
  // another name each time.
  std::string error(const std::string& before, const std::string& after) {
    std::string text = kSources;
    const size_t at = text.find(before);
    EXPECT_NE(at, std::string::npos) << before;
    text.replace(at, before.size(), after);
    std::string message = test::error_of([&] { read(text); });
    const std::string path = folder.path().string() + "/";
    for (size_t found = message.find(path); found != std::string::npos; found = message.find(path)) {
      message.erase(found, path.size());
    }
    return message;
  }
};

std::vector<std::string> settings_text(const Ablation& ablation, const std::string& variant,
                                       const std::string& stage) {
  std::vector<std::string> text;
  for (const auto& setting : ablation.settings_of(*ablation.variant(variant), ablation.stage(stage))) {
    text.push_back(setting.key + "=" + setting.value);
  }
  return text;
}

TEST(Ablation, IsReadWithEverythingItSays) {
  Described described;
  const Ablation ablation = described.read(kSources);
  EXPECT_EQ(ablation.title, "sources");
  EXPECT_EQ(ablation.options.seeds, (std::vector<int64_t>{3, 4}));
  ASSERT_EQ(ablation.stages.size(), 2U);
  EXPECT_EQ(ablation.stages[0].command, "train level");
  EXPECT_EQ(settings_text(ablation, "two", "train"), (std::vector<std::string>{"level=1", "loop.steps=10"}));
  EXPECT_EQ(settings_text(ablation, "one", "eval"),
            (std::vector<std::string>{"synthetic=64", "views.most_sources=1"}));
  EXPECT_EQ(ablation.variant("one")->columns.at("psnr"), "mean_prediction_psnr");
  EXPECT_EQ(ablation.variant("one")->rows.at("solver"), "euler");
  EXPECT_EQ(ablation.variant("two")->label, "two sources");
  EXPECT_EQ(ablation.metric("psnr").direction(), Better::kHigher);  // what gld/metrics says
  EXPECT_EQ(ablation.metric("psnr").unit, "dB");
  EXPECT_EQ(ablation.metric("seconds").direction(), Better::kLower);
  EXPECT_EQ(ablation.metric("seconds").column, "seconds");
  EXPECT_EQ(ablation.claims.at(0).paper, "+1 dB");
}

TEST(Ablation, SmokeSettingsAndOverridesStandAboveTheRest) {
  Described described;
  described.options.smoke = true;
  described.options.overrides = {"eval.synthetic=5", "eval.views.views=3"};
  const Ablation ablation = described.read(kSources);
  EXPECT_EQ(settings_text(ablation, "two", "eval"),
            (std::vector<std::string>{"synthetic=64", "synthetic=2", "synthetic=5", "views.views=3"}));
  EXPECT_EQ(ablation.options.seeds, (std::vector<int64_t>{3}));
}

// Columns of gld eval by metrics that the program knows: direction and unit need not be said.
TEST(Ablation, KnowsTheMetricsOfEnergyScores) {
  Described described;
  std::string text = kSources;
  const std::string known = "  seconds: {better: lower, unit: s}";
  text.replace(text.find(known), known.size(),
               known +
                   "\n  energy_score: {column: sample_energy_score}\n"
                   "  energy_score_features_unseen: {column: sample_energy_score_features_unseen}");
  const Ablation ablation = described.read(text);
  EXPECT_EQ(ablation.metric("energy_score").direction(), Better::kLower);
  EXPECT_EQ(ablation.metric("energy_score").column, "sample_energy_score");
  EXPECT_EQ(ablation.metric("energy_score_features_unseen").direction(), Better::kLower);
}

TEST(Ablation, OnlySomeVariantsAreKeptAndClaimsOfTheOthersStay) {
  Described described;
  described.options.only = {"two"};
  const Ablation ablation = described.read(kSources);
  EXPECT_EQ(ablation.variants.size(), 1U);
  EXPECT_EQ(ablation.variant("one"), nullptr);
  EXPECT_EQ(ablation.claims.size(), 1U);
  described.options.only = {"tow"};
  EXPECT_EQ(described.error("title", "title"),
            "--only: expected a variant of this ablation, found 'tow'; did you mean 'two'?");
}

TEST(Ablation, ErrorsNameLineAndSection) {
  EXPECT_EQ(Described().error("command: eval", "comand: eval"),
            "a.yaml:5, stage 'eval', key 'comand': expected a known key, found an unknown one; did you mean "
            "'command'?");
  EXPECT_EQ(Described().error("variants:", "varants:"),
            "a.yaml:9, key 'varants': expected a known key, found an unknown one; did you mean "
            "'variants'?");
  EXPECT_EQ(Described().error("title: sources\n", ""),
            "a.yaml: expected a section title, found none; see docs/ABLATIONS.md.");
  EXPECT_EQ(
      Described().error("{options: {eval: {views", "{options: {evl: {views"),
      "a.yaml, variant 'one', options: expected a stage of this ablation, found 'evl'; did you mean 'eval'?");
  EXPECT_EQ(
      Described().error("metric: psnr", "metric: psr"),
      "a.yaml, claim 'more', key 'metric': expected a metric of this ablation, found 'psr'; did you mean 'psnr'?");
  EXPECT_EQ(Described().error("worse: one", "worse: two"),
            "a.yaml, claim 'more': expected two variants, found 'two' twice; compare it with another one.");
  EXPECT_EQ(
      Described().error("worse: one", "worse: one, beyond: [one]"),
      "a.yaml, claim 'more', key 'beyond': expected two different variants, [BETTER, WORSE], found 1 names; name "
      "those whose margin is the smaller one.");
  EXPECT_EQ(
      Described().error("worse: one", "worse: one, beyond: [one, one]"),
      "a.yaml, claim 'more', key 'beyond': expected two different variants, [BETTER, WORSE], found 'one' twice; "
      "name those whose margin is the smaller one.");
  EXPECT_EQ(
      Described().error("worse: one", "worse: one, beyond: [two, one]"),
      "a.yaml, claim 'more', key 'beyond': expected another margin than the claim's own, found the same two "
      "variants; name those whose margin is the smaller one.");
  EXPECT_EQ(
      Described().error("worse: one", "worse: one, beyond: [one, tow]"),
      "a.yaml, claim 'more', key 'beyond': expected a variant of this ablation, found 'tow'; did you mean "
      "'two'?");
  EXPECT_EQ(
      Described().error("better: lower, unit: s", "unit: s"),
      "a.yaml, metric 'seconds', key 'better': expected higher, lower or near 1, found nothing, and it is no column "
      "that gld knows; add it, for example 'seconds: {better: higher}'.");
  EXPECT_EQ(Described().error("  one:", "  One:"),
            "a.yaml:10: expected a name of small letters, digits and underscores, found 'One'; rename it.");
  EXPECT_EQ(
      Described().error("{command: eval", "{command: eval, model: later"),
      "a.yaml, stage 'eval', key 'model': expected a stage that stands before it, found 'later'; choose among "
      "train.");
  EXPECT_EQ(
      Described().error("{command: eval", "{command: eval, parts: [train]"),
      "a.yaml, stage 'eval', key 'parts': expected a stage with command: assemble, found 'eval'; remove parts, or put "
      "the parts together in a stage of its own.");
  EXPECT_EQ(Described().error("seeds: [3, 4]", "seeds: [3, 3]"),
            "--seeds: expected every seed once, found one a second time; remove one of the two.");
  EXPECT_EQ(Described().error("stages:", "stages: []\nsteps:"),
            "a.yaml:4, key 'steps': expected a known key, found an unknown one; did you mean 'seeds'?");
  EXPECT_EQ(
      Described().error("{options: {eval: {views", "{choices: {eval: {views"),
      "a.yaml:10, variant 'one', key 'choices': expected a known key, found an unknown one; choose among options, rows, "
      "columns, label, model, stages, result, series, x.");
  EXPECT_EQ(
      Described().error(", worse: one", ""),
      "a.yaml, claim 'more', key 'worse': expected a variant of this ablation, found nothing; choose among one, two.");
}

TEST(Ablation, OverridesHaveToNameAStageAndAnOption) {
  Described described;
  described.options.overrides = {"eval=5"};
  EXPECT_EQ(
      described.error("title", "title"),
      "--overrides: expected STAGE.KEY=VALUE, found 'eval=5'; write for example --overrides eval.synthetic=16.");
  described.options.overrides = {"evil.synthetic=5"};
  EXPECT_EQ(described.error("title", "title"),
            "--overrides: expected a stage of this ablation, found 'evil'; did you mean 'eval'?");
}

TEST(Gain, IsPositiveForTheBetter) {
  EXPECT_DOUBLE_EQ(gain(Better::kHigher, 3, 1), 2);
  EXPECT_DOUBLE_EQ(gain(Better::kLower, 3, 1), -2);
  EXPECT_DOUBLE_EQ(gain(Better::kNearOne, 1.25, 0.5), 0.25);
}

// Those of the tree are read without an error.
TEST(Ablation, DescriptionsOfTheTreeAreWhole) {
  int64_t count = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(test::source_root() / "configs/ablations")) {
    const auto folder = entry.path().parent_path().filename();
    if (entry.path().extension() != ".yaml" || (folder != "ablations" && folder != "paper")) continue;
    AblateOptions options;
    options.out = "run";
    EXPECT_NO_THROW({
      read_ablate_options(entry.path(), options);
      read_ablation(entry.path(), options);
    }) << entry.path();
    ++count;
  }
  EXPECT_GE(count, 9);
}

}  // namespace
}  // namespace gld
