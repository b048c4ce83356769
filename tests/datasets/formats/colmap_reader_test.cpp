#include "datasets/formats/colmap_reader.h"

#include "datasets/formats/colmap_binary.h"
#include "datasets/formats/colmap_model.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/scenes/seeded_random.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/real_scenes.h"
#include "tests/support/temporary_folder.h"

#include <Eigen/Geometry>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using test::test_data;

TEST(Colmap, RealTextEqualsBinary) {
  test::expect_colmap_text_equals_binary(test_data() / "scenes", {3, 600});
}

// The photographs are copies at half the size that the model was made for.
TEST(Colmap, TheRealSceneProjectsItsPointsIntoItsImages) {
  const Scene scene =
      test::expect_colmap_points_inside(test_data() / "scenes" / "colmap_lund_door", {3, 600}, 600);
  EXPECT_EQ(scene.frames[2].name, "DSC_0010");
  EXPECT_EQ(scene.frames[2].camera.width, 648);
  EXPECT_EQ(scene.frames[2].camera.height, 968);
}

class SmallColmap : public ::testing::Test {
 protected:
  SmallColmap() {
    SyntheticOptions options;
    options.frames = 3;
    options.width = 40;
    options.height = 30;
    scene_ = make_synthetic_scene(options, 0);
    scene_.points_in_world = {{0, 0, 1}};
  }
  std::filesystem::path model(const char* name) const { return folder_.path() / "sparse" / "0" / name; }
  std::string error() const {
    return error_of([&] { open_scene(folder_.path()); });
  }
  TemporaryFolder folder_;
  Scene scene_;
};

TEST_F(SmallColmap, DownscaledImagesScaleTheIntrinsics) {
  write_scene(scene_, "colmap", folder_.path());
  std::filesystem::create_directories(folder_.path() / "images_2");
  for (const Frame& frame : scene_.frames) {
    write_jpeg(folder_.path() / "images_2" / (frame.name + ".jpg"), Image(20, 15), 90);
  }
  SceneReading reading;
  reading.image_folder = "images_2";
  const Scene half = open_scene(folder_.path(), reading);
  ASSERT_EQ(half.frames.size(), 3U);
  EXPECT_EQ(half.frames[0].camera.width, 20);
  EXPECT_DOUBLE_EQ(half.frames[0].camera.intrinsics(0, 0), scene_.frames[0].camera.intrinsics(0, 0) / 2);
  EXPECT_DOUBLE_EQ(half.frames[0].camera.intrinsics(1, 2), 7.5);
  std::filesystem::remove_all(folder_.path() / "images");
  EXPECT_EQ(open_scene(folder_.path()).frames[0].camera.width, 20);  // Mip-NeRF 360 without the large images
  reading.image_folder = "images_8";
  EXPECT_EQ(error_of([&] { open_scene(folder_.path(), reading); }),
            (folder_.path() / "images_8").string() +
                ": expected a folder of images, found nothing; choose another --image-folder.");
}

TEST_F(SmallColmap, ImagesThatDoNotExistAreCounted) {
  write_scene(scene_, "colmap-text", folder_.path());
  std::filesystem::remove(folder_.path() / "images" / "frame_00001.png");
  const Scene read = open_scene(folder_.path());
  EXPECT_EQ(read.frames.size(), 2U);
  EXPECT_EQ(read.missing_files, 1);
  std::filesystem::remove_all(folder_.path() / "images");
  EXPECT_EQ(error(), folder_.path().string() +
                         ": expected a folder of images beside the model (images or images_N), found none; "
                         "put the images there, or name a folder inside the scene with --image-folder.");
}

