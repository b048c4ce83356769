#include "infer/run_export/glb_file.h"

#include "infer/run_export/finished_run.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/infer/run_export/gltf_file.h"
#include "tests/support/error_of.h"
#include "tests/support/not_finite.h"
#include "tests/support/run_program.h"
#include "tests/support/temporary_folder.h"

#include <cmath>
#include <exception>
#include <optional>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest-spi.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::GltfFile;
using test::TemporaryFolder;

class GlbFile : public ::testing::Test {
 protected:
  GlbScene scene_of(const DrawnRun& drawn) {
    const auto place = folder_.path() / "run";
    test::write_drawn_run(place, drawn);
    const FinishedRun run = open_finished_run(place);
    GlbScene scene;
    if (!run.cloud.empty()) scene.cloud = read_ply(run.cloud).cloud;
    for (const RunView& view : run.views) {
      GlbView shown;
      shown.name = view.name;
      shown.target = view.target;
      shown.camera = view.camera;
      shown.png = read_file(view.image);
      if (view.has_depth()) shown.surface = depth_surface(view.depth_map(), view.depth_camera, {});
      scene.views.push_back(shown);
    }
    scene.provenance = {{"gld:model", "abc"}, {"gld:seed", "7"}};
    scene.typical_depth = 3;
    return scene;
  }
  GltfFile written(const GlbScene& scene) const {
    write_glb(file(), scene);
    return test::read_gltf(file());
  }
  std::filesystem::path file() const { return folder_.path() / "scene.glb"; }

  const TemporaryFolder folder_;
};

Eigen::Vector2d seen_at(const Camera& camera, const Eigen::Vector3d& x_in_world) {
  return (camera.intrinsics * (camera.camera_from_world() * x_in_world)).hnormalized();
}

// Where a camera of the file sees a point of it: by the K of its extras, and by glTF's own numbers where it has such.
struct SeenPoint {
  Eigen::Vector2d by_extras;
  std::optional<Eigen::Vector2d> by_gltf;
};

SeenPoint seen_in_file(const GltfFile& gltf, const nlohmann::json& node, const Eigen::Isometry3d& pose,
                       const Eigen::Vector3d& point) {
  const Eigen::Vector3d x = pose.inverse() * point;  // right, up, backwards
  const auto& k = node.at("extras");
  const double width = k.at("width"), height = k.at("height");
  SeenPoint seen;
  seen.by_extras = {k.at("fx").get<double>() * x.x() / -x.z() + k.at("cx").get<double>(),
                    k.at("fy").get<double>() * -x.y() / -x.z() + k.at("cy").get<double>()};
  if (!node.contains("camera")) return seen;
  const auto& camera = gltf.at("cameras", node.at("camera")).at("perspective");
  const double tangent = std::tan(0.5 * camera.at("yfov").get<double>());
  const double right = x.x() / -x.z() / (tangent * camera.at("aspectRatio").get<double>());
  const double up = x.y() / -x.z() / tangent;
  seen.by_gltf = Eigen::Vector2d(0.5 * width * (1 + right), 0.5 * height * (1 - up));
  return seen;
}

// All points of cloud and surfaces, through all cameras of the file, are where the run's cameras see them.
void expect_points_where_they_are(const GlbScene& scene, const GltfFile& gltf, bool gltf_cameras) {
  const auto poses = test::global_poses(gltf);
  const auto& cloud = gltf.node("cloud");
  const auto positions = test::accessor_values(
      gltf, gltf.at("meshes", cloud.at("mesh")).at("primitives")[0].at("attributes").at("POSITION"));
  ASSERT_EQ(positions.size(), scene.cloud.x_in_world.size());
  int64_t compared = 0;
  for (const GlbView& view : scene.views) {
    const auto& eye = gltf.node(view.name + " camera");
    EXPECT_EQ(eye.contains("camera"), gltf_cameras);
    const Eigen::Isometry3d pose = poses.at(view.name + " camera");
    for (size_t i = 0; i < positions.size(); i += 7) {
      const Eigen::Vector3d& x = scene.cloud.x_in_world[i];
      if ((view.camera.camera_from_world() * x).z() < 0.3) continue;
      const Eigen::Vector2d expected = seen_at(view.camera, x);
      if (expected.x() < 0 || expected.x() > 48 || expected.y() < 0 || expected.y() > 36) continue;
      const Eigen::Vector3d point =
          poses.at("cloud") * Eigen::Vector3d(positions[i][0], positions[i][1], positions[i][2]);
      const SeenPoint seen = seen_in_file(gltf, eye, pose, point);
      ASSERT_LT((seen.by_extras - expected).norm(), 0.01);
      if (seen.by_gltf) {
        ASSERT_LT((*seen.by_gltf - expected).norm(), 0.01);
      }
      ++compared;
    }
    // A vertex is where its texture is.
    const auto& primitive = gltf.at("meshes", gltf.node(view.name).at("mesh")).at("primitives")[0];
    const auto vertices = test::accessor_values(gltf, primitive.at("attributes").at("POSITION"));
    const auto texture = test::accessor_values(gltf, primitive.at("attributes").at("TEXCOORD_0"));
    for (size_t i = 0; i < vertices.size(); i += 5) {
      const Eigen::Vector3d point =
          poses.at(view.name) * Eigen::Vector3d(vertices[i][0], vertices[i][1], vertices[i][2]);
      const SeenPoint seen = seen_in_file(gltf, eye, pose, point);
      ASSERT_LT((seen.by_extras - Eigen::Vector2d(texture[i][0] * static_cast<double>(view.camera.width),
                                                  texture[i][1] * static_cast<double>(view.camera.height)))
                    .norm(),
                0.01);
      ++compared;
    }
  }
  EXPECT_GT(compared, 1000);
}

