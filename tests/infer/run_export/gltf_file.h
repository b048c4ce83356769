#pragma once

#include "gld/base/atomic_file.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <limits>
#include <map>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace gld::test {

// A binary glTF file as the specification says it is read, and what it may not be (glTF 2.0, chapters 3 and 4).
// NOLINTNEXTLINE(bugprone-exception-escape): moving JSON throws nothing, whatever clang thinks
struct GltfFile {
  nlohmann::json json;
  std::string binary;

  const nlohmann::json& at(const char* list, size_t number) const { return json.at(list).at(number); }
  size_t count(const char* list) const { return json.contains(list) ? json.at(list).size() : 0; }
  const nlohmann::json& node(const std::string& name) const {
    for (const auto& candidate : json.at("nodes")) {
      if (candidate.value("name", "") == name) return candidate;
    }
    static const nlohmann::json kNone;
    return kNone;
  }
};

inline uint32_t word_at(const std::string& bytes, size_t at) {
  uint32_t value = 0;
  std::memcpy(&value, bytes.data() + at, 4);
  return value;
}

inline GltfFile read_gltf(const std::filesystem::path& file) {
  GltfFile result;
  const std::string bytes = read_file(file);
  EXPECT_EQ(bytes.substr(0, 4), "glTF");
  EXPECT_EQ(word_at(bytes, 4), 2U);
  EXPECT_EQ(word_at(bytes, 8), bytes.size());
  const uint32_t length = word_at(bytes, 12);
  EXPECT_EQ(bytes.substr(16, 4), "JSON");
  EXPECT_EQ(length % 4, 0U);
  result.json = nlohmann::json::parse(bytes.substr(20, length));
  const size_t second = 20 + length;
  if (second == bytes.size()) return result;
  EXPECT_EQ(bytes.substr(second + 4, 4), std::string("BIN\0", 4));
  EXPECT_EQ(word_at(bytes, second) % 4, 0U);
  result.binary = bytes.substr(second + 8, word_at(bytes, second));
  EXPECT_EQ(second + 8 + result.binary.size(), bytes.size());
  return result;
}

inline size_t component_bytes(int type) { return type == 5126 || type == 5125 ? 4 : (type == 5123 ? 2 : 1); }

inline size_t components_of(const std::string& type) {
  return std::map<std::string, size_t>{{"SCALAR", 1}, {"VEC2", 2}, {"VEC3", 3}, {"VEC4", 4}}.at(type);
}

// Returns the values of an accessor, (count, components), as they are stored.
inline std::vector<std::vector<double>> accessor_values(const GltfFile& file, size_t number) {
  const auto& accessor = file.at("accessors", number);
  const auto& view = file.at("bufferViews", accessor.at("bufferView"));
  const int type = accessor.at("componentType");
  const size_t components = components_of(accessor.at("type")), size = component_bytes(type);
  const size_t stride = view.value("byteStride", components * size);
  std::vector<std::vector<double>> values(accessor.at("count").get<size_t>(),
                                          std::vector<double>(components));
  for (size_t i = 0; i < values.size(); ++i) {
    for (size_t c = 0; c < components; ++c) {
      const size_t place = view.value("byteOffset", size_t{0}) + accessor.value("byteOffset", size_t{0}) +
                           i * stride + c * size;
      if (place > file.binary.size() || size > file.binary.size() - place)
        throw std::out_of_range("an accessor that reaches beyond the binary chunk");
      const char* at = file.binary.data() + place;
      if (type == 5126) {
        float value = 0;
        std::memcpy(&value, at, 4);
        values[i][c] = value;
      } else if (type == 5125) {
        uint32_t value = 0;
        std::memcpy(&value, at, 4);
        values[i][c] = value;
      } else {
        uint16_t value = 0;  // of one byte or two, little endian
        std::memcpy(&value, at, size);
        values[i][c] = value;
      }
    }
  }
  return values;
}

inline Eigen::Isometry3d node_pose(const nlohmann::json& node) {
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  if (node.contains("translation")) {
    const auto t = node.at("translation").get<std::vector<double>>();
    pose.translation() = Eigen::Vector3d(t[0], t[1], t[2]);
  }
  if (node.contains("rotation")) {
    const auto q = node.at("rotation").get<std::vector<double>>();
    pose.linear() = Eigen::Quaterniond(q[3], q[0], q[1], q[2]).toRotationMatrix();
  }
  return pose;
}

