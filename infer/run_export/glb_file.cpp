#include "infer/run_export/glb_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <tiny_gltf.h>

namespace gld {
namespace {

constexpr const char* kUnlit = "KHR_materials_unlit";
constexpr double kFloatRounding = 1.0 / (1 << 24);
constexpr double kLargestRounding = 1e-6;  // over the scene's size
// A principal point may be so many pixels from the middle for glTF's cameras, which have none, to be right.
constexpr double kMiddle = 1e-3;
constexpr double kNearest = 1e-2, kFarthest = 1e2;  // typical depths, where viewers clip

struct Box {
  Eigen::Vector3d low = Eigen::Vector3d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector3d high = -low;
  void add(const Eigen::Vector3d& x) {
    low = low.cwiseMin(x);
    high = high.cwiseMax(x);
  }
};

std::vector<double> numbers(const Eigen::Vector3d& vector) { return {vector.x(), vector.y(), vector.z()}; }

std::vector<double> numbers(const Eigen::Quaterniond& rotation) {
  const Eigen::Quaterniond q = rotation.normalized();
  return {q.x(), q.y(), q.z(), q.w()};
}

// Returns the linear light of an 8-bit sRGB value, of 65535 (IEC 61966-2-1).
std::array<uint16_t, 256> linear_values() {
  std::array<uint16_t, 256> table{};
  for (size_t i = 0; i < table.size(); ++i) {
    const double value = static_cast<double>(i) / 255;
    const double linear = value <= 0.04045 ? value / 12.92 : std::pow((value + 0.055) / 1.055, 2.4);
    table[i] = static_cast<uint16_t>(std::lround(65535 * linear));
  }
  return table;
}

class GlbMaker {
 public:
  explicit GlbMaker(const GlbScene& scene) : scene_(scene), origin_(glb_origin(scene)) {}

  tinygltf::Model make() {
    model_.asset.version = "2.0";
    model_.asset.generator = program_version();
    tinygltf::Value::Object texts;
    for (const auto& [name, text] : scene_.provenance) texts[name] = tinygltf::Value(text);
    if (!texts.empty()) model_.asset.extras = tinygltf::Value(texts);
    const int world = add_frames();
    for (const GlbView& view : scene_.views) add_view(view, world);
    if (scene_.cloud.size() > 0) add_cloud(world);
    if (!model_.materials.empty()) model_.extensionsUsed.emplace_back(kUnlit);
    if (!bytes_.empty()) {
      model_.buffers.emplace_back();
      model_.buffers.back().data = std::move(bytes_);
    }
    return std::move(model_);
  }

 private:
  int add_node(tinygltf::Node node, int parent) {
    const auto number = static_cast<int>(model_.nodes.size());
    model_.nodes.push_back(std::move(node));
    if (parent >= 0) model_.nodes[static_cast<size_t>(parent)].children.push_back(number);
    return number;
  }

  // Adds the nodes above the world; returns the world's.
  int add_frames() {
    tinygltf::Node turned;
    turned.name = "y_up";
    turned.rotation = {1, 0, 0, 0};  // half a turn about x: y and z change their signs
    int parent = add_node(turned, -1);
    tinygltf::Node world;
    world.name = "world";
    if (!origin_.isZero(0)) {
      tinygltf::Node recentred;
      recentred.name = "recentred";
      recentred.translation = numbers(Eigen::Vector3d(-origin_));
      parent = add_node(recentred, parent);
      world.translation = numbers(origin_);
    }
    tinygltf::Scene scene;
    scene.nodes = {0};
    model_.scenes.push_back(scene);
    model_.defaultScene = 0;
    return add_node(world, parent);
  }

  int add_bytes(const void* data, size_t size, int target) {
    constexpr size_t kAlignment = 4, kLargest = std::numeric_limits<int32_t>::max();
    if (size > kLargest - bytes_.size() - kAlignment) {
      fail({"GLB file", "less than 2 GiB", "more", "choose a smaller --surface-vertices or --max-points"});
    }
    tinygltf::BufferView view;
    view.buffer = 0;
    view.byteOffset = bytes_.size();
    view.byteLength = size;
    view.target = target;
    bytes_.resize((bytes_.size() + size + kAlignment - 1) / kAlignment * kAlignment);
    std::memcpy(bytes_.data() + view.byteOffset, data, size);
    model_.bufferViews.push_back(view);
    return static_cast<int>(model_.bufferViews.size()) - 1;
  }

  int add_accessor(int buffer_view, int component, int type, size_t count) {
    tinygltf::Accessor accessor;
    accessor.bufferView = buffer_view;
    accessor.componentType = component;
    accessor.type = type;
    accessor.count = count;
    model_.accessors.push_back(accessor);
    return static_cast<int>(model_.accessors.size()) - 1;
  }

