#include "ablate/plan/stage_plan.h"

#include "ablate/plan/stage_cache.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "models/bundle/bundle.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

struct LoopOptions : OptionsGroup {
  int64_t seed = 5;
  int64_t steps = 100;
  void visit(FieldVisitor& visitor) override {
    visitor.integer({"seed", "random numbers"}, seed, {0});
    visitor.integer({"steps", "how many"}, steps, {1, 1000});
  }
};

// Of commands that look like those of the program.
struct SmallOptions : OptionsGroup {
  bool train = false;
  std::string model, out, scene;
  bool overwrite = false, resume = false;
  int64_t threads = 0, seed = 0, rooms = 4;
  LoopOptions loop;
  void visit(FieldVisitor& visitor) override {
    visitor.text({"model", "bundle"}, model);
    visit_out(visitor, out, overwrite);
    visit_threads(visitor, threads);
    visitor.text({"scene", "folder"}, scene);
    visitor.integer({"rooms", "how many"}, rooms, {1, 100});
    if (train) {
      visitor.boolean({"resume", "go on"}, resume);
      visitor.group({"loop", "training"}, loop);
    } else {
      visit_seed(visitor, seed, "noise");
    }
  }
};

ProgramCommands small_commands() {
  ProgramCommands commands;
  commands.program = "/bin/false";
  commands.version = "gld 1";
  commands.names = {"train level", "eval"};
  commands.options = [](const std::string& name) -> std::shared_ptr<OptionsGroup> {
    auto options = std::make_shared<SmallOptions>();
    options->train = name == "train level";
    if (name != "train level" && name != "eval") return nullptr;
    return options;
  };
  return commands;
}

class StagePlan : public testing::Test {
 protected:
  StagePlan() { write_random_bundle(folder_.path() / "model", small_bundle_options(), 1); }

  Ablation read(const std::string& stages_and_variants) {
    const auto file = folder_.path() / "a.yaml";
    write_file_atomically(file, "title: t\nmetrics: {psnr: {}}\n" + stages_and_variants);
    options_.out = "run";
    options_.model = (folder_.path() / "model").string();
    return read_ablation(file, options_);
  }
  AblationPlan plan(const std::string& text) { return plan_ablation(read(text), small_commands()); }
  std::string error(const std::string& text) {
    std::string message = test::error_of([&] { plan(text); });
    const std::string path = folder_.path().string() + "/";
    if (message.rfind(path, 0) == 0) message.erase(0, path.size());
    return message;
  }

  test::TemporaryFolder folder_;
  AblateOptions options_;
};

const char* const kTwoStages = R"(stages:
  train: {command: train level, options: {loop: {steps: 10}}}
  eval: {command: eval}
)";

std::vector<std::string> stages_of(const AblationPlan& plan) {
  std::vector<std::string> stages;
  for (const StageTask& task : plan.tasks) stages.push_back(task.stage);
  return stages;
}

// Hours of stages would end at the first that encodes a picture.
TEST_F(StagePlan, RefusesAModelWithoutABackbone) {
  const auto model = folder_.path() / "model";
  std::filesystem::remove(ModelBundle::open(model).file(BundlePart::backbone()));
  EXPECT_EQ(
      error(std::string(kTwoStages) + "variants: {a: {}, b: {}}\n"),
      "a.yaml, variant 'a', stage 'train': expected a backbone with weights in " + model.string() +
          ", found none; train it or convert it into that folder (docs/WEIGHTS.md), or name another --model.");
}

