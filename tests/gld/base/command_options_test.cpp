#include "gld/base/command_options.h"

#include "gld/base/configuration.h"
#include "tests/support/error_of.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

struct EveryOption : OptionsGroup {
  std::string out, device = "cpu", scene;
  bool overwrite = false, json = false;
  int64_t threads = 0, seed = 0;
  std::vector<std::string> scenes;
  void visit(FieldVisitor& visitor) override {
    visit_out(visitor, out, overwrite);
    visit_json(visitor, json);
    visit_device(visitor, device);
    visit_threads(visitor, threads);
    visit_seed(visitor, seed, "the noise");
    visit_scene(visitor, scene);
    visit_scenes(visitor, scenes, "generated ones");
  }
};

TEST(CommandOptions, ZeroThreadsAreOneACore) {
  EXPECT_EQ(threads_to_use(3), 3);
  EXPECT_GE(threads_to_use(0), 1);
}

TEST(CommandOptions, AreReadUnderTheirNames) {
  EveryOption options;
  load_yaml_text(options, "out: runs/a\ndevice: cuda\nthreads: 4096\nseed: 7\nscenes: [a, b]\nscene: c\n",
                 "x");
  EXPECT_EQ(options.out, "runs/a");
  EXPECT_EQ(options.device, "cuda");
  EXPECT_EQ(options.threads, kMostThreads);
  EXPECT_EQ(options.seed, 7);
  EXPECT_EQ(options.scenes, (std::vector<std::string>{"a", "b"}));
  EXPECT_EQ(options.scene, "c");
  options.threads = kMostThreads + 1;
  EXPECT_EQ(
      test::error_of([&] { check_options(options, "x"); }),
      "x, key 'threads': expected a value in the range [0, 4096], found 4097; choose a value inside the "
      "range.");
}

TEST(CommandOptions, AFolderToWriteIntoIsAskedFor) {
  check_out("runs/a", "runs/x");
  EXPECT_EQ(test::error_of([] { check_out("", "runs/x"); }),
            "--out: expected a folder to write into, found nothing; add for example --out runs/x.");
}

TEST(CommandOptions, WhatIsReadDoesNotLieWhereOverwritingRemoves) {
  check_input_survives("--model", "runs/a/model", "runs/a", /*overwrite=*/false);
  check_input_survives("--model", "runs/ab", "runs/a", /*overwrite=*/true);
  check_input_survives("--model", "runs", "runs/a", /*overwrite=*/true);
  EXPECT_EQ(
      test::error_of([] { check_input_survives("--model", "runs/b/../a/model", "./runs/a/", true); }),
      "--model: expected a folder outside ./runs/a/, where --overwrite removes what an earlier run wrote, found "
      "runs/b/../a/model; write into another --out.");
  EXPECT_EQ(
      test::error_of([] { check_input_survives("--model", "runs/a", "runs/a", true); }),
      "--model: expected a folder outside runs/a, where --overwrite removes what an earlier run wrote, found "
      "runs/a; write into another --out.");
}

}  // namespace
}  // namespace gld