TEST_F(GlbFile, ShowsPointsThroughItsCameras) {
  const GlbScene scene = scene_of({});
  const GltfFile gltf = written(scene);
  test::expect_valid_gltf(gltf);
  expect_points_where_they_are(scene, gltf, true);
  EXPECT_EQ(gltf.count("nodes"), 2U + 2 * 4 + 1);
  EXPECT_EQ(gltf.count("images"), 4U);
  EXPECT_EQ(gltf.json.at("asset").at("extras").at("gld:model"), "abc");
  EXPECT_EQ(gltf.node("view_01 camera").at("extras").at("role"), "target");
  // Up is up: what lies higher in the picture is higher in the file.
  const auto poses = test::global_poses(gltf);
  EXPECT_EQ(poses.at("y_up").linear(), Eigen::Vector3d(1, -1, -1).asDiagonal().toDenseMatrix());
  // The picture is the run's file.
  const auto& view = gltf.at("bufferViews", gltf.at("images", 0).at("bufferView"));
  EXPECT_EQ(gltf.binary.substr(view.at("byteOffset"), view.at("byteLength")), scene.views[0].png);
}

// Returns whether expect_valid_gltf() would say something.
bool is_refused(const GltfFile& gltf) {
  ::testing::TestPartResultArray failures;
  const ::testing::ScopedFakeTestPartResultReporter reporter(
      ::testing::ScopedFakeTestPartResultReporter::INTERCEPT_ONLY_CURRENT_THREAD, &failures);
  try {
    test::expect_valid_gltf(gltf);
  } catch (const std::exception&) {  // of what has another type, or is not there
    return true;
  }
  return failures.size() > 0;
}

// What stands in for the JSON schema refuses what that refuses: one change of each kind that it knows.
TEST_F(GlbFile, IsHeldToTheSchema) {
  const GltfFile gltf = written(scene_of({}));
  ASSERT_FALSE(is_refused(gltf));
  const auto changes = nlohmann::json::parse(R"([
    ["/asset/version", "2"], ["/asset/generator", 3], ["/scene", 7], ["/scene", -1], ["/scene", 0.5],
    ["/scenes/0/nodes", []], ["/scenes/0/nodes", [0, 0]], ["/scenes", []], ["/extensionsUsed", []],
    ["/buffers/0/byteLength", 0], ["/buffers/0/uri", 1], ["/bufferViews/0/byteLength", 0],
    ["/bufferViews/0/byteOffset", -4], ["/bufferViews/0/byteStride", 256], ["/bufferViews/0/byteStride", 2],
    ["/bufferViews/0/buffer", -1], ["/bufferViews/0/target", "vertices"], ["/accessors/0/componentType", "float"],
    ["/accessors/0/count", 0], ["/accessors/0/type", 3], ["/accessors/0/normalized", 1], ["/accessors/0/min", []],
    ["/accessors/0/sparse", {}], ["/meshes/0/primitives", []], ["/meshes/0/name", 3],
    ["/meshes/0/primitives/0/attributes", {}], ["/meshes/0/primitives/0/attributes/POSITION", -1],
    ["/meshes/0/primitives/0/indices", 0.5], ["/meshes/0/primitives/0/mode", "points"],
    ["/meshes/0/primitives/0/targets", []], ["/materials/0/pbrMetallicRoughness/metallicFactor", 2],
    ["/materials/0/pbrMetallicRoughness/baseColorFactor", [1, 1, 1]],
    ["/materials/0/pbrMetallicRoughness/baseColorFactor", [1, 1, 1, 2]],
    ["/materials/0/pbrMetallicRoughness/baseColorTexture/index", -1],
    ["/materials/0/pbrMetallicRoughness/baseColorTexture/texCoord", -1], ["/materials/0/doubleSided", "yes"],
    ["/materials/0/extensions/KHR_materials_unlit", 3], ["/materials/0/alphaCutoff", 1],
    ["/samplers/0/wrapS", "clamp"], ["/samplers/0/minFilter", 9728.5], ["/textures/0/source", -1],
    ["/textures/0/sampler", "linear"], ["/images/0/uri", "a.png"], ["/images/0/bufferView", -1],
    ["/images/0/mimeType", 3], ["/cameras/0/type", 3], ["/cameras/0/orthographic", {}],
    ["/cameras/0/perspective/yfov", 0], ["/cameras/0/perspective/znear", 0], ["/cameras/0/perspective/zfar", 0],
    ["/cameras/0/perspective/aspectRatio", 0], ["/nodes/0/rotation", [1, 0, 0]], ["/nodes/0/rotation", [2, 0, 0, 0]],
    ["/nodes/2/translation", [0, 0]], ["/nodes/2/translation", ["0", 0, 0]], ["/nodes/1/children", []],
    ["/nodes/1/children", [2, 2]], ["/nodes/0/mesh", -1], ["/nodes/0/matrix", [1]], ["/nodes/0/skin", 0]])");
  for (const auto& change : changes) {
    GltfFile changed = gltf;
    changed.json[nlohmann::json::json_pointer(change[0].get<std::string>())] = change[1];
    EXPECT_TRUE(is_refused(changed)) << change;
  }
}

