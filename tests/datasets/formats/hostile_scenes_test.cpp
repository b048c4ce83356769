// Scenes whose files are small and whose numbers are not: each must end in one sentence, soon, and without the memory
// that the numbers speak of.

#include "datasets/formats/depth_files.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/images/image_file.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/files/npy.h"
#include "gld/files/zip_archive.h"
#include "tests/support/error_of.h"
#include "tests/support/resident_memory.h"
#include "tests/support/temporary_folder.h"

#include <ctime>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::expect_little_memory;
using test::TemporaryFolder;
using testing::HasSubstr;

std::string camera_record(const std::string& name, const std::string& more) {
  return fmt::format(R"({{"name":"{}","image":"a.png","width":20,"height":10,"fx":16,"fy":16,"cx":10,"cy":5,)"
                     R"("world_from_camera":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]{}}})",
                     name, more);
}

std::string cameras_file(const std::string& frames) {
  return R"({"format":"gld cameras 1","unit":"metres","frames":[)" + frames + "]}";
}

class HostileScene : public ::testing::Test {
 protected:
  HostileScene() { write_png(path() / "a.png", Image(20, 10)); }
  const std::filesystem::path& path() const { return folder_.path(); }
  void write(const std::string& name, const std::string& text) const {
    std::filesystem::create_directories((path() / name).parent_path());
    write_file_atomically(path() / name, text);
  }

  TemporaryFolder folder_;
};

TEST_F(HostileScene, DepthWithoutPixelsIsRefused) {
  write("cameras.json", cameras_file(camera_record("a", R"(,"depth":"d.npy")")));
  for (const std::vector<int64_t>& shape :
       {std::vector<int64_t>{0, 0}, std::vector<int64_t>{0, 48}, std::vector<int64_t>{48, 0, 1}}) {
    write_npy(path() / "d.npy", npy_from_floats(shape, nullptr));
    EXPECT_EQ(error_of([&] { open_scene(path()).frames.at(0).depth(); }),
              (path() / "d.npy").string() +
                  ": expected a size of 1x1 to 268 million pixels, each side at most 65535, found " +
                  fmt::format("{}x{}", shape[1], shape[0]) + "; check the file, or scale the picture down.");
  }
}

TEST_F(HostileScene, JsonAsDeepAsTheStackIsRefused) {
  const std::string deep(70'000, '['), closed(70'000, ']');
  write("cameras.json", cameras_file(R"({"name":)" + deep + closed + "}"));
  EXPECT_EQ(error_of([&] { open_scene(path()); }),
            (path() / "cameras.json").string() +
                ":1: expected JSON nested at most 64 deep, found more; check that it is the right file.");
  write("cameras.json", cameras_file(R"({"name":[[[1]]]})"));
  EXPECT_EQ(error_of([&] { open_scene(path()); }),
            (path() / "cameras.json").string() +
                " frame 0: expected a text as \"name\", found a list; correct the value.");
}

TEST_F(HostileScene, ACameraFileOfZerosIsNotUnpacked) {
  std::filesystem::create_directories(path() / "npz" / "images_4");
  write_png(path() / "npz" / "images_4" / "f.png", Image(20, 10));
  // 400 MB of zeros in 400 kB: enough to notice.
  NpyArray zeros;
  zeros.shape = {50'000'000, 1};
  zeros.dtype = DType::kFloat64;
  zeros.bytes.resize(400'000'000);
  std::map<std::string, std::string> entries;
  entries["intrinsic.npy"] = npy_text(zeros);
  zeros = NpyArray();
  entries["pose.npy"] = npy_text(npy_from_doubles({4, 4}, Eigen::Matrix4d::Identity().eval().data()));
  const auto file = path() / "npz" / "images_4" / "f.npz";
  write_zip(file, entries, ZipMethod::kDeflated);
  entries.clear();
  EXPECT_LT(std::filesystem::file_size(file), 1'000'000U);
  EXPECT_EQ(error_of([&] { open_scene(path() / "npz"); }),
            file.string() +
                ": array intrinsic: expected an array of at most 72 bytes, found 400000128; "
                "check that it is the right file.");
}

TEST_F(HostileScene, TwentyThousandFramesOfOneImageTakeNoTime) {
  std::string frames;
  for (int i = 0; i < 20'000; ++i) {
    frames +=
        (i == 0 ? "" : ",") +
        std::string(R"({"file_path":"a.png","transform_matrix":[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]})");
  }
  write("transforms.json", R"({"w":20,"h":10,"fl_x":16,"fl_y":16,"cx":10,"cy":5,"frames":[)" + frames + "]}");
  const std::clock_t start = std::clock();
  const Scene scene = open_scene(path());
  ASSERT_EQ(scene.frames.size(), 20'000U);
  EXPECT_EQ(scene.frames.back().name, "a_20000");
  // Of this process: 200 million comparisons of names took minutes.
  EXPECT_LT(std::clock() - start, 30 * CLOCKS_PER_SEC);
}

TEST_F(HostileScene, RawDepthIsNotAllocatedBeforeItsFileIsMeasured) {
  write("depth", "1234");
  expect_little_memory([&] {
    EXPECT_THAT(error_of([&] { read_depth_raw(path() / "depth", 100'000, 100'000); }),
                HasSubstr("expected a size of 1x1 to 268 million pixels"));
    EXPECT_EQ(error_of([&] { read_depth_raw(path() / "depth", 16'000, 16'000); }),
              (path() / "depth").string() +
                  ": expected 16000x16000 float32 values (1024000000 bytes), found 4 bytes; "
                  "check that depth and camera belong together.");
  });
}

TEST_F(HostileScene, LinesAreReadOneByOne) {
  std::filesystem::create_directories(path() / "sparse" / "0");
  std::filesystem::create_directories(path() / "images");
  write_png(path() / "images" / "a.png", Image(20, 10));
  write("sparse/0/cameras.txt", "1 PINHOLE 20 10 16 16 10 5\n" + std::string(4'000'000, '\n'));
  write("sparse/0/images.txt", "1 1 0 0 0 0 0 0 1 a.png\n\n");
  expect_little_memory([&] { EXPECT_EQ(open_scene(path()).frames.size(), 1U); });
  for (const char* size : {"-20 -10", "100000 100000", "0 0", "65536 65536"}) {
    write("sparse/0/cameras.txt", std::string("1 PINHOLE ") + size + " 16 16 10 5\n");
    EXPECT_THAT(error_of([&] { open_scene(path()); }),
                HasSubstr("expected a size of 1x1 to 268 million pixels, each side at most 65535"));
  }
}

TEST_F(HostileScene, CamerasThatSinglePrecisionCannotHoldAreRefused) {
  std::string far = cameras_file(camera_record("a", ""));
  const std::string identity = "[1,0,0,0]";
  far.replace(far.find(identity), identity.size(), "[1,0,0,1e150]");
  write("cameras.json", far);
  EXPECT_THAT(error_of([&] { open_scene(path()); }),
              HasSubstr("expected a camera within 1e+12 units of the origin, found one at 1e+150; "
                        "check the unit of the poses."));
}

TEST_F(HostileScene, NamesWithEscapesAreShownHarmless) {
  write("cameras.json", cameras_file(camera_record("a\\u001b[2J", "")));
  std::filesystem::remove(path() / "a.png");
  const std::string error = error_of([&] { open_scene(path()); });
  EXPECT_EQ(error.find('\x1b'), std::string::npos);
}

}  // namespace
}  // namespace gld