// A text copy of the model beside the images, or the model's own folder.
TEST_F(SmallColmap, ModelsAreFoundInSparseTxtAndByTheirOwnFolder) {
  write_scene(scene_, "colmap-text", folder_.path());
  const auto text = folder_.path() / "sparse_txt";
  std::filesystem::rename(folder_.path() / "sparse" / "0", text);
  EXPECT_EQ(open_scene(folder_.path()).frames.size(), 3U);
  const Scene by_model = open_scene(text);
  EXPECT_EQ(by_model.frames.size(), 3U);
  EXPECT_EQ(by_model.folder, folder_.path());
  SceneReading reading;
  reading.image_folder = "images";
  EXPECT_EQ(open_scene(text.string() + "/", reading).frames.size(), 3U);
  std::filesystem::rename(folder_.path() / "images", folder_.path() / "photos");
  EXPECT_EQ(error_of([&] { open_scene(text); }),
            text.string() +
                ": expected a folder of images beside the model (images or images_N), found none; "
                "put the images there, or name a folder inside the scene with --image-folder.");
  reading.image_folder = "photos";
  EXPECT_EQ(open_scene(text, reading).frames.size(), 3U);
}

TEST_F(SmallColmap, ImagesOfAnotherShapeAreRefused) {
  write_scene(scene_, "colmap-text", folder_.path());
  write_png(folder_.path() / "images" / "frame_00001.png", Image(30, 40));
  EXPECT_EQ(error(),
            (folder_.path() / "images" / "frame_00001.png").string() +
                ": expected an image of the camera's size 40x30 or a scaled copy, found 30x40; "
                "check that the camera belongs to this image and was not made for a rotated or cropped one.");
}

TEST_F(SmallColmap, DamagedText) {
  write_scene(scene_, "colmap-text", folder_.path());
  write_file_atomically(model("cameras.txt"), "1 PINHOLE 40 30 20 20\n");
  EXPECT_NE(error().find("expected 4 parameters for PINHOLE, found 2; correct the file."), std::string::npos);
  write_file_atomically(model("cameras.txt"), "1 FOV 40 30 20 20 20 15 0.5\n");
  EXPECT_NE(error().find("expected a camera model such as PINHOLE, SIMPLE_RADIAL or OPENCV, found FOV; "
                         "undistort the images with COLMAP's image_undistorter."),
            std::string::npos);
  write_file_atomically(model("cameras.txt"), "1 PINHOLE 40\n");
  EXPECT_EQ(error(),
            model("cameras.txt").string() +
                ":1: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, found 3 fields; correct the file.");
  write_file_atomically(model("cameras.txt"), "7 PINHOLE 40 30 20 20 20 15\n");
  EXPECT_NE(error().find("expected camera 1 in the model, found none; export the model again."),
            std::string::npos);
  write_file_atomically(model("images.txt"), "1 1 0 0 0 0 0 0 1 a.png\n1 2 3\n2 1 0 0 0\n");
  EXPECT_EQ(error(), model("images.txt").string() +
                         ":3: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, found 5 fields; "
                         "check that every image has its line of observations.");
  write_file_atomically(model("images.txt"), "1 1 0 0 0 0 0 0 1 ../../etc/a.png\n\n");
  EXPECT_NE(error().find("expected a path inside the scene's folder, found \"../../etc/a.png\"; "
                         "make the path relative to the scene."),
            std::string::npos);
}

TEST_F(SmallColmap, BinaryCountsAreCheckedAgainstTheFile) {
  write_scene(scene_, "colmap", folder_.path());
  const std::string good = read_file(model("images.bin"));
  std::string bytes = good;
  bytes[6] = '\x7F';
  write_file_atomically(model("images.bin"), bytes);
  EXPECT_EQ(error(), model("images.bin").string() +
                         " at byte 8: expected a count that fits the file, found 35747322042253315 records; "
                         "copy the file again.");
  write_file_atomically(model("images.bin"), good.substr(0, good.size() - 4));
  EXPECT_NE(error().find("copy the file again."), std::string::npos);
  write_file_atomically(model("images.bin"), good + "more");
  EXPECT_NE(
      error().find("expected the end of the file, found 4 more bytes; check that it is a file of this kind."),
      std::string::npos);
}