TEST_F(StagePlan, RunsOnceWhatVariantsHaveInCommon) {
  options_.seeds = {0, 1};
  const AblationPlan plan =
      this->plan(std::string(kTwoStages) + "variants: {a: {}, b: {options: {eval: {rooms: 9}}}}\n");
  // One training a seed, and an evaluation of it for each variant.
  EXPECT_EQ(stages_of(plan), (std::vector<std::string>{"train", "eval", "train", "eval", "eval", "eval"}));
  ASSERT_EQ(plan.runs.size(), 4U);
  EXPECT_EQ(plan.tasks[0].used_by, (std::vector<std::string>{"a, seed 0", "b, seed 0"}));
  EXPECT_EQ(plan.tasks[1].needs, (std::vector<size_t>{0}));
  EXPECT_EQ(plan.tasks[plan.runs[3].results.at(0)].needs, (std::vector<size_t>{2}));
  EXPECT_TRUE(is_stage_key(plan.tasks[0].key));
  EXPECT_THAT(plan.tasks[0].options, testing::HasSubstr("seed: 5\n"));
  EXPECT_THAT(plan.tasks[2].options, testing::HasSubstr("seed: 1000000005\n"));
  EXPECT_THAT(plan.tasks[0].options, testing::Not(testing::HasSubstr("threads")));
}

TEST_F(StagePlan, KeysFollowFromAllThatAResultDependsOnAndNothingElse) {
  const auto keys = [&](const std::string& text) {
    const AblationPlan plan = this->plan(text);
    return std::make_pair(plan.tasks.front().key, plan.tasks.back().key);
  };
  options_.seeds = {0};
  const std::string variants = "variants: {a: {}}\n";
  const auto before = keys(kTwoStages + variants);
  options_.threads = 2;
  options_.jobs = 7;
  options_.out = "elsewhere";
  EXPECT_EQ(keys(kTwoStages + variants), before);
  // A default that is written out is the same configuration.
  EXPECT_EQ(keys(std::string(kTwoStages) + "variants: {a: {options: {eval: {rooms: 4}}}}\n"), before);
  // An option of the first stage changes both, of the second one the second.
  const auto first = keys(std::string(kTwoStages) + "variants: {a: {options: {train: {rooms: 5}}}}\n");
  EXPECT_NE(first.first, before.first);
  EXPECT_NE(first.second, before.second);
  const auto second = keys(std::string(kTwoStages) + "variants: {a: {options: {eval: {rooms: 5}}}}\n");
  EXPECT_EQ(second.first, before.first);
  EXPECT_NE(second.second, before.second);
  options_.seeds = {1};
  EXPECT_NE(keys(kTwoStages + variants).first, before.first);
  options_.seeds = {0};
  // The weights count, not where they lie.
  std::filesystem::rename(folder_.path() / "model", folder_.path() / "moved");
  options_.model = "moved";
  write_random_bundle(folder_.path() / "model", small_bundle_options(), 2);
  EXPECT_NE(keys(kTwoStages + variants).first, before.first);
}

TEST_F(StagePlan, AQuestionIsOfEverySeedAndProgramAndOfNoOtherOptionsOrBundle) {
  const auto questions_of = [&](const std::string& settings, int64_t seed, const std::string& program) {
    options_.seeds = {seed};
    ProgramCommands commands = small_commands();
    commands.version = program;
    std::vector<std::string> questions;
    for (const StageTask& task :
         plan_ablation(read(std::string(kTwoStages) + "variants: {a: {options: {" + settings + "}}}\n"),
                       commands)
             .tasks)
      questions.push_back(task.question);
    return questions;
  };
  const auto asked = questions_of("", 0, "gld 1");
  EXPECT_EQ(questions_of("", 7, "gld 2"), asked);
  // A training's steps change it and what is measured of it; rooms change the measurement alone.
  const auto longer = questions_of("train: {loop: {steps: 11}}", 0, "gld 1");
  EXPECT_NE(longer[0], asked[0]);
  EXPECT_NE(longer[1], asked[1]);
  const auto more_rooms = questions_of("eval: {rooms: 9}", 0, "gld 1");
  EXPECT_EQ(more_rooms[0], asked[0]);
  EXPECT_NE(more_rooms[1], asked[1]);
  // A seed that the description sets is part of the question: others are counted from there.
  EXPECT_NE(questions_of("eval: {seed: 3}", 0, "gld 1")[1], asked[1]);
  write_random_bundle(folder_.path() / "model", small_bundle_options(), 2);
  EXPECT_NE(questions_of("", 0, "gld 1")[0], asked[0]);
}

