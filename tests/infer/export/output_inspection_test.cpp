// What gld inspect says of run folders, pictures and clouds.
#include "infer/export/output_inspection.h"

#include "datasets/images/png_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "gld/report/run_folder.h"
#include "infer/export/ply_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>
#include <memory>
#include <string>
#include <utility>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using testing::HasSubstr;

struct StepOptions : OptionsGroup {
  int64_t steps = 3;
  void visit(FieldVisitor& visitor) override { visitor.integer({"steps", "how many"}, steps, {1, 10}); }
};

// Writes a safetensors file without tensors, whose header holds what a training checkpoint's does.
void write_checkpoint(const std::filesystem::path& file, const std::string& step, const std::string& state) {
  const nlohmann::json header = {{"__metadata__", {{"step", step}, {"state", state}}}};
  std::string text = json_text(header), length;
  text.resize((text.size() + 7) / 8 * 8, ' ');
  for (int byte = 0; byte < 8; ++byte) length += static_cast<char>(text.size() >> (8 * byte) & 0xFF);
  std::filesystem::create_directories(file.parent_path());
  write_file_atomically(file, length + text);
}

Provenance some_provenance() {
  Provenance provenance = make_provenance("sample", StepOptions());
  provenance.model_hash = "abc123";
  provenance.seed = 7;
  return provenance;
}

class OutputInspection : public testing::Test {
 protected:
  std::filesystem::path path(const std::string& name) const { return folder_.path() / name; }
  std::string text_of(const std::string& name) const {
    const auto inspection = inspect_output(path(name));
    return inspection ? output_inspection_text(*inspection) : "nothing";
  }

  test::TemporaryFolder folder_;
};

TEST_F(OutputInspection, OfATrainingListsItsCheckpoints) {
  auto run = std::make_unique<RunFolder>(path("level"), "train level", StepOptions(), EarlierRun::kRefuse);
  const std::string run_path = path("level").string();
  EXPECT_EQ(text_of("level"), run_path + ": a run of gld train level, running\n");
  write_checkpoint(path("level/checkpoints/step_000000020.safetensors"), "20",
                   R"({"loss": 0.25, "best": null})");
  write_checkpoint(path("level/checkpoints/step_000000040.safetensors"), "40",
                   R"({"loss": 0.125, "best": 0.5})");
  write_checkpoint(path("level/checkpoints/best.safetensors"), "20", R"({"loss": 0.25, "best": 0.5})");
  write_file_atomically(path("level/checkpoints/step_000000060.safetensors"), "cut short");
  run.reset();
  const auto inspection = inspect_output(path("level"));
  ASSERT_TRUE(inspection);
  EXPECT_EQ((*inspection)["state"], "not finished");
  const auto& checkpoints = (*inspection)["checkpoints"];
  ASSERT_EQ(checkpoints.size(), 4U);
  EXPECT_EQ(checkpoints[1]["step"], 20);
  EXPECT_TRUE(checkpoints[1]["best_validation_loss"].is_null());
  EXPECT_THAT(checkpoints[3]["problem"].get<std::string>(), HasSubstr("step_000000060.safetensors"));
  const std::string text = output_inspection_text(*inspection);
  EXPECT_THAT(text,
              HasSubstr("  checkpoints/best.safetensors: step 20, loss 0.25, least validation loss 0.5\n"
                        "  checkpoints/step_000000020.safetensors: step 20, loss 0.25\n"
                        "  checkpoints/step_000000040.safetensors: step 40, loss 0.125, least validation "
                        "loss 0.5\n"));
  EXPECT_THAT(text, testing::EndsWith("\nnext: gld train level --config " + run_path + "/config.yaml --out " +
                                      run_path + " --resume\n"));
}

TEST_F(OutputInspection, OfARunWithPicturesGivesItsVerdict) {
  const auto verdict_of = [&](const std::string& name, const nlohmann::ordered_json& report) {
    RunFolder(path(name), "sample", StepOptions(), EarlierRun::kRefuse).write_report(report);
    const auto inspection = inspect_output(path(name));
    return std::pair{(*inspection)["verdict"], output_inspection_text(*inspection)};
  };
  const auto [verdict, text] = verdict_of("pictures", {{"verdict", {{"sentence", "Expect inventions."}}}});
  EXPECT_EQ(verdict, "Expect inventions.");
  EXPECT_THAT(text, HasSubstr("a run of gld sample, finished\nExpect inventions.\nnext: gld splat fit"));
  EXPECT_TRUE(verdict_of("none", {{"answer", 42}}).first.is_null());
  EXPECT_TRUE(verdict_of("another", {{"verdict", "text"}}).first.is_null());
  write_file_atomically(path("pictures/report.json"), "{cut");
  EXPECT_TRUE((*inspect_output(path("pictures")))["verdict"].is_null());
}

