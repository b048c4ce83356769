// Scenes are written with the usual mistakes, and the check must name each of them, and nothing in a right scene.
#include "datasets/check/data_check.h"

#include "datasets/formats/json_file.h"
#include "datasets/formats/scene_writer.h"
#include "datasets/images/image_file.h"
#include "datasets/pictures/camera_layout_picture.h"
#include "datasets/scenes/frame_checks.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/real_scenes.h"
#include "tests/support/temporary_folder.h"

#include <functional>
#include <map>
#include <memory>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::TemporaryFolder;
using ::testing::HasSubstr;
using ::testing::StartsWith;

// Drawn once: every check asks for the same pixels many times.
Scene drawn(Scene scene) {
  for (Frame& frame : scene.frames) {
    const auto image = std::make_shared<const Image>(frame.image());
    const auto depth = std::make_shared<const DepthMap>(frame.depth());
    frame.load_image = [image] { return *image; };
    frame.load_depth = [depth] { return *depth; };
  }
  return scene;
}

Scene rendered_scene(int64_t index) {
  static std::map<int64_t, Scene> scenes;
  const auto known = scenes.find(index);
  if (known != scenes.end()) return known->second;
  SyntheticOptions options;
  options.frames = 12;
  options.width = 200;
  options.height = 150;
  options.seed = 5;
  return scenes[index] = drawn(make_synthetic_scene(options, index));
}

Scene without_depth(Scene scene) {
  for (Frame& frame : scene.frames) frame.load_depth = nullptr;
  return scene;
}

Scene with_poses(Scene scene, const std::function<Eigen::Isometry3d(const Eigen::Isometry3d&)>& change) {
  for (Frame& frame : scene.frames) frame.camera.world_from_camera = change(frame.camera.world_from_camera);
  return scene;
}

TEST(DataCheck, FindsNothingInRightScenes) {
  for (int64_t index = 0; index < 2; ++index) {
    for (const Scene& scene : {rendered_scene(index), without_depth(rendered_scene(index))}) {
      const DataCheck check = check_scene(scene, {});
      EXPECT_TRUE(check.problems.empty()) << check.problems.front();
      EXPECT_EQ(check.frames, 12);
      EXPECT_GT(check.mean_overlap, 0.6);
      EXPECT_GT(check.poses.evidence[0].agreement, 0.5) << check.poses.method;
      EXPECT_NEAR(check.width.low, 200, 1e-9);
      EXPECT_GT(check.median_step, 0.01);
    }
  }
  const DataCheck check = check_scene(rendered_scene(0), {});
  EXPECT_EQ(check.frames_with_depth, 12);
  EXPECT_GT(check.depth.low, 0.2);
  EXPECT_LT(check.depth.high, 12);
}

TEST(DataCheck, NamesOpenGlAndInvertedPoses) {
  const auto open_gl = [](const Eigen::Isometry3d& pose) { return opencv_from_opengl_pose(pose); };
  const auto inverse = [](const Eigen::Isometry3d& pose) { return pose.inverse(); };
  const auto both = [](const Eigen::Isometry3d& pose) { return opencv_from_opengl_pose(pose).inverse(); };
  for (int64_t index = 0; index < 2; ++index) {
    for (const Scene& scene : {rendered_scene(index), without_depth(rendered_scene(index))}) {
      const DataCheck turned = check_scene(with_poses(scene, open_gl), {});
      ASSERT_EQ(turned.problems.size(), 1U) << index << " " << turned.poses.method;
      EXPECT_THAT(turned.problems[0], StartsWith("The poses look like world_from_camera with OpenGL axes: "));
      const DataCheck inverted = check_scene(with_poses(scene, inverse), {});
      ASSERT_EQ(inverted.problems.size(), 1U) << index << " " << inverted.poses.method;
      EXPECT_THAT(inverted.problems[0],
                  StartsWith("The poses look like camera_from_world with OpenCV axes: "));
      const DataCheck inverted_turned = check_scene(with_poses(scene, both), {});
      ASSERT_EQ(inverted_turned.problems.size(), 1U) << index << " " << inverted_turned.poses.method;
      EXPECT_THAT(inverted_turned.problems[0],
                  StartsWith("The poses look like camera_from_world with OpenGL axes: "));
      EXPECT_THAT(inverted_turned.problems[0], HasSubstr(" as read; convert them or choose another format."));
    }
  }
}