// Pixels that are not square are an aspect ratio to glTF; a principal point off the middle is nothing that it knows.
TEST_F(GlbFile, KeepsEveryK) {
  DrawnRun drawn;
  drawn.tall = 0.75;
  const GlbScene tall = scene_of(drawn);
  expect_points_where_they_are(tall, written(tall), true);
  drawn.cut = 5;
  const GlbScene off = scene_of(drawn);
  const GltfFile gltf = written(off);
  test::expect_valid_gltf(gltf);
  EXPECT_EQ(gltf.count("cameras"), 0U);
  expect_points_where_they_are(off, gltf, false);
}

// A scene in national coordinates: floats there are metres apart.
TEST_F(GlbFile, RecentresLargeCoordinates) {
  DrawnRun drawn;
  drawn.offset = Eigen::Vector3d(4.5e6, -5.2e5, 3e7);
  const GlbScene scene = scene_of(drawn);
  const Eigen::Vector3d origin = glb_origin(scene);
  EXPECT_LT((origin - drawn.offset).norm(), 20);
  const GltfFile gltf = written(scene);
  test::expect_valid_gltf(gltf);
  // Through the nodes above it the world is small, and the world's own node moves it to where cameras.json has it.
  const auto poses = test::global_poses(gltf);
  EXPECT_EQ(poses.at("world").translation(), Eigen::Vector3d::Zero());
  for (const GlbView& view : scene.views) {
    EXPECT_LT(poses.at(view.name).translation().norm(), 20);
    const Eigen::Vector3d back =
        (test::node_pose(gltf.node("world")) * test::node_pose(gltf.node(view.name))).translation();
    EXPECT_LT((back - view.camera.world_from_camera.translation()).norm(), 1e-7);
  }
  EXPECT_EQ(test::node_pose(gltf.node("recentred")).translation(), -origin);
  expect_points_where_they_are(scene, gltf, true);
  EXPECT_EQ(glb_origin(scene_of({})), Eigen::Vector3d::Zero());
  EXPECT_TRUE(written(scene_of({})).node("recentred").is_null());
}

// sRGB colours of points become linear ones (IEC 61966-2-1), of 65535.
TEST_F(GlbFile, HasLinearColours) {
  GlbScene scene = scene_of({});
  scene.cloud.colours[0] = {0, 128, 255};
  scene.cloud.colours[1] = {10, 11, 188};
  const GltfFile gltf = written(scene);
  const auto& primitive = gltf.at("meshes", gltf.node("cloud").at("mesh")).at("primitives")[0];
  EXPECT_EQ(primitive.at("mode"), 0);
  const auto colours = test::accessor_values(gltf, primitive.at("attributes").at("COLOR_0"));
  EXPECT_EQ(colours[0], (std::vector<double>{0, 14146, 65535, 65535}));
  EXPECT_EQ(colours[1], (std::vector<double>{199, 219, 32957, 65535}));
}