TEST_F(OutputInspection, OfAFinishedRunNamesWhatUsuallyFollows) {
  const auto next_of = [&](const std::string& name, const std::string& kind) {
    RunFolder(path(name), kind, StepOptions(), EarlierRun::kRefuse).write_report({{"answer", 42}});
    const auto inspection = inspect_output(path(name));
    EXPECT_EQ((*inspection)["kind"], kind);
    EXPECT_EQ((*inspection)["state"], "finished");
    return (*inspection)["next"];
  };
  EXPECT_EQ(next_of("a", "train backbone"),
            "gld train decoder --model " + path("a").string() + "/model --out runs/decoder");
  // A depth head that was trained on a backbone which has its decoder.
  next_of("head", "train backbone");
  std::filesystem::create_directories(path("head/model"));
  write_file_atomically(path("head/model/rgb_decoder.safetensors"), "weights");
  EXPECT_EQ((*inspect_output(path("head")))["next"],
            "gld train depth --model " + path("head").string() + "/model --out runs/depth");
  EXPECT_EQ(next_of("my run", "sample"),
            "gld splat fit --run '" + path("my run").string() + "' --out runs/splats");
  EXPECT_TRUE(next_of("c", "bench solvers").is_null());
  EXPECT_EQ(text_of("c"), path("c").string() + ": a run of gld bench solvers, finished\n");
}

// What cannot go on begins anew.
TEST_F(OutputInspection, OfAnUnfinishedRunNamesTheCommandThatFinishesIt) {
  for (const auto& [kind, end] : {std::pair{"sample", " --resume"}, {"stats", " --overwrite"}}) {
    { const RunFolder run(path(kind), kind, StepOptions(), EarlierRun::kRefuse); }
    EXPECT_THAT(text_of(kind), testing::EndsWith(std::string(end) + "\n"));
  }
  { const RunFolder run(path("ablate"), "ablate", StepOptions(), EarlierRun::kRefuse); }
  EXPECT_TRUE((*inspect_output(path("ablate")))["next"].is_null());
  // An ablation goes on with the description that it keeps.
  write_file_atomically(path("ablate/ablation.yaml"), "title: none\n");
  write_file_atomically(path("ablate/config.yaml"),
                        "# gld ablate: the options\nout: \"there\"\ncache: \"\"\nmodel: \"configs/tiny\"\n"
                        "seeds: [0, 1]\nonly: []\nsmoke: false\noverwrite: true\njobs: 1\n");
  const std::string folder = path("ablate").string();
  EXPECT_EQ((*inspect_output(path("ablate")))["next"],
            "gld ablate --config " + folder +
                "/ablation.yaml --set 'model=\"configs/tiny\"' --set 'seeds=[0, 1]'" +
                " --set 'only=[]' --set smoke=false --set jobs=1 --out " + folder);
}

TEST_F(OutputInspection, OfPicturesShowsWhereTheyComeFrom) {
  TextItems texts = provenance_items(some_provenance());
  texts.emplace_back("gld:note", "über\x1b[2J");
  write_file_atomically(path("view.png"), encode_png(Image(5, 3), texts));
  const auto inspection = inspect_output(path("view.png"));
  ASSERT_TRUE(inspection);
  EXPECT_EQ((*inspection)["width"], 5);
  EXPECT_EQ((*inspection)["height"], 3);
  EXPECT_EQ((*inspection)["texts"].size(), texts.size());
  for (const auto& [name, text] : texts) EXPECT_EQ((*inspection)["texts"][name], text);
  const std::string text = output_inspection_text(*inspection);
  EXPECT_THAT(text, testing::StartsWith(path("view.png").string() + ": a PNG picture of 5x3 pixels\n"));
  EXPECT_THAT(text, HasSubstr("\n  gld:command: sample\n"));
  EXPECT_THAT(text, HasSubstr("\n  gld:model: abc123\n"));
  EXPECT_THAT(text, HasSubstr("\n  gld:note: über\\x1b[2J\n"));
  write_file_atomically(path("other.png"), encode_png(Image(5, 3), {}));
  EXPECT_THAT(text_of("other.png"),
              testing::EndsWith("  no provenance: another program wrote it, or changed it since\n"));
  write_file_atomically(path("cut.png"), encode_png(Image(5, 3), texts).substr(0, 60));
  EXPECT_THAT(error_of([&] { inspect_output(path("cut.png")); }), HasSubstr(path("cut.png").string()));
}