TEST_F(StagePlan, SharedStagesKeepTheirSeed) {
  options_.seeds = {0, 1, 2};
  const AblationPlan plan = this->plan(R"(stages:
  train: {command: train level, shared: true}
  eval: {command: eval}
variants: {a: {}}
)");
  EXPECT_EQ(stages_of(plan), (std::vector<std::string>{"train", "eval", "eval", "eval"}));
}

TEST_F(StagePlan, SeedsCanChangeAnotherOption) {
  options_.seeds = {1};
  const AblationPlan plan = this->plan(
      "stages: {train: {command: train level, seed: loop.seed, options: {loop: {seed: 7}}}}\nvariants: {a: {}}\n");
  EXPECT_THAT(plan.tasks[0].options, testing::HasSubstr("seed: 1000000007\n"));
  EXPECT_EQ(
      error("stages:\n  train: {command: train level, seed: loop.sed}\nvariants: {a: {}}\n"),
      "a.yaml, variant 'a', stage 'train', key 'loop.sed': expected a known option, found an unknown one; did you mean "
      "'loop.seed'?");
}

TEST_F(StagePlan, AssembledBundlesChangeTheirModelAndNameWhatTheyAreMadeOf) {
  options_.seeds = {0};
  const AblationPlan plan = this->plan(R"(stages:
  first: {command: assemble, options: {generated: ["1", "0"], level0: {in_channels: 128}}}
  train: {command: train level, model: first}
  whole: {command: assemble, model: first, parts: [train]}
  eval: {command: eval}
variants: {a: {}}
)");
  ASSERT_EQ(plan.tasks.size(), 4U);
  EXPECT_EQ(plan.tasks[2].parts, (std::vector<size_t>{1}));
  EXPECT_EQ(plan.tasks[2].needs, (std::vector<size_t>{0, 1}));
  EXPECT_EQ(plan.tasks[3].model, std::optional<size_t>(2));
  ASSERT_NE(plan.tasks[2].bundle, nullptr);
  EXPECT_EQ(plan.tasks[2].bundle->generators.size(), 2U);
}

TEST_F(StagePlan, OptionsCanNameTheRunOfAnEarlierStage) {
  options_.seeds = {0};
  const AblationPlan plan = this->plan(R"(stages:
  train: {command: train level}
  eval: {command: eval, model: base, options: {scene: "${train}/scenes"}}
variants: {a: {}}
)");
  EXPECT_EQ(plan.tasks[1].needs, (std::vector<size_t>{0}));
  EXPECT_THAT(plan.tasks[1].depends, testing::HasSubstr("stage " + plan.tasks[0].key + "/scenes"));
}

TEST_F(StagePlan, RepeatedStagesHaveANumberOfTheirOwn) {
  options_.seeds = {0};
  const AblationPlan plan = this->plan(R"(stages:
  train: {command: train level}
  eval: {command: eval, repeat: 3, options: {scene: "rooms/room_${number}"}}
variants: {a: {}}
)");
  ASSERT_EQ(plan.runs.at(0).results, (std::vector<size_t>{1, 2, 3}));
  EXPECT_THAT(plan.tasks[3].options, testing::HasSubstr("rooms/room_000002"));
  EXPECT_EQ(plan.tasks[3].needs, (std::vector<size_t>{0}));
}