TEST_F(GlbFile, DoesWithoutPointsSurfacesOrViews) {
  DrawnRun single;
  single.views = 2;
  GlbScene scene = scene_of(single);
  scene.views.resize(1);
  test::expect_valid_gltf(written(scene));
  scene.cloud = PointCloud();
  const GltfFile without_cloud = written(scene);
  test::expect_valid_gltf(without_cloud);
  EXPECT_TRUE(without_cloud.node("cloud").is_null());
  EXPECT_EQ(without_cloud.count("meshes"), 1U);
  scene.views[0].surface = DepthSurface();
  const GltfFile camera_alone = written(scene);
  test::expect_valid_gltf(camera_alone);
  EXPECT_TRUE(camera_alone.binary.empty());
  EXPECT_EQ(camera_alone.count("cameras"), 1U);
  scene.views.clear();
  test::expect_valid_gltf(written(scene));
  EXPECT_EQ(glb_origin(scene), Eigen::Vector3d::Zero());
}

TEST_F(GlbFile, IsTheSameEachTime) {
  const GlbScene scene = scene_of({});
  write_glb(file(), scene);
  const std::string first = read_file(file());
  write_glb(file(), scene);
  EXPECT_EQ(read_file(file()), first);
}

TEST_F(GlbFile, RefusesInASentenceAndLeavesNothing) {
  GlbScene scene = scene_of({});
  scene.cloud.x_in_world[3].y() = test::kNan;
  EXPECT_EQ(test::error_of([&] { write_glb(file(), scene); }),
            "GLB file: expected finite points, found one that is not; check the depth and the cameras.");
  scene = scene_of({});
  scene.views[1].png.clear();
  EXPECT_EQ(
      test::error_of([&] { write_glb(file(), scene); }),
      "GLB file, view_01: expected a picture for its surface, found none; sample with --outputs image.");
  EXPECT_FALSE(std::filesystem::exists(file()));
}

// Returns the node of that name in Assimp's JSON, with its pose in the scene; matrices are row by row.
std::optional<Eigen::Matrix4d> assimp_pose(const nlohmann::json& node, const std::string& name,
                                           const Eigen::Matrix4d& above) {
  const auto values = node.at("transformation").get<std::vector<double>>();
  const Eigen::Matrix4d pose =
      above * Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(values.data());
  if (node.at("name") == name) return pose;
  if (!node.contains("children")) return std::nullopt;
  for (const auto& child : node.at("children")) {
    if (auto found = assimp_pose(child, name, pose)) return found;
  }
  return std::nullopt;
}

// Another reader finds the same: cameras, points and their colours, surfaces with their pictures. It prints six digits.
TEST_F(GlbFile, IsReadByAssimp) {
  for (const double far : {0.0, 4e6}) {
    DrawnRun drawn;
    drawn.offset = Eigen::Vector3d(far, 0, 0);
    const GlbScene scene = scene_of(drawn);
    write_glb(file(), scene);
    const auto json_file = folder_.path() / "scene.json";
    const auto run =
        test::run_program("assimp", {"export", file().string(), json_file.string(), "-fassjson"});
    ASSERT_EQ(run.status, 0) << run.text;
    const auto json = nlohmann::json::parse(read_file(json_file));
    EXPECT_EQ(json.at("cameras").size(), 4U);
    EXPECT_EQ(json.at("textures").size(), 4U);
    EXPECT_EQ(json.at("meshes").size(), 5U);
    const Eigen::Matrix4d top = Eigen::Matrix4d::Identity();
    const auto& root = json.at("rootnode");
    for (const auto& mesh : json.at("meshes")) {
      const auto vertices = mesh.at("vertices").get<std::vector<double>>();
      if (mesh.at("name") != "cloud") continue;
      ASSERT_EQ(vertices.size(), 3 * scene.cloud.x_in_world.size());
      const auto cloud = assimp_pose(root, "cloud", top);
      ASSERT_TRUE(cloud);
      for (const GlbView& view : scene.views) {
        const auto eye = assimp_pose(root, view.name + " camera", top);
        ASSERT_TRUE(eye);
        for (size_t i = 0; i < scene.cloud.x_in_world.size(); i += 11) {
          const Eigen::Vector3d& x = scene.cloud.x_in_world[i];
          if ((view.camera.camera_from_world() * x).z() < 0.3) continue;
          const Eigen::Vector4d point(vertices[3 * i], vertices[3 * i + 1], vertices[3 * i + 2], 1);
          const Eigen::Vector4d in_eye = eye->inverse() * (*cloud * point);
          const Eigen::Vector3d in_camera(in_eye.x(), -in_eye.y(), -in_eye.z());
          const Eigen::Vector2d expected = seen_at(view.camera, x);
          if (expected.x() < 0 || expected.x() > 48 || expected.y() < 0 || expected.y() > 36) continue;
          ASSERT_LT(((view.camera.intrinsics * in_camera).hnormalized() - expected).norm(), 0.01);
        }
      }
    }
  }
}

}  // namespace
}  // namespace gld