// Long texts go on in another comment, and are one again.
TEST_F(OutputInspection, OfCloudsShowsWhereTheyComeFrom) {
  PointCloud cloud;
  cloud.x_in_world = {{1, 2, 3}, {4, 5, 6}};
  cloud.colours.resize(2);
  cloud.confidences = {1, 2};
  Provenance provenance = some_provenance();
  provenance.options = std::string(2000, 'o');
  export_ply(path("points.ply"), cloud, provenance);
  const auto inspection = inspect_output(path("points.ply"));
  ASSERT_TRUE(inspection);
  EXPECT_EQ((*inspection)["vertices"], 2);
  EXPECT_EQ((*inspection)["properties"].size(), 7U);
  for (const auto& [name, text] : provenance_items(provenance)) EXPECT_EQ((*inspection)["texts"][name], text);
  EXPECT_THAT(output_inspection_text(*inspection),
              testing::StartsWith(path("points.ply").string() +
                                  ": a PLY file of 2 vertices (x y z red green blue confidence)\n"));
  write_file_atomically(path("text.ply"), "ply\nformat ascii 1.0\nend_header\n");
  EXPECT_THAT(error_of([&] { inspect_output(path("text.ply")); }), HasSubstr(path("text.ply").string()));
}

// Weight files and bundles are told of by models/bundle/inspection.h.
TEST_F(OutputInspection, OfAnythingElseIsNothing) {
  write_file_atomically(path("w.safetensors"), "x");
  std::filesystem::create_directories(path("bundle"));
  write_file_atomically(path("bundle/model.yaml"), "");
  write_file_atomically(path("bundle/config.yaml"),
                        "# gld stats: the options of this run, defaults included\n");
  std::filesystem::create_directories(path("empty"));
  for (const char* name : {"w.safetensors", "bundle", "empty", "nowhere"})
    EXPECT_EQ(text_of(name), "nothing") << name;
}

// A scene as gld export writes it, and what is not whole.
TEST_F(OutputInspection, OfASceneSaysWhereItComesFrom) {
  const std::string json =
      R"({"asset":{"version":"2.0","extras":{"gld:command":"export","gld:seed":7}},"meshes":[{},{}],"cameras":[{}]})";
  const auto word = [](size_t value) {
    std::string bytes;
    for (int shift = 0; shift < 32; shift += 8) bytes.push_back(static_cast<char>(value >> shift & 255));
    return bytes;
  };
  const std::string whole = "glTF" + word(2) + word(20 + json.size()) + word(json.size()) + "JSON" + json;
  const auto file = path("scene.glb");
  write_file_atomically(file, whole);
  const auto inspection = inspect_output(file).value();
  EXPECT_EQ(inspection.at("meshes"), 2);
  EXPECT_EQ(inspection.at("cameras"), 1);
  EXPECT_EQ(inspection.at("texts").dump(), R"({"gld:command":"export","gld:seed":"7"})");
  EXPECT_THAT(output_inspection_text(inspection),
              testing::AllOf(HasSubstr("a GLB scene of 2 meshes, 1 cameras and 0 pictures"),
                             HasSubstr("gld:seed: 7")));
  write_file_atomically(file, whole.substr(0, whole.size() - 1));
  EXPECT_THAT(
      error_of([&] { inspect_output(file); }),
      HasSubstr("scene.glb: expected a GLB file whose first chunk is JSON, found one that ends early"));
  write_file_atomically(file, whole.substr(0, 20) + std::string(json.size(), '{'));
  EXPECT_THAT(error_of([&] { inspect_output(file); }), HasSubstr("scene.glb"));
}

}  // namespace
}  // namespace gld