  int add_positions(const std::vector<Eigen::Vector3f>& positions) {
    Eigen::Vector3f low = positions.front(), high = low;
    for (const Eigen::Vector3f& x : positions) {
      if (!x.allFinite()) {
        fail({"GLB file", "finite points", "one that is not", "check the depth and the cameras"});
      }
      low = low.cwiseMin(x);
      high = high.cwiseMax(x);
    }
    const int accessor = add_accessor(
        add_bytes(positions.data(), positions.size() * sizeof(Eigen::Vector3f), TINYGLTF_TARGET_ARRAY_BUFFER),
        TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC3, positions.size());
    auto& written = model_.accessors[static_cast<size_t>(accessor)];
    written.minValues = numbers(Eigen::Vector3d(low.cast<double>()));
    written.maxValues = numbers(Eigen::Vector3d(high.cast<double>()));
    return accessor;
  }

  int add_material(const std::string& name, int texture) {
    tinygltf::Material material;
    material.name = name;
    material.doubleSided = true;
    // For viewers that do not know unlit materials.
    material.pbrMetallicRoughness.metallicFactor = 0;
    material.pbrMetallicRoughness.baseColorTexture.index = texture;
    material.extensions[kUnlit] = tinygltf::Value(tinygltf::Value::Object());
    model_.materials.push_back(material);
    return static_cast<int>(model_.materials.size()) - 1;
  }

  int add_texture(const GlbView& view) {
    if (model_.samplers.empty()) {
      tinygltf::Sampler sampler;
      sampler.magFilter = TINYGLTF_TEXTURE_FILTER_LINEAR;
      sampler.minFilter = TINYGLTF_TEXTURE_FILTER_LINEAR_MIPMAP_LINEAR;
      sampler.wrapS = sampler.wrapT = TINYGLTF_TEXTURE_WRAP_CLAMP_TO_EDGE;
      model_.samplers.push_back(sampler);
    }
    tinygltf::Image image;
    image.name = view.name;
    image.mimeType = "image/png";
    image.bufferView = add_bytes(view.png.data(), view.png.size(), 0);
    model_.images.push_back(image);
    tinygltf::Texture texture;
    texture.sampler = 0;
    texture.source = static_cast<int>(model_.images.size()) - 1;
    model_.textures.push_back(texture);
    return static_cast<int>(model_.textures.size()) - 1;
  }

  int add_mesh(const std::string& name, const tinygltf::Primitive& primitive) {
    tinygltf::Mesh mesh;
    mesh.name = name;
    mesh.primitives.push_back(primitive);
    model_.meshes.push_back(mesh);
    return static_cast<int>(model_.meshes.size()) - 1;
  }

  int add_surface(const GlbView& view) {
    if (view.png.empty()) {
      fail({"GLB file, " + view.name, "a picture for its surface", "none", "sample with --outputs image"});
    }
    const DepthSurface& surface = view.surface;
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_TRIANGLES;
    primitive.attributes["POSITION"] = add_positions(surface.x_in_camera);
    primitive.attributes["TEXCOORD_0"] =
        add_accessor(add_bytes(surface.texture.data(), surface.texture.size() * sizeof(Eigen::Vector2f),
                               TINYGLTF_TARGET_ARRAY_BUFFER),
                     TINYGLTF_COMPONENT_TYPE_FLOAT, TINYGLTF_TYPE_VEC2, surface.texture.size());
    primitive.indices =
        add_accessor(add_bytes(surface.corners.data(), surface.corners.size() * sizeof(uint32_t),
                               TINYGLTF_TARGET_ELEMENT_ARRAY_BUFFER),
                     TINYGLTF_COMPONENT_TYPE_UNSIGNED_INT, TINYGLTF_TYPE_SCALAR, surface.corners.size());
    primitive.material = add_material(view.name, add_texture(view));
    return add_mesh(view.name, primitive);
  }

  // Returns -1 where glTF's cameras cannot say what this one does.
  int add_camera(const GlbView& view) {
    const Eigen::Matrix3d& k = view.camera.intrinsics;
    const auto width = static_cast<double>(view.camera.width);
    const auto height = static_cast<double>(view.camera.height);
    if (std::abs(k(0, 2) - 0.5 * width) > kMiddle || std::abs(k(1, 2) - 0.5 * height) > kMiddle) return -1;
    tinygltf::Camera camera;
    camera.name = view.name;
    camera.type = "perspective";
    camera.perspective.yfov = 2 * std::atan(0.5 * height / k(1, 1));
    // Of the picture plane at distance 1: pixels need not be square.
    camera.perspective.aspectRatio = (width / k(0, 0)) / (height / k(1, 1));
    camera.perspective.znear = kNearest * scene_.typical_depth;
    camera.perspective.zfar = kFarthest * scene_.typical_depth;
    model_.cameras.push_back(camera);
    return static_cast<int>(model_.cameras.size()) - 1;
  }

