#include "infer/splats/splat_spectrum.h"

#include "datasets/formats/scene_writer.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "infer/splats/scene_spectrum.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <filesystem>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

using test::error_of;

TEST(SplatSpectrum, AWorldsTextureKeepsItsFrequencies) {
  const test::TemporaryFolder folder;
  SyntheticOptions rooms;
  rooms.frames = 12;
  rooms.width = rooms.height = 128;
  for (int64_t room = 0; room < 2; ++room) {
    write_scene(make_synthetic_scene(rooms, room), "cameras-json",
                folder.path() / "rooms" / ("room_" + std::to_string(room)));
  }
  SplatSpectrumOptions options;
  options.scenes = {(folder.path() / "rooms").string()};
  options.models = {(test::source_root() / "configs" / "tiny").string()};
  options.levels = {"0", "1"};
  options.out = (folder.path() / "spectrum").string();
  options.latent_side = 16;
  options.side = 128;
  options.held_out = 3;
  options.threads = 1;
  options.fit.steps = 60;
  options.fit.density.most_gaussians = 10000;
  testing::internal::CaptureStdout();
  run_splat_spectrum(options);
  const std::string printed = testing::internal::GetCapturedStdout();
  EXPECT_NE(printed.find("GLD tiny, level 1"), std::string::npos);
  const std::filesystem::path out = options.out;
  const auto report = nlohmann::json::parse(read_file(out / "report.json"));
  EXPECT_EQ(report.at("band"), (std::vector<int64_t>{4, 7}));
  ASSERT_EQ(report.at("spaces").size(), 4U);
  const auto space = [&](size_t i) { return report.at("spaces").at(i); };
  EXPECT_EQ(space(0).at("space"), kColourSpace);
  EXPECT_EQ(space(1).at("space"), kNoiseSpace);
  EXPECT_EQ(space(1).at("ring_ratios").size(), 8U);
  // The ridge takes some of the texture's finest waves away, the backbone's tokens differ between views as well.
  EXPECT_GT(space(1).at("ratio").get<double>(), 0.75);
  EXPECT_LT(space(1).at("ratio").get<double>(), 1);
  EXPECT_LT(space(3).at("ratio").get<double>(), space(1).at("ratio").get<double>() - 0.05);
  for (const auto& one : report.at("spaces")) {
    EXPECT_LE(one.at("interval").at(0).get<double>(), one.at("ratio").get<double>());
    EXPECT_GE(one.at("interval").at(1).get<double>(), one.at("ratio").get<double>());
  }
  for (const char* file : {"rings.csv", "spaces.csv", "spectrum.md", "spectrum.png", "spectrum.svg",
                           "pictures/room_0_space3.png"})
    EXPECT_TRUE(std::filesystem::is_regular_file(out / file)) << file;
}

TEST(SplatSpectrum, SaysWhatItCannotTake) {
  SplatSpectrumOptions options;
  options.out = "runs/never";
  EXPECT_EQ(error_of([&] { run_splat_spectrum(options); }),
            "--scenes: expected folders that are scenes or hold some, found none; add for example --scenes "
            "rooms/scenes.");
}

}  // namespace
}  // namespace gld