TEST(DataCheck, NamesNormalisedIntrinsics) {
  const TemporaryFolder folder;
  write_scene(rendered_scene(0), "nerfstudio", folder.path());
  nlohmann::json content = read_json_file(folder.path() / "transforms.json");
  for (auto& frame : content["frames"]) {
    for (const char* key : {"fl_x", "cx"}) frame[key] = frame[key].get<double>() / 200;
    for (const char* key : {"fl_y", "cy"}) frame[key] = frame[key].get<double>() / 150;
  }
  write_file_atomically(folder.path() / "transforms.json", content.dump());
  const DataCheck check = check_scene(SceneLocation{folder.path(), ""}, {});
  ASSERT_EQ(check.problems.size(), 1U);
  EXPECT_THAT(check.problems[0], HasSubstr("expected intrinsics in pixels"));
  EXPECT_THAT(check.problems[0],
              HasSubstr("for an image 200 pixels wide, which look divided by the image size"));
}

TEST(DataCheck, SaysWhereLinksLead) {
  const TemporaryFolder folder, elsewhere;
  write_scene(rendered_scene(0), "nerfstudio", folder.path() / "scene");
  const auto images = folder.path() / "scene" / "images";
  const auto first = std::filesystem::directory_iterator(images)->path();
  std::filesystem::rename(first, elsewhere.path() / "picture.png");
  std::filesystem::create_symlink(elsewhere.path() / "picture.png", first);
  const DataCheck check = check_scene(SceneLocation{folder.path() / "scene", ""}, {});
  EXPECT_THAT(check.notes,
              testing::Contains(testing::AllOf(
                  HasSubstr("1 of "), HasSubstr("are links to places outside the scene's folder, which are "
                                                "followed: " +
                                                first.string() + " is "))));
}

// The smallest EXIF segment that asks for a quarter turn.
void ask_for_rotation(const std::filesystem::path& jpeg) {
  const std::string bytes = read_file(jpeg);
  const std::string body =
      std::string("Exif\0\0MM\0\x2A\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0", 32);
  const std::string segment = std::string("\xFF\xE1\0\x22", 4) + body;
  write_file_atomically(jpeg, bytes.substr(0, 2) + segment + bytes.substr(2));
}

class ExifScene : public ::testing::Test {
 protected:
  // Images are stored lying and marked to be turned upright; the cameras are as `width` x `height` say.
  DataCheck check(int64_t width, int64_t height, double cx, double cy) {
    std::filesystem::create_directories(folder_.path() / "images");
    nlohmann::json content;
    const Scene scene = rendered_scene(0);
    for (const Frame& frame : scene.frames) {
      const std::string name = "images/" + frame.name + ".jpg";
      write_jpeg(folder_.path() / name, frame.image(), 95);
      ask_for_rotation(folder_.path() / name);
      content["frames"].push_back(
          {{"file_path", name}, {"transform_matrix", pose_to_json(frame.camera.world_from_camera.matrix())}});
    }
    content["w"] = width;
    content["h"] = height;
    content["fl_x"] = content["fl_y"] = 180;
    content["cx"] = cx;
    content["cy"] = cy;
    write_file_atomically(folder_.path() / "transforms.json", content.dump());
    return check_scene(SceneLocation{folder_.path(), ""}, {});
  }
  TemporaryFolder folder_;
};

TEST_F(ExifScene, CamerasOfUprightImagesAreServed) {
  const DataCheck found = check(150, 200, 75, 100);
  EXPECT_EQ(found.turned_images, 12);
  EXPECT_EQ(found.width.low, 150);
  EXPECT_EQ(found.notes[0],
            "12 of 12 images ask for a rotation by EXIF (orientation 6): "
            "frame_00011.jpg is stored as 200x150 and the camera is 150x200, so the rotation is applied.");
}

TEST_F(ExifScene, CamerasOfStoredImagesAreServed) {
  const DataCheck found = check(200, 150, 100, 75);
  EXPECT_EQ(found.width.low, 200);
  EXPECT_THAT(found.notes[0], HasSubstr("so the rotation is ignored."));
}

