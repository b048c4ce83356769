// Runs that are stopped, and how they go on.
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/sample/prepared_sampling.h"
#include "infer/sample/sampling.h"
#include "infer/sample/unfinished_latents.h"
#include "tests/infer/sample/sampling_fixture.h"
#include "tests/support/error_of.h"

#include <csignal>
#include <filesystem>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

namespace gld {
namespace {

using testing::HasSubstr;

class InterruptedSampling : public test::Sampling {};

TEST_F(InterruptedSampling, CtrlCKeepsFinishedFilesAndSaysWhatWasDone) {
  auto asked = options("interrupted");
  asked.solver.evaluations = 4000;
  asked.outputs = {"image"};
  testing::internal::CaptureStdout();
  testing::internal::CaptureStderr();
  install_interrupt_handler(StopDeadline::kSafePoint);
  // The alarm arrives while M1 runs.
  std::signal(SIGALRM, [](int) { std::raise(SIGINT); });
  ::alarm(2);
  std::string done;
  try {
    sample(asked);
  } catch (const Interrupted& interrupted) {
    done = interrupted.what();
  }
  testing::internal::GetCapturedStdout();
  testing::internal::GetCapturedStderr();
  EXPECT_THAT(done, testing::MatchesRegex("M1: [0-9]+ steps to flow time [0-9.]+"));
  for (const auto& entry : std::filesystem::recursive_directory_iterator(asked.out)) {
    EXPECT_THAT(entry.path().filename().string(), testing::Not(HasSubstr("partial")));
  }
  EXPECT_TRUE(std::filesystem::is_regular_file(std::filesystem::path(asked.out) / "config.yaml"));
  std::signal(SIGALRM, SIG_DFL);
  install_interrupt_handler(StopDeadline::kSafePoint);  // nothing is asked of the tests that follow
}

TEST_F(InterruptedSampling, AnInterruptedRunGoesOnFromItsLevels) {
  auto asked = options("resumed");
  asked.outputs = {"image", "latents"};
  run(asked);
  const std::filesystem::path out = asked.out;
  EXPECT_FALSE(std::filesystem::exists(out / "unfinished"));
  const auto before = read_file(out / "images" / "view_02.png");
  const auto first = nlohmann::ordered_json::parse(read_file(out / "report.json"));
  const std::string hash = first.at("model").at("hash"),
                    method = json_text(first.at("sampling").at("method"));
  PreparedSampling prepared = prepare(asked);
  load_pixels(prepared, asked);
  const std::string inputs = inputs_hash(prepared.scene);
  const UnfinishedLatents unfinished(out);
  unfinished.write(1, read_all(out / "latents.safetensors").at("level1"), {hash, method, inputs});
  unfinished.write(0, read_all(out / "latents.safetensors").at("level0"),
                   {"of other weights", method, inputs});
  std::filesystem::remove(out / "images" / "view_02.png");
  asked.resume = true;
  const auto report = run(asked);
  EXPECT_TRUE(report.at("flows").at(0).contains("kept"));
  EXPECT_EQ(report.at("flows").at(1).at("function_evaluations"), 3);
  EXPECT_TRUE(read_file(out / "images" / "view_02.png") == before);
  EXPECT_FALSE(std::filesystem::exists(out / "unfinished"));
  // Nor is a level taken that another method made, or of another scene, or that is damaged.
  const auto latent = torch::randn({2, 3});
  const auto file = out / "unfinished" / "level1.safetensors";
  unfinished.write(1, latent, {hash, method, inputs});
  EXPECT_EQ(unfinished.read({hash, method, inputs}).size(), 1u);
  EXPECT_TRUE(unfinished.read({hash, "{}", inputs}).empty());
  for (const auto& change :
       {+[](SamplingScene& scene) { scene.source_images[1].rgb[0] ^= 1; },
        +[](SamplingScene& scene) { scene.views.cameras[2].intrinsics(0, 2) += 1e-3; }}) {
    SamplingScene other = prepared.scene;
    change(other);
    EXPECT_TRUE(unfinished.read({hash, method, inputs_hash(other)}).empty());
  }
  const std::string bytes = read_file(file);
  std::string flipped = bytes;
  flipped[flipped.size() - 5] ^= 1;
  for (const auto& damaged :
       {flipped, bytes.substr(0, bytes.size() - 1), bytes.substr(0, 20), std::string()}) {
    write_file_atomically(file, damaged);
    EXPECT_TRUE(unfinished.read({hash, method, inputs}).empty());
  }
  unfinished.remove();
  asked.seed = 1;
  EXPECT_EQ(test::error_of([&] { sample(asked); }),
            "--resume: expected the options of the run, which has seed 0, found 1; leave it as it was, or "
            "begin again with --overwrite.");
}

}  // namespace
}  // namespace gld
