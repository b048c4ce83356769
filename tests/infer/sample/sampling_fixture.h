#pragma once

#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "infer/sample/sampling.h"
#include "models/bundle/random_bundle.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <cstdlib>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld::test {

// One random model and one drawn scene of 6 frames for all tests.
class Sampling : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ = new TemporaryFolder();
    ::setenv("XDG_CACHE_HOME", (folder_->path() / "cache").c_str(), 1);  // no rates of the tester's
    write_random_bundle(folder_->path() / "model", small_bundle_options(), 7);
    SyntheticOptions synthetic;
    synthetic.seed = 5;
    synthetic.frames = 6;
    synthetic.width = 112;
    synthetic.height = 56;
    write_scene(make_synthetic_scene(synthetic, 0), "cameras-json", folder_->path() / "scene");
  }
  static void TearDownTestSuite() {
    delete folder_;
    folder_ = nullptr;
  }

  static SampleOptions options(const std::string& run) {
    SampleOptions options;
    options.model = (folder_->path() / "model").string();
    options.scene = (folder_->path() / "scene").string();
    options.views.sources = {0, 3};
    options.views.targets = {1, 2};
    options.size = "112x56";
    options.solver.evaluations = 3;
    options.threads = 1;
    options.out = (folder_->path() / run).string();
    return options;
  }

  static nlohmann::json run(const SampleOptions& options) {
    ::testing::internal::CaptureStdout();
    ::testing::internal::CaptureStderr();
    sample(options);
    printed_ = ::testing::internal::GetCapturedStdout();
    ::testing::internal::GetCapturedStderr();
    return nlohmann::json::parse(read_file(std::filesystem::path(options.out) / "report.json"));
  }

  // A random model's rays fit no camera.
  static SampleOptions with_shipped_model(SampleOptions options) {
    options.model = (source_root() / "configs" / "tiny").string();
    options.size = "112x112";
    return options;
  }

  static std::vector<std::string> stage_names(const nlohmann::json& report) {
    std::vector<std::string> names;
    for (const auto& stage : report.at("stages")) names.push_back(stage.at("stage"));
    return names;
  }

  static inline TemporaryFolder* folder_ = nullptr;
  static inline std::string printed_;
};

}  // namespace gld::test