TEST_F(ExifScene, TurnedIntrinsicsAreNamed) {
  const DataCheck found = check(200, 150, 75, 100);
  ASSERT_EQ(found.problems.size(), 1U);
  EXPECT_EQ(found.problems[0],
            "The intrinsics seem to belong to images turned by a quarter: "
            "the principal point (75.0, 100.0) is the middle of 150x200, not of 200x150; "
            "rotate the images (EXIF) or the intrinsics.");
}

TEST(DataCheck, NamesOutliersStandstillAndDamage) {
  Scene far = rendered_scene(0);
  far.frames[3].camera.world_from_camera.translation().x() = 500;
  const DataCheck outlier = check_scene(far, {});
  ASSERT_FALSE(outlier.problems.empty());
  EXPECT_THAT(outlier.problems[0], StartsWith("1 of 12 cameras are farther from the origin than 100"));

  const DataCheck still = check_scene(with_poses(rendered_scene(0),
                                                 [](const Eigen::Isometry3d& pose) {
                                                   Eigen::Isometry3d fixed = pose;
                                                   fixed.translation().setZero();
                                                   return fixed;
                                                 }),
                                      {});
  ASSERT_EQ(still.problems.size(), 1U);
  EXPECT_EQ(still.problems[0],
            "All cameras are at the same place: without parallax there is no geometry to learn.");

  // Beyond those that are decoded first, the comparison of neighbours meets it.
  const TemporaryFolder folder;
  write_scene(without_depth(rendered_scene(0)), "cameras-json", folder.path() / "scene");
  const Scene written = open_scene(folder.path() / "scene");
  for (size_t i = 1; i < written.frames.size(); ++i) {
    const std::string whole = read_file(written.frames[i].image_file);
    write_file_atomically(
        written.frames[i].image_file,
        whole.substr(0, 200) + std::string(whole.size() - 212, 'x') + whole.substr(whole.size() - 12));
  }
  DataCheckOptions one;
  one.most_images = 1;
  const DataCheck beyond = check_scene(SceneLocation{folder.path() / "scene", ""}, one);
  EXPECT_EQ(beyond.format, "cameras-json");
  EXPECT_EQ(beyond.list.size(), 12U);
  ASSERT_FALSE(beyond.problems.empty());

  Scene damaged = rendered_scene(0);
  damaged.frames[0].load_image = [] { return Image(3, 3); };
  EXPECT_EQ(check_scene(damaged, {}).problems[0],
            "frame_00000: expected an image of the camera's size 200x150, found 3x3; "
            "check that the files belong together.");
}

TEST(DataCheck, RealScenesHaveNoMistakes) { test::expect_no_mistakes(test::test_data() / "scenes"); }

TEST(DataCheck, WritesReportAndPicture) {
  const TemporaryFolder folder;
  write_scene(rendered_scene(0), "cameras-json", folder.path() / "scenes" / "a");
  write_scene(with_poses(rendered_scene(1),
                         [](const Eigen::Isometry3d& pose) { return opencv_from_opengl_pose(pose); }),
              "cameras-json", folder.path() / "scenes" / "b");
  DataCheckOptions options;
  options.out = (folder.path() / "run").string();
  EXPECT_EQ(run_data_check(folder.path() / "scenes", options), 1);
  const nlohmann::json report = read_json_file(folder.path() / "run" / "report.json");
  ASSERT_EQ(report["scenes"].size(), 2U);
  EXPECT_TRUE(report["scenes"][0]["problems"].empty());
  EXPECT_EQ(report["scenes"][1]["problems"].size(), 1U);
  const Image picture = read_image(folder.path() / "run" / "cameras_001.png");
  EXPECT_EQ(picture.width, 1200);
  int64_t coloured = 0;
  for (size_t i = 0; i < picture.rgb.size(); i += 3) coloured += picture.rgb[i] != picture.rgb[i + 2] ? 1 : 0;
  EXPECT_GT(coloured, 1000);
}