  void add_view(const GlbView& view, int world) {
    tinygltf::Node node;
    node.name = view.name;
    node.rotation = numbers(Eigen::Quaterniond(view.camera.world_from_camera.linear()));
    node.translation = numbers(Eigen::Vector3d(view.camera.world_from_camera.translation() - origin_));
    if (!view.surface.empty()) node.mesh = add_surface(view);
    const int pose = add_node(node, world);
    const Eigen::Matrix3d& k = view.camera.intrinsics;
    tinygltf::Value::Object extras;
    extras["role"] = tinygltf::Value(std::string(view.target ? "target" : "source"));
    extras["width"] = tinygltf::Value(static_cast<int>(view.camera.width));
    extras["height"] = tinygltf::Value(static_cast<int>(view.camera.height));
    extras["fx"] = tinygltf::Value(k(0, 0));
    extras["fy"] = tinygltf::Value(k(1, 1));
    extras["cx"] = tinygltf::Value(k(0, 2));
    extras["cy"] = tinygltf::Value(k(1, 2));
    tinygltf::Node eye;
    eye.name = view.name + " camera";
    eye.rotation = {1, 0, 0, 0};  // glTF's cameras look along -z with y up
    eye.camera = add_camera(view);
    eye.extras = tinygltf::Value(extras);
    add_node(eye, pose);
  }

  void add_cloud(int world) {
    const PointCloud& cloud = scene_.cloud;
    static const std::array<uint16_t, 256> kLinear = linear_values();
    std::vector<Eigen::Vector3f> positions;
    std::vector<std::array<uint16_t, 4>> colours;
    for (size_t i = 0; i < cloud.x_in_world.size(); ++i) {
      positions.emplace_back((cloud.x_in_world[i] - origin_).cast<float>());
      const Rgb& rgb = cloud.colours[i];
      colours.push_back({kLinear[rgb[0]], kLinear[rgb[1]], kLinear[rgb[2]], 65535});
    }
    tinygltf::Primitive primitive;
    primitive.mode = TINYGLTF_MODE_POINTS;
    primitive.attributes["POSITION"] = add_positions(positions);
    const int colour = add_accessor(
        add_bytes(colours.data(), colours.size() * sizeof(colours.front()), TINYGLTF_TARGET_ARRAY_BUFFER),
        TINYGLTF_COMPONENT_TYPE_UNSIGNED_SHORT, TINYGLTF_TYPE_VEC4, colours.size());
    model_.accessors[static_cast<size_t>(colour)].normalized = true;
    primitive.attributes["COLOR_0"] = colour;
    primitive.material = add_material("cloud", -1);
    tinygltf::Node node;
    node.name = "cloud";
    node.mesh = add_mesh("cloud", primitive);
    add_node(node, world);
  }

  const GlbScene& scene_;
  Eigen::Vector3d origin_;
  tinygltf::Model model_;
  std::vector<unsigned char> bytes_;
};

}  // namespace

Eigen::Vector3d glb_origin(const GlbScene& scene) {
  Box box;
  for (const GlbView& view : scene.views) {
    box.add(view.camera.world_from_camera.translation());
    for (const Eigen::Vector3f& x : view.surface.x_in_camera)
      box.add(view.camera.world_from_camera * x.cast<double>());
  }
  for (const Eigen::Vector3d& x : scene.cloud.x_in_world) box.add(x);
  const double largest = std::max(box.low.cwiseAbs().maxCoeff(), box.high.cwiseAbs().maxCoeff());
  if (!std::isfinite(largest)) return Eigen::Vector3d::Zero();  // nothing there
  const double size = (box.high - box.low).norm();
  if (largest * kFloatRounding <= kLargestRounding * size) return Eigen::Vector3d::Zero();
  // A float, so that viewers that compute in floats move it there and back without a rest.
  return (0.5 * (box.low + box.high)).cast<float>().cast<double>();
}

void write_glb(const std::filesystem::path& file, const GlbScene& scene) {
  const tinygltf::Model model = GlbMaker(scene).make();
  AtomicFile written(file);
  std::ofstream stream(written.temporary(), std::ios::binary);
  tinygltf::TinyGLTF library;
  const bool done = library.WriteGltfSceneToStream(&model, stream, false, true);
  stream.close();
  if (!done || !stream) {
    fail({file.string(), "to write the file", "an error of the file system", "check that the disk has room"});
  }
  written.commit();
}

}  // namespace gld