// The same numbers again are no other scenes.
TEST_F(StagePlan, RepeatedStagesDifferAndTakeTheRunOfTheirNumber) {
  options_.seeds = {0};
  EXPECT_EQ(
      error("stages: {eval: {command: eval, repeat: 3}}\nvariants: {a: {}}\n"),
      "a.yaml, variant 'a', stage 'eval', key 'repeat': expected options with ${number}, by which the runs differ, "
      "found the same ones each time; write it into one of them, or leave repeat out.");
  const std::string first =
      "stages:\n  first: {command: eval, repeat: 3, options: {scene: \"room_${number}\"}}\n";
  const AblationPlan plan = this->plan(
      first + "  second: {command: eval, repeat: 3, options: {scene: \"${first}/a\"}}\nvariants: {a: {}}\n");
  ASSERT_EQ(plan.runs.at(0).results, (std::vector<size_t>{3, 4, 5}));
  for (size_t number = 0; number < 3; ++number)
    EXPECT_EQ(plan.tasks[3 + number].needs, std::vector<size_t>{number});
  EXPECT_EQ(
      error(
          first +
          "  second: {command: eval, repeat: 2, options: {scene: \"${first}/${number}\"}}\nvariants: {a: {}}\n"),
      "a.yaml, variant 'a', stage 'second', key 'options': expected ${first} of as many runs as this stage has, "
      "found 3 and 2; give both the same repeat.");
}

// Its seconds are the result.
TEST_F(StagePlan, OfWhatRunsAloneTheThreadsCountAndNoRunGoesOn) {
  options_.seeds = {0};
  const auto keys = [&](int64_t threads) {
    options_.threads = threads;
    const AblationPlan plan = this->plan(
        "stages:\n  train: {command: train level}\n  timed: {command: train level, alone: true, options: {rooms: 9}}\n"
        "variants: {a: {}}\n");
    EXPECT_TRUE(plan.tasks[0].resumable);
    EXPECT_FALSE(plan.tasks[1].resumable);
    return std::make_pair(plan.tasks[0].key, plan.tasks[1].key);
  };
  const auto one = keys(1), two = keys(2);
  EXPECT_EQ(one.first, two.first);
  EXPECT_NE(one.second, two.second);
}

TEST_F(StagePlan, WhatWasRemovedIsNotMadeAgainForResultsThatAreThere) {
  options_.seeds = {0, 1};
  const AblationPlan plan = this->plan(std::string(kTwoStages) + "variants: {a: {}}\n");
  const StageCache cache(folder_.path() / "cache");
  EXPECT_EQ(needed_tasks(plan, cache), (std::vector<bool>{true, true, true, true}));
  cache.begin(plan.tasks[1]);
  cache.finish(plan.tasks[1], {});
  EXPECT_EQ(needed_tasks(plan, cache), (std::vector<bool>{false, true, true, true}));
  EXPECT_THAT(plan_text(plan, cache, 1),
              testing::HasSubstr("3 stages for 2 runs of variants and seeds: 1 done, 2 to run"));
}

TEST_F(StagePlan, RefusesWhatCouldNotRunWithLineAndVariant) {
  options_.seeds = {0};
  EXPECT_EQ(
      error(std::string(kTwoStages) + "variants: {a: {options: {eval: {room: 5}}}}\n"),
      "a.yaml:6, variant 'a', stage 'eval', key 'room': expected a known option, found an unknown one; did you mean "
      "'rooms'?");
  EXPECT_EQ(
      error(std::string(kTwoStages) + "variants: {a: {options: {eval: {rooms: 500}}}}\n"),
      "a.yaml:6, variant 'a', stage 'eval', key 'rooms': expected an integer in the range [1, 100], found 500; choose a "
      "value inside the range.");
  EXPECT_EQ(
      error("stages: {eval: {command: evall}}\nvariants: {a: {}}\n"),
      "a.yaml, variant 'a', stage 'eval', key 'command': expected a command of gld, or assemble, found 'evall'; did "
      "you mean 'eval'?");
  EXPECT_EQ(
      error(std::string(kTwoStages) +
            "  again: {command: train level, resume: train}\nvariants: {a: {stages: [again]}}\n"),
      "a.yaml, variant 'a', stage 'again', key 'resume': expected a stage that the variant takes, found 'train'; add it "
      "to the variant's stages.");
  EXPECT_EQ(
      error("stages:\n  set: {command: assemble, options: {boundary_level: 3}}\nvariants: {a: {}}\n"),
      "generated: expected a part that generates boundary_level 3, which propagation starts from, found none in "
      "generated; add 3 to generated or change boundary_level.");
}