// Returns the pose of each node in the scene, by name.
inline std::map<std::string, Eigen::Isometry3d> global_poses(const GltfFile& file) {
  std::map<std::string, Eigen::Isometry3d> poses;
  const auto visit = [&](const auto& self, size_t number, const Eigen::Isometry3d& above) -> void {
    const auto& node = file.at("nodes", number);
    const Eigen::Isometry3d pose = above * node_pose(node);
    poses[node.at("name")] = pose;
    if (!node.contains("children")) return;
    for (const size_t child : node.at("children").get<std::vector<size_t>>()) self(self, child, pose);
  };
  for (const size_t root : file.json.at("scenes").at(file.json.at("scene").get<size_t>()).at("nodes"))
    visit(visit, root, Eigen::Isometry3d::Identity());
  return poses;
}

// words are the keys that an object may have, with those that it must have behind '!'.
inline void expect_keys(const nlohmann::json& object, const std::string& what, const std::string& words) {
  ASSERT_TRUE(object.is_object()) << what;
  std::set<std::string> known{"extras", "extensions"};
  std::istringstream stream(words);
  for (std::string word; stream >> word;) {
    const bool needed = word.front() == '!';
    const std::string key = word.substr(needed ? 1 : 0);
    known.insert(key);
    if (needed) {
      EXPECT_TRUE(object.contains(key)) << what << " has no " << key;
    }
  }
  for (const auto& item : object.items())
    EXPECT_EQ(known.count(item.key()), 1U) << what << " has " << item.key();
}

// Expects numbers of that count between two bounds, where the key is there.
inline void expect_numbers(const nlohmann::json& object, const char* key, size_t count,
                           double low = -std::numeric_limits<double>::max(),
                           double high = std::numeric_limits<double>::max()) {
  if (!object.contains(key)) return;
  ASSERT_TRUE(object.at(key).is_array()) << key;
  EXPECT_EQ(object.at(key).size(), count) << key;
  for (const auto& value : object.at(key)) {
    ASSERT_TRUE(value.is_number()) << key;
    EXPECT_GE(value.get<double>(), low) << key;
    EXPECT_LE(value.get<double>(), high) << key;
  }
}

// Expects a number between two bounds, where the key is there.
inline void expect_number(const nlohmann::json& object, const char* key, double low, double high) {
  if (!object.contains(key)) return;
  ASSERT_TRUE(object.at(key).is_number()) << key;
  EXPECT_GE(object.at(key).get<double>(), low) << key;
  EXPECT_LE(object.at(key).get<double>(), high) << key;
}

// Expects whole numbers from 0 on, where the keys are there.
inline void expect_whole(const nlohmann::json& object, const std::vector<const char*>& keys) {
  for (const char* key : keys) {
    EXPECT_TRUE(!object.contains(key) || object.at(key).is_number_unsigned())
        << key << " of " << object.dump();
  }
}

// Expects one of the values that the specification lists, where the key is there.
inline void expect_one_of(const nlohmann::json& object, const char* key, const nlohmann::json& values) {
  if (!object.contains(key)) return;
  EXPECT_NE(std::find(values.begin(), values.end(), object.at(key)), values.end())
      << key << " of " << object.dump();
}

// Expects whole numbers from 0 on, each once and one at least, where the key is there.
inline void expect_ids(const nlohmann::json& object, const char* key, size_t end) {
  if (!object.contains(key)) return;
  ASSERT_TRUE(object.at(key).is_array()) << key;
  EXPECT_FALSE(object.at(key).empty()) << key;
  std::set<size_t> numbers;
  for (const auto& value : object.at(key)) {
    ASSERT_TRUE(value.is_number_unsigned()) << key;
    EXPECT_LT(value.get<size_t>(), end) << key;
    EXPECT_TRUE(numbers.insert(value.get<size_t>()).second) << key << " twice";
  }
}

