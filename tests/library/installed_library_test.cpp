// This runs the example of examples/ against an installed prefix, as somebody else's program.

#include "datasets/images/image_file.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/child_process.h"
#include "tests/support/data_folders.h"
#include "tests/support/temporary_folder.h"

#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(InstalledLibrary, SamplesTwoPhotographsAsTheProgramDoes) {
  const test::TemporaryFolder folder;
  const auto run = [&](const std::vector<std::string>& command) {
    const auto log = folder.path() / "log";
    ASSERT_EQ(run_program(command, log, "test"), 0) << read_file(log);
  };
  const auto prefix = folder.path() / "prefix", build = folder.path() / "build";
  run({CMAKE_PROGRAM, "--install", GLD_BINARY_DIR, "--component", "library", "--prefix", prefix.string()});
  run({CMAKE_PROGRAM, "-G", "Ninja", "-S", (test::source_root() / "examples/sample_two_photographs").string(),
       "-B", build.string(), "-DCMAKE_BUILD_TYPE=Release", "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror",
       "-DCMAKE_PREFIX_PATH=" + prefix.string()});
  run({CMAKE_PROGRAM, "--build", build.string()});

  SyntheticOptions room;
  room.seed = 910003;
  room.frames = 4;
  const Scene scene = make_synthetic_scene(room, 0);
  std::vector<std::string> photographs;
  for (const size_t frame : {0, 2}) {
    photographs.push_back((folder.path() / ("photo_" + std::to_string(frame) + ".png")).string());
    write_png(photographs.back(), scene.frames[frame].image());
  }
  const auto model = (test::source_root() / "configs/tiny").string();
  const auto made = folder.path() / "made", out = folder.path() / "out";
  std::filesystem::create_directory(made);
  run({(build / "sample_two_photographs").string(), model, photographs[0], photographs[1], made.string()});
  run({GLD_PROGRAM, "sample", "--model", model, "--photos", photographs[0], photographs[1], "--frames", "2",
       "--outputs", "image", "--out", out.string()});
  for (int view = 2; view < 4; ++view) {
    const Image by_program = read_image(out / ("images/view_0" + std::to_string(view) + ".png"));
    std::vector<std::filesystem::path> files;
    for (const auto& entry : std::filesystem::directory_iterator(made)) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    ASSERT_EQ(files.size(), 2U);
    const std::string ppm = read_file(files[static_cast<size_t>(view - 2)]);
    const std::string head =
        "P6\n" + std::to_string(by_program.width) + " " + std::to_string(by_program.height) + "\n255\n";
    ASSERT_EQ(ppm.substr(0, head.size()), head);
    EXPECT_TRUE(std::equal(by_program.rgb.begin(), by_program.rgb.end(),
                           reinterpret_cast<const uint8_t*>(ppm.data()) + head.size(),
                           reinterpret_cast<const uint8_t*>(ppm.data()) + ppm.size()))
        << files[static_cast<size_t>(view - 2)];
  }
}

}  // namespace
}  // namespace gld