// What images show of points is written in both forms, the binary one as read_colmap_sightings reads it.
TEST_F(SmallColmap, WritesWhereImagesShowPoints) {
  ColmapModel model;
  model.cameras[1] = {"PINHOLE", 8, 6, {7, 9, 3, 2.5}};
  for (const char* name : {"a.png", "b.png"}) {
    ColmapImage image;
    image.camera_id = 1;
    image.name = name;
    model.images.push_back(image);
  }
  model.points_in_world = {{1, 2, 3}, {4, 5, 6}, {7, 8, 9}};
  model.point_looks = {{{1, 2, 3}, 0.5}, {{4, 5, 255}, -1}, {{0, 0, 0}, 0}};
  model.images[0].sightings = {{2, {1.25, 3.5}}, {1, {0.1, 0.2}}};
  model.images[1].sightings = {{1, {7.75, 5}}};
  model.comments = {"made by\na test"};
  const auto text = folder_.path() / "text", binary = folder_.path() / "binary";
  for (const auto& path : {text, binary}) std::filesystem::create_directories(path);
  write_colmap_model(text, model, ColmapForm::kText);
  write_colmap_model(binary, model, ColmapForm::kBinary);
  EXPECT_EQ(read_file(text / "points3D.txt"),
            "# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n# made by a test\n"
            "1 1 2 3 1 2 3 0.5 1 1 2 0\n2 4 5 6 4 5 255 -1 1 0\n3 7 8 9 0 0 0 0\n");
  EXPECT_EQ(
      read_file(text / "images.txt"),
      "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as (X, Y, POINT3D_ID)\n"
      "# made by a test\n1 1 0 0 0 0 0 0 1 a.png\n1.25 3.5 2 0.1 0.2 1\n2 1 0 0 0 0 0 0 1 b.png\n7.75 5 1\n");
  const ColmapSightings read = read_colmap_sightings(binary);
  EXPECT_EQ(read.points_in_world.at(3), Eigen::Vector3d(7, 8, 9));
  ASSERT_EQ(read.images.at("a.png").size(), 2U);
  EXPECT_EQ(read.images.at("a.png")[0].point, 2U);
  EXPECT_EQ(read.images.at("a.png")[0].position, Eigen::Vector2d(1.25, 3.5));
  EXPECT_EQ(read.images.at("b.png")[0].position, Eigen::Vector2d(7.75, 5));
  for (const ColmapForm form : {ColmapForm::kText, ColmapForm::kBinary}) {
    const ColmapModel whole = read_colmap_model(form == ColmapForm::kText ? text : binary, form);
    EXPECT_EQ(whole.points_in_world, model.points_in_world);
    EXPECT_EQ(whole.images.size(), 2U);
  }
  model.images[0].sightings[0].point = 4;
  EXPECT_EQ(
      test::error_of([&] { write_colmap_model(text, model, ColmapForm::kText); }),
      "COLMAP model, image a.png: expected sightings of points 1 to 3, found 4; add the point or leave the "
      "sighting out.");
  model.images[0].sightings.clear();
  model.point_looks.pop_back();
  EXPECT_EQ(test::error_of([&] { write_colmap_model(text, model, ColmapForm::kText); }),
            "COLMAP model: expected 3 points with colours, found 2; give one a point, or none.");
}

// Random damage never crashes and either reads or gives our sentence.
TEST_F(SmallColmap, DamagedBinariesFailInWords) {
  write_scene(scene_, "colmap", folder_.path());
  SeededRandom random({2024});
  int64_t refused = 0;
  for (const char* name : {"cameras.bin", "images.bin", "points3D.bin"}) {
    const std::string good = read_file(model(name));
    for (int trial = 0; trial < 150; ++trial) {
      std::string bytes =
          good.substr(0, static_cast<size_t>(random.integer(0, static_cast<int64_t>(good.size()))));
      for (int flips = 0; flips < 3 && !bytes.empty(); ++flips) {
        bytes[static_cast<size_t>(random.integer(0, static_cast<int64_t>(bytes.size()) - 1))] =
            static_cast<char>(random.integer(0, 255));
      }
      write_file_atomically(model(name), bytes);
      try {
        read_colmap_model(folder_.path() / "sparse" / "0", ColmapForm::kBinary);
      } catch (const Error& error) {
        EXPECT_EQ(std::string(error.what()).find(model(name).string()), 0U);
        ++refused;
      }
    }
    write_file_atomically(model(name), good);
  }
  EXPECT_GT(refused, 300);
}

}  // namespace
}  // namespace gld
