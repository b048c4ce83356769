#include "datasets/synthetic/synth.h"

#include "datasets/formats/json_file.h"
#include "datasets/formats/scene_reader.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

SynthOptions small(const std::filesystem::path& out) {
  SynthOptions options;
  options.out = out.string();
  options.scene.scene_count = 3;
  options.scene.frames = 4;
  options.scene.width = options.scene.height = 32;
  return options;
}

TEST(Synth, WritesScenesThatOpen) {
  const TemporaryFolder folder;
  for (const char* layout : {"cameras-json", "re10k", "npz"}) {
    SynthOptions options = small(folder.path() / layout);
    options.layout = layout;
    run_synth(options);
    const auto scenes = list_scenes(folder.path() / layout);
    ASSERT_EQ(scenes.size(), 3U) << layout;
    for (const SceneLocation& location : scenes) {
      SceneReading reading;
      reading.part = location.part;
      EXPECT_EQ(open_scene(location.path, reading).frames.size(), 4U) << layout;
    }
    EXPECT_EQ(read_json_file(folder.path() / layout / "report.json")["layout"], layout);
  }
}

TEST(Synth, TheNumberOfThreadsChangesNothing) {
  const TemporaryFolder folder;
  SynthOptions one = small(folder.path() / "one");
  one.threads = 1;
  run_synth(one);
  SynthOptions three = small(folder.path() / "three");
  three.threads = 3;
  run_synth(three);
  const auto first = list_scenes(folder.path() / "one");
  const auto second = list_scenes(folder.path() / "three");
  for (size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(open_scene(first[i].path).frames[2].image().rgb,
              open_scene(second[i].path).frames[2].image().rgb);
  }
}

TEST(Synth, RefusesWrongOptions) {
  SynthOptions options = small("");
  EXPECT_EQ(error_of([&] { run_synth(options); }),
            "--out: expected a folder to write into, found nothing; add for example --out runs/synth.");
  options.out = "somewhere";
  options.layout = "jpg";
  EXPECT_EQ(error_of([&] { run_synth(options); }),
            "--layout: expected one of cameras-json, npz, nerfstudio, re10k, tartanair, colmap, colmap-text, "
            "eth3d, found \"jpg\"; choose one of them.");
}

}  // namespace
}  // namespace gld