// Checks all that the JSON schema of glTF 2.0 (Khronos, specification/2.0/schema) demands of the objects that an export
// has: glTF, glTFid, glTFProperty (extensions and extras), asset, buffer, bufferView, accessor, camera,
// camera.perspective, image, sampler, texture, textureInfo, material, material.pbrMetallicRoughness, mesh,
// mesh.primitive, node and scene, their keys, required ones, types, enumerations, bounds, numbers of elements and what
// excludes what, where the schema lets unknown keys and values pass, too; and KHR_materials_unlit. An export has none
// of the others, whose keys are refused: accessor.sparse and its parts, animation and its parts, camera.orthographic,
// skin, morph targets and weights, material's normal, occlusion and emissive textures and alpha, node's matrix, scale
// and skin, uri. Beyond the schema it checks: a tree of nodes, alignment, sizes, values that are finite, and exact
// bounds of positions.
inline void expect_valid_gltf(const GltfFile& file) {
  const auto& json = file.json;
  expect_keys(
      json, "file",
      "!asset accessors bufferViews buffers cameras extensionsUsed images materials meshes nodes samplers scene "
      "scenes textures");
  expect_keys(json.at("asset"), "asset", "!version generator");
  EXPECT_EQ(json.at("asset").at("version"), "2.0");
  const auto expect_property = [&](const nlohmann::json& object) {
    for (const char* key : {"name", "generator"})
      EXPECT_TRUE(!object.contains(key) || object.at(key).is_string()) << key;
    if (!object.contains("extensions")) return;
    ASSERT_TRUE(object.at("extensions").is_object());
    for (const auto& extension : object.at("extensions").items()) {
      EXPECT_TRUE(extension.value().is_object()) << extension.key();
      EXPECT_THAT(json.at("extensionsUsed"), ::testing::Contains(extension.key()));
    }
  };
  expect_property(json.at("asset"));
  const auto in_range = [&](const nlohmann::json& object, const char* key, const char* list) {
    if (!object.contains(key)) return;
    EXPECT_TRUE(object.at(key).is_number_unsigned()) << key;
    EXPECT_LT(object.at(key).get<size_t>(), file.count(list)) << key << " of " << object.dump();
  };
  for (const char* list : {"accessors", "bufferViews", "buffers", "cameras", "images", "materials", "meshes",
                           "nodes", "samplers", "scenes", "textures"}) {
    if (!json.contains(list)) continue;
    ASSERT_TRUE(json.at(list).is_array()) << list;
    EXPECT_FALSE(json.at(list).empty()) << list << " may not be empty";
    for (const auto& object : json.at(list)) expect_property(object);
  }
  in_range(json, "scene", "scenes");
  EXPECT_LE(file.count("buffers"), 1U);
  if (file.count("buffers") == 1) {
    expect_keys(file.at("buffers", 0), "buffer", "!byteLength");
    expect_whole(file.at("buffers", 0), {"byteLength"});
    const size_t length = file.at("buffers", 0).at("byteLength");
    EXPECT_GE(length, 1U);
    EXPECT_GE(file.binary.size(), length);
    EXPECT_LE(file.binary.size(), length + 3);
  }
  std::vector<std::set<std::string>> uses(file.count("bufferViews"));
  for (size_t i = 0; i < file.count("bufferViews"); ++i) {
    const auto& view = file.at("bufferViews", i);
    expect_keys(view, "bufferView", "!buffer !byteLength byteOffset byteStride target");
    in_range(view, "buffer", "buffers");
    expect_one_of(view, "target", {34962, 34963});
    expect_number(view, "byteStride", 4, 252);
    expect_whole(view, {"byteOffset", "byteLength", "byteStride"});
    EXPECT_GE(view.at("byteLength").get<size_t>(), 1U);
    EXPECT_LE(view.value("byteOffset", size_t{0}) + view.at("byteLength").get<size_t>(),
              file.at("buffers", 0).at("byteLength").get<size_t>());
  }
  for (size_t i = 0; i < file.count("accessors"); ++i) {
    const auto& accessor = file.at("accessors", i);
    expect_keys(accessor, "accessor",
                "!componentType !count !type !bufferView byteOffset min max normalized");
    expect_whole(accessor, {"count", "byteOffset"});
    EXPECT_TRUE(!accessor.contains("normalized") || accessor.at("normalized").is_boolean());
    expect_one_of(accessor, "type", {"SCALAR", "VEC2", "VEC3", "VEC4"});
    in_range(accessor, "bufferView", "bufferViews");
    const auto& view = file.at("bufferViews", accessor.at("bufferView"));
    const int type = accessor.at("componentType");
    EXPECT_EQ(std::set<int>({5120, 5121, 5122, 5123, 5125, 5126}).count(type), 1U);
    const size_t components = components_of(accessor.at("type")), size = component_bytes(type);
    const size_t count = accessor.at("count");
    EXPECT_GE(count, 1U);
    const size_t offset = accessor.value("byteOffset", size_t{0});
    EXPECT_EQ((offset + view.value("byteOffset", size_t{0})) % size, 0U);
    const size_t stride = view.value("byteStride", components * size);
    EXPECT_EQ(stride % 4 == 0 || !view.contains("target") || view.at("target") != 34962, true)
        << "vertex attributes";
    EXPECT_LE(offset + stride * (count - 1) + components * size, view.at("byteLength").get<size_t>());
    const auto values = accessor_values(file, i);
    std::vector<double> low(components, std::numeric_limits<double>::infinity()), high(components, -low[0]);
    for (const auto& row : values) {
      for (size_t c = 0; c < components; ++c) {
        EXPECT_TRUE(std::isfinite(row[c]));
        low[c] = std::min(low[c], row[c]);
        high[c] = std::max(high[c], row[c]);
      }
    }
    if (accessor.contains("min")) {
      EXPECT_EQ(accessor.at("min").get<std::vector<double>>(), low);
    }
    if (accessor.contains("max")) {
      EXPECT_EQ(accessor.at("max").get<std::vector<double>>(), high);
    }
  }
  for (size_t i = 0; i < file.count("meshes"); ++i) {
    const auto& mesh = file.at("meshes", i);
    expect_keys(mesh, "mesh", "!primitives name");
    ASSERT_TRUE(mesh.at("primitives").is_array());
    EXPECT_GE(mesh.at("primitives").size(), 1U);
    for (const auto& primitive : mesh.at("primitives")) {
      expect_keys(primitive, "primitive", "!attributes indices material mode");
      in_range(primitive, "material", "materials");
      in_range(primitive, "indices", "accessors");
      expect_one_of(primitive, "mode", {0, 4});  // points and triangles, of the seven
      size_t count = 0;
      EXPECT_TRUE(primitive.at("attributes").contains("POSITION"));
      for (const auto& item : primitive.at("attributes").items()) {
        in_range(primitive.at("attributes"), item.key().c_str(), "accessors");
        EXPECT_EQ(std::set<std::string>({"POSITION", "TEXCOORD_0", "COLOR_0"}).count(item.key()), 1U);
        const auto& accessor = file.at("accessors", item.value());
        if (count == 0) count = accessor.at("count");
        EXPECT_EQ(accessor.at("count").get<size_t>(), count);
        EXPECT_EQ(file.at("bufferViews", accessor.at("bufferView")).at("target"), 34962);
        uses[accessor.at("bufferView")].insert("vertices");
        if (item.key() == "POSITION") {
          EXPECT_EQ(accessor.at("type"), "VEC3");
          EXPECT_EQ(accessor.at("componentType"), 5126);
          EXPECT_TRUE(accessor.contains("min") && accessor.contains("max"));
        }
        if (accessor.at("componentType") != 5126) {
          EXPECT_TRUE(accessor.at("normalized"));
        }
      }
      if (!primitive.contains("indices")) continue;
      const size_t number = primitive.at("indices");
      const auto& accessor = file.at("accessors", number);
      EXPECT_EQ(accessor.at("type"), "SCALAR");
      EXPECT_EQ(accessor.at("count").get<size_t>() % 3, 0U);
      EXPECT_EQ(file.at("bufferViews", accessor.at("bufferView")).at("target"), 34963);
      uses[accessor.at("bufferView")].insert("indices");
      std::set<double> used;
      for (const auto& row : accessor_values(file, number)) used.insert(row[0]);
      EXPECT_LT(*used.rbegin(), static_cast<double>(count));
      EXPECT_EQ(used.size(), count) << "vertices without a triangle";
    }
  }
  for (size_t i = 0; i < file.count("materials"); ++i) {
    const auto& material = file.at("materials", i);
    expect_keys(material, "material", "name pbrMetallicRoughness doubleSided");
    EXPECT_TRUE(material.at("extensions").at("KHR_materials_unlit").is_object());
    EXPECT_TRUE(material.at("doubleSided"));
    EXPECT_TRUE(material.at("extensions").at("KHR_materials_unlit").empty());
    const auto& colour = material.at("pbrMetallicRoughness");
    expect_keys(colour, "pbrMetallicRoughness",
                "baseColorFactor baseColorTexture metallicFactor roughnessFactor");
    expect_numbers(colour, "baseColorFactor", 4, 0, 1);
    for (const char* key : {"metallicFactor", "roughnessFactor"}) expect_number(colour, key, 0, 1);
    if (colour.contains("baseColorTexture")) {
      expect_keys(colour.at("baseColorTexture"), "textureInfo", "!index");
      in_range(colour.at("baseColorTexture"), "index", "textures");
    }
    EXPECT_EQ(json.at("extensionsUsed"), nlohmann::json({"KHR_materials_unlit"}));
  }
  for (size_t i = 0; i < file.count("samplers"); ++i) {
    const auto& sampler = file.at("samplers", i);
    expect_keys(sampler, "sampler", "magFilter minFilter wrapS wrapT name");
    expect_one_of(sampler, "magFilter", {9728, 9729});
    expect_one_of(sampler, "minFilter", {9728, 9729, 9984, 9985, 9986, 9987});
    for (const char* key : {"wrapS", "wrapT"}) expect_one_of(sampler, key, {33071, 33648, 10497});
  }
  for (size_t i = 0; i < file.count("textures"); ++i) {
    expect_keys(file.at("textures", i), "texture", "!source !sampler");
    in_range(file.at("textures", i), "source", "images");
    in_range(file.at("textures", i), "sampler", "samplers");
  }
  for (size_t i = 0; i < file.count("images"); ++i) {
    const auto& image = file.at("images", i);
    expect_keys(image, "image", "!bufferView !mimeType name");
    in_range(image, "bufferView", "bufferViews");
    const auto& view = file.at("bufferViews", image.at("bufferView"));
    EXPECT_FALSE(view.contains("target"));
    uses[image.at("bufferView")].insert("image");
    EXPECT_EQ(image.at("mimeType"), "image/png");
    EXPECT_EQ(file.binary.substr(view.value("byteOffset", size_t{0}) + 1, 3), "PNG");
  }
  for (const auto& use : uses) EXPECT_EQ(use.size(), 1U) << "a bufferView is for one thing";
  for (size_t i = 0; i < file.count("cameras"); ++i) {
    const auto& camera = file.at("cameras", i);
    expect_keys(camera, "camera", "!type !perspective name");
    EXPECT_EQ(camera.at("type"), "perspective");
    expect_keys(camera.at("perspective"), "perspective", "!yfov !znear aspectRatio zfar");
    EXPECT_GT(camera.at("perspective").at("znear"), 0);
    EXPECT_GT(camera.at("perspective").at("zfar"), camera.at("perspective").at("znear"));
    EXPECT_GT(camera.at("perspective").at("yfov"), 0);
    EXPECT_LT(camera.at("perspective").at("yfov"), 3.14159265);
    EXPECT_GT(camera.at("perspective").at("aspectRatio"), 0);
  }
  std::vector<int> parents(file.count("nodes"), 0);
  for (size_t i = 0; i < file.count("nodes"); ++i) {
    const auto& node = file.at("nodes", i);
    expect_keys(node, "node", "name translation rotation mesh camera children");
    in_range(node, "mesh", "meshes");
    in_range(node, "camera", "cameras");
    expect_ids(node, "children", parents.size());
    expect_numbers(node, "translation", 3);
    expect_numbers(node, "rotation", 4, -1, 1);
    if (node.contains("rotation")) {
      double square = 0;
      for (const double value : node.at("rotation").get<std::vector<double>>()) square += value * value;
      EXPECT_NEAR(square, 1, 1e-12);
    }
    if (!node.contains("children")) continue;
    for (const size_t child : node.at("children").get<std::vector<size_t>>()) ++parents.at(child);
  }
  EXPECT_EQ(json.at("scenes").size(), 1U);
  expect_keys(json.at("scenes").at(0), "scene", "!nodes name");
  expect_ids(json.at("scenes").at(0), "nodes", parents.size());
  for (const size_t root : json.at("scenes").at(0).at("nodes").get<std::vector<size_t>>()) ++parents.at(root);
  for (const int count : parents) EXPECT_EQ(count, 1) << "nodes are a tree";
}

}  // namespace gld::test
