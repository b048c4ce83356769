#include "datasets/formats/cameras_json.h"

#include "gld/base/atomic_file.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <limits>

#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld {
namespace {

CameraList two_cameras() {
  CameraList list;
  list.metric = true;
  for (int i = 0; i < 2; ++i) {
    CameraRecord record;
    record.name = i == 0 ? "view_00" : "view_01";
    record.role = i == 0 ? "source" : "target";
    record.image = "images/" + record.name + ".png";
    record.camera.width = 504;
    record.camera.height = 280;
    record.camera.intrinsics << 401.1, 0, 252 + 1.0 / 3, 0, 399.7, 140.25, 0, 0, 1;
    record.camera.world_from_camera.linear() =
        Eigen::AngleAxisd(0.1 + i, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
    record.camera.world_from_camera.translation() = Eigen::Vector3d(1e6 + 0.1, -1.0 / 7, 1e-9);
    list.records.push_back(record);
  }
  list.records[1].depth = "depth/view_01.png";
  list.records[1].depth_unit = 2e-05;
  return list;
}

TEST(CamerasJson, KeepsEveryBit) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "cameras.json";
  const CameraList written = two_cameras();
  write_cameras_json(file, written);
  const CameraList read = read_cameras_json(file);
  EXPECT_TRUE(read.metric);
  ASSERT_EQ(read.records.size(), 2U);
  for (size_t i = 0; i < 2; ++i) {
    const CameraRecord& a = written.records[i];
    const CameraRecord& b = read.records[i];
    EXPECT_EQ(b.name, a.name);
    EXPECT_EQ(b.role, a.role);
    EXPECT_EQ(b.image, a.image);
    EXPECT_EQ(b.depth, a.depth);
    EXPECT_EQ(b.depth_unit, a.depth_unit);
    EXPECT_EQ(b.camera.width, 504);
    EXPECT_EQ(b.camera.height, 280);
    EXPECT_EQ(b.camera.intrinsics, a.camera.intrinsics);
    EXPECT_EQ(b.camera.world_from_camera.matrix(), a.camera.world_from_camera.matrix());
  }
  write_cameras_json(folder.path() / "again.json", read);
  EXPECT_EQ(read_file(folder.path() / "again.json"), read_file(file));
}

// Returns what reading says after change has been made to a right file.
std::string refusal(const std::function<void(nlohmann::json&)>& change, const std::filesystem::path& file) {
  nlohmann::json root = nlohmann::json::parse(cameras_json_text(two_cameras()));
  change(root);
  write_file_atomically(file, root.dump());
  const std::string error = test::error_of([&] { read_cameras_json(file); });
  const std::string where = file.string();
  EXPECT_EQ(error.substr(0, where.size()), where);
  return error.substr(where.size());
}

TEST(CamerasJson, RefusesWhatIsWrongInOneSentence) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "cameras.json";
  using nlohmann::json;
  EXPECT_EQ(
      refusal([](json& root) { root["format"] = "other"; }, file),
      ": expected the format \"gld cameras 1\", found \"other\"; write the file as docs/FILES.md shows.");
  EXPECT_EQ(refusal([](json& root) { root.erase("format"); }, file),
            ": expected the key \"format\", found none; add it.");
  EXPECT_EQ(refusal([](json& root) { root["unit"] = "feet"; }, file),
            ": expected the unit metres or scene, found feet; correct it.");
  EXPECT_EQ(refusal([](json& root) { root["frames"] = json::array(); }, file),
            ": expected a list of at least one camera as \"frames\", found an empty list; add the cameras.");
  EXPECT_EQ(refusal([](json& root) { root["frames"] = 3; }, file),
            ": expected a list of at least one camera as \"frames\", found something else; add the cameras.");
  EXPECT_EQ(refusal([](json& root) { root = json::array(); }, file),
            ": expected a JSON object, found another JSON value; check the file.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][1]["name"] = "view_00"; }, file),
            " frame 1: expected a name of its own, found a second view_00; rename one of the two.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][0]["role"] = "both"; }, file),
            " frame 0: expected the role source or target, found both; correct it or leave it out.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][0]["fx"] = "wide"; }, file),
            " frame 0: expected a number as \"fx\", found \"wide\"; correct the value.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][0]["fx"] = -4; }, file),
            " frame 0: expected positive focal lengths, found fx -4 and fy 399.7; check the intrinsics.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][1].erase("world_from_camera"); }, file),
            " frame 1: expected the key \"world_from_camera\", found none; add it.");
  EXPECT_EQ(
      refusal(
          [](json& root) {
            root["frames"][1]["world_from_camera"][2] = json::array({1, 2});
          },
          file),
      " frame 1: expected a matrix of 3 or 4 rows of 4 numbers, found something else; correct the matrix.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][1]["depth_unit"] = 0; }, file),
            " frame 1: expected a positive \"depth_unit\", found 0; correct it.");
  EXPECT_EQ(refusal([](json& root) { root["frames"][1].erase("depth_unit"); }, file),
            " frame 1: expected the key \"depth_unit\", found none; add it.");
  write_file_atomically(file, "{\"format\": \"gld");
  EXPECT_EQ(test::error_of([&] { read_cameras_json(file); }),
            file.string() + ":1: expected JSON, found a syntax error; correct the file.");
}

TEST(CamerasJson, DoesNotWriteCamerasThatItWouldNotRead) {
  test::TemporaryFolder folder;
  const auto file = folder.path() / "cameras.json";
  CameraList list = two_cameras();
  list.records[1].camera.world_from_camera.translation()[0] = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(test::error_of([&] { write_cameras_json(file, list); }),
            file.string() +
                " view_01: expected a finite pose, found a value that is not a number or infinite; "
                "leave the frame out.");
  EXPECT_FALSE(std::filesystem::exists(file));
}

}  // namespace
}  // namespace gld