TEST_F(StagePlan, CostsAreMeasuredOrUnknown) {
  options_.seeds = {0, 1};
  const AblationPlan plan = this->plan(std::string(kTwoStages) + "variants: {a: {}}\n");
  const StageCache cache(folder_.path() / "cache");
  EXPECT_EQ(cache.state(plan.tasks[0]), StageState::kMissing);
  EXPECT_EQ(expected_cost(plan, 2, cache).source, CostSource::kUnknown);
  EXPECT_THAT(plan_text(plan, cache, 2),
              testing::HasSubstr("4 stages for 2 runs of variants and seeds: 0 done, 4 to run, 2 at a time; "
                                 "time left unknown."));
  cache.begin(plan.tasks[0]);
  EXPECT_EQ(cache.state(plan.tasks[0]), StageState::kBegun);
  cache.note_seconds_spent(plan.tasks[0], 2);
  cache.note_seconds_spent(plan.tasks[0], 3);
  EXPECT_DOUBLE_EQ(cache.seconds_spent(plan.tasks[0]), 5);
  cache.finish(plan.tasks[0], {10, 1 << 20, 5});
  EXPECT_EQ(cache.state(plan.tasks[0]), StageState::kDone);
  // The other seed's stage is expected to take as long; evaluations are not known.
  const ExpectedCost like = expected_cost(plan, 2, cache);
  EXPECT_EQ(like.source, CostSource::kLikeStages);
  EXPECT_DOUBLE_EQ(like.cost.seconds, 10);
  EXPECT_EQ(expected_cost(plan, 1, cache).source, CostSource::kUnknown);
  EXPECT_THAT(plan_text(plan, cache, 1), testing::HasSubstr("1 done, 3 to run"));
}

TEST_F(StagePlan, WhatTheAblationSetsItselfIsRefused) {
  const std::string variants = "variants: {a: {}}\n";
  EXPECT_EQ(error("stages: {eval: {command: eval, options: {out: here}}}\n" + variants),
            "a.yaml:3, stage 'eval', key 'out': expected an option that changes a result, found one that the "
            "ablation sets itself; remove it.");
  EXPECT_THAT(error("stages: {eval: {command: eval, options: {model: here}}}\n" + variants),
              testing::HasSubstr("write 'model' beside 'options', for the stage or the variant."));
  EXPECT_EQ(
      error("stages: {eval: {command: eval, options: {threads: 3}}}\n" + variants),
      "a.yaml:3, stage 'eval', key 'threads': expected an option that changes a result, found one that the ablation "
      "sets itself; say it to gld ablate, or in the description's first lines.");
  EXPECT_THAT(error("stages: {eval: {command: eval, options: {processes: {count: 2}}}}\n" + variants),
              testing::HasSubstr("found one that the ablation sets itself; remove it."));
}

// Not first by the next smoke run.
TEST_F(StagePlan, SmokeSettingsAreCheckedWithEveryPlan) {
  EXPECT_THAT(error(std::string(kTwoStages) + "variants: {a: {}}\nsmoke: {eval: {romms: 1}}\n"),
              testing::HasSubstr("expected a known option, found an unknown one; did you mean 'rooms'?"));
}

TEST_F(StagePlan, VariantsThatCannotDifferAreTold) {
  const Ablation ablation =
      read(std::string(kTwoStages) +
           "variants: {a: {}, b: {options: {eval: {rooms: 9}}}, c: {options: {eval: {rooms: 4}}}, "
           "d: {columns: {psnr: other}}}\n");
  const auto equal = equal_variants(ablation, plan_ablation(ablation, small_commands()));
  EXPECT_EQ(equal, (std::vector<std::pair<std::string, std::string>>{{"a", "c"}}));
}

}  // namespace
}  // namespace gld