// What gld sample says about a scene, the check says too.
TEST(DataCheck, ABrokenFrameIsAMistakeAndShiftsTheNumbersBehindIt) {
  const TemporaryFolder folder;
  write_scene(rendered_scene(0), "cameras-json", folder.path() / "scene");
  const Scene whole = open_scene(folder.path() / "scene");
  write_file_atomically(whole.frames[3].image_file, "this is text");
  const DataCheck check = check_scene(SceneLocation{folder.path() / "scene", ""}, {});
  ASSERT_FALSE(check.problems.empty());
  EXPECT_THAT(check.problems[0], HasSubstr(whole.frames[3].image_file.filename().string()));
  EXPECT_THAT(check.notes,
              ::testing::Contains(StartsWith("Frame numbers count the frames that are there: from '" +
                                             whole.frames[4].name + "' on, which is number 3,")));
  ASSERT_EQ(check.list.size(), 11U);
  EXPECT_EQ(check.list[3].name, whole.frames[4].name);
  EXPECT_EQ(check.list[3].width, 200);
  const std::string text = data_check_text(check);
  EXPECT_THAT(
      text, HasSubstr("\n  frames by name 0 " + whole.frames[0].name + ", 1 " + whole.frames[1].name + ", "));
  EXPECT_THAT(text, HasSubstr(", 3 " + whole.frames[4].name + ","));
  EXPECT_THAT(text, HasSubstr("10 " + whole.frames[11].name + "\n"));
}

TEST(DataCheck, AFolderWithASceneIsThatScene) {
  const TemporaryFolder folder;
  write_scene(rendered_scene(0), "cameras-json", folder.path() / "parent" / "scene");
  EXPECT_EQ(open_scene(folder.path() / "parent").frames.size(), 12U);
}

// A scene of which no image is decoded is checked too, as far as its files tell.
TEST(DataCheck, ACutImageIsFoundInEveryScene) {
  const TemporaryFolder folder;
  for (const char* name : {"a", "b", "c", "d"}) {
    write_scene(rendered_scene(0), "cameras-json", folder.path() / "scenes" / name);
  }
  const auto cut = open_scene(folder.path() / "scenes" / "d").frames[7].image_file;
  std::filesystem::resize_file(cut, std::filesystem::file_size(cut) - 20);
  DataCheckOptions options;
  options.most_scenes = 1;
  options.most_images = 1;
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  EXPECT_EQ(run_data_check(folder.path() / "scenes", options), 1);
  const std::string text = ::testing::internal::GetCapturedStdout();
  EXPECT_THAT(text, HasSubstr("PROBLEM        " + cut.string() + ": expected a whole image file"));
  EXPECT_THAT(text,
              HasSubstr("decoded        0 of 12 images (--most-scenes); of 12 files the header and the end"));
  EXPECT_THAT(text,
              HasSubstr("4 scenes were checked: 1 to their pixels (--most-scenes 4 takes all), 3 by their "
                        "cameras and the headers and ends of their 36 image files\n"));
  EXPECT_THAT(::testing::internal::GetCapturedStderr(),
              HasSubstr("warning: 1 of 4 scenes has problems: d\n"));
  // And where images are decoded, it finds those that are not.
  const DataCheck check = check_scene(SceneLocation{folder.path() / "scenes" / "d", ""}, options);
  ASSERT_EQ(check.problems.size(), 1U);
  EXPECT_THAT(check.problems[0], StartsWith(cut.string()));
}

TEST(DataCheck, SaysWhichScenesItDidNotDecode) {
  const TemporaryFolder folder;
  for (const char* name : {"a", "b", "c"}) {
    write_scene(rendered_scene(0), "cameras-json", folder.path() / "scenes" / name);
  }
  DataCheckOptions options;
  options.most_scenes = 2;
  options.most_images = 1;
  ::testing::internal::CaptureStdout();
  EXPECT_EQ(run_data_check(folder.path() / "scenes", options), 0);
  const std::string text = ::testing::internal::GetCapturedStdout();
  EXPECT_THAT(text, HasSubstr("3 scenes were checked: 2 to their pixels (--most-scenes 3 takes all), 1 by "));
  EXPECT_THAT(text, HasSubstr("1 of 12 images (--most-images)"));
  options.json = true;
  ::testing::internal::CaptureStdout();
  run_data_check(folder.path() / "scenes", options);
  EXPECT_EQ(nlohmann::json::parse(::testing::internal::GetCapturedStdout()).at("scenes_found"), 3);
}

}  // namespace
}  // namespace gld
