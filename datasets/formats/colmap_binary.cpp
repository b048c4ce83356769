#include "datasets/formats/colmap_binary.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <cstring>
#include <map>

namespace gld {
namespace {

constexpr uint64_t kObservationBytes = 24;  // x, y, point id
constexpr uint64_t kTrackBytes = 8;         // image id, index
constexpr uint64_t kSmallestImage = 72;     // id, pose, camera, empty name, no observations
constexpr uint64_t kSmallestCamera = 48;    // id, model, size, three parameters
constexpr uint64_t kSmallestPoint = 51;     // id, position, colour, error, empty track

class BinaryReader {
 public:
  explicit BinaryReader(const std::filesystem::path& file) : where_(file.string()), bytes_(read_file(file)) {}

  template <class Value>
  Value get() {
    need(sizeof(Value));
    Value value;
    std::memcpy(&value, bytes_.data() + position_, sizeof(Value));
    position_ += sizeof(Value);
    return value;
  }
  // Returns a count of records of at least smallest bytes each.
  uint64_t count(uint64_t smallest) {
    const auto number = get<uint64_t>();
    if (number > (bytes_.size() - position_) / smallest) {
      fail({where(), "a count that fits the file", std::to_string(number) + " records",
            "copy the file again"});
    }
    return number;
  }
  std::string text() {
    const size_t end = bytes_.find('\0', position_);
    if (end == std::string::npos) fail_short();
    std::string result = bytes_.substr(position_, end - position_);
    position_ = end + 1;
    return result;
  }
  void skip(uint64_t size) {
    need(size);
    position_ += size;
  }
  Eigen::Vector3d vector() {
    const double x = get<double>();
    const double y = get<double>();
    const double z = get<double>();
    return {x, y, z};
  }
  void check_end() const {
    if (position_ != bytes_.size()) {
      fail({where(), "the end of the file", std::to_string(bytes_.size() - position_) + " more bytes",
            "check that it is a file of this kind"});
    }
  }
  std::string where() const { return where_ + " at byte " + std::to_string(position_); }

 private:
  void need(uint64_t size) const {
    if (size > bytes_.size() - position_) fail_short();
  }
  [[noreturn]] void fail_short() const {
    fail({where(), "more data", "the end of the file", "copy the file again"});
  }
  std::string where_;
  std::string bytes_;
  size_t position_ = 0;
};

void read_cameras_bin(const std::filesystem::path& file, ColmapModel& model) {
  BinaryReader reader(file);
  const uint64_t count = reader.count(kSmallestCamera);
  for (uint64_t i = 0; i < count; ++i) {
    const auto id = reader.get<int32_t>();
    const auto kind = reader.get<int32_t>();
    const auto& kinds = colmap_model_kinds();
    if (kind < 0 || static_cast<size_t>(kind) >= kinds.size()) {
      fail({reader.where(),
            "a camera model from 0 to " + std::to_string(kinds.size() - 1) + ", such as PINHOLE or OPENCV",
            std::to_string(kind),
            "undistort the images with COLMAP's image_undistorter, or check that it is a file of this kind"});
    }
    ColmapCamera camera;
    camera.model = kinds[static_cast<size_t>(kind)].name;
    const auto width = reader.get<uint64_t>();
    const auto height = reader.get<uint64_t>();
    if (width > 1'000'000 || height > 1'000'000) {
      fail({reader.where(), "an image size", std::to_string(width) + "x" + std::to_string(height),
            "check that it is a file of this kind"});
    }
    camera.width = static_cast<int64_t>(width);
    camera.height = static_cast<int64_t>(height);
    for (size_t k = 0; k < kinds[static_cast<size_t>(kind)].parameters; ++k) {
      camera.parameters.push_back(reader.get<double>());
    }
    model.cameras[id] = camera;
  }
  reader.check_end();
}

// Calls take(image, reader) for each image, the reader at the count of its observations, which take must pass.
template <class Take>
void read_images(const std::filesystem::path& file, const Take& take) {
  BinaryReader reader(file);
  const uint64_t count = reader.count(kSmallestImage);
  for (uint64_t i = 0; i < count; ++i) {
    reader.get<int32_t>();
    ColmapImage image;
    const auto w = reader.get<double>();
    const Eigen::Vector3d xyz = reader.vector();
    image.rotation = Eigen::Quaterniond(w, xyz.x(), xyz.y(), xyz.z());
    image.translation = reader.vector();
    image.camera_id = reader.get<int32_t>();
    image.name = reader.text();
    take(image, reader);
  }
  reader.check_end();
}

void read_images_bin(const std::filesystem::path& file, ColmapModel& model) {
  read_images(file, [&](const ColmapImage& image, BinaryReader& reader) {
    reader.skip(reader.count(kObservationBytes) * kObservationBytes);
    model.images.push_back(image);
  });
}

std::map<uint64_t, Eigen::Vector3d> read_points_bin(const std::filesystem::path& file) {
  BinaryReader reader(file);
  const uint64_t count = reader.count(kSmallestPoint);
  std::map<uint64_t, Eigen::Vector3d> points;
  for (uint64_t i = 0; i < count; ++i) {
    const auto id = reader.get<uint64_t>();
    points[id] = reader.vector();
    reader.skip(3 + sizeof(double));
    reader.skip(reader.count(kTrackBytes) * kTrackBytes);
  }
  reader.check_end();
  return points;
}

class BinaryWriter {
 public:
  template <class Value>
  void put(const Value& value) {
    const auto* bytes = reinterpret_cast<const char*>(&value);
    bytes_.append(bytes, sizeof(Value));
  }
  void put(const Eigen::Vector3d& value) {
    for (int i = 0; i < 3; ++i) put(value[i]);
  }
  void put_text(const std::string& text) { bytes_.append(text.c_str(), text.size() + 1); }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

int32_t kind_number(const std::string& name) {
  const auto& kinds = colmap_model_kinds();
  for (size_t i = 0; i < kinds.size(); ++i) {
    if (name == kinds[i].name) return static_cast<int32_t>(i);
  }
  fail({"COLMAP model", "a known camera model", name, "choose one of COLMAP's models"});
}

}  // namespace

ColmapModel read_colmap_binary(const std::filesystem::path& folder) {
  ColmapModel model;
  read_cameras_bin(folder / "cameras.bin", model);
  read_images_bin(folder / "images.bin", model);
  const auto points = folder / "points3D.bin";
  if (!std::filesystem::exists(points)) return model;
  for (const auto& item : read_points_bin(points)) model.points_in_world.push_back(item.second);
  return model;
}

ColmapSightings read_colmap_sightings(const std::filesystem::path& folder) {
  ColmapSightings sightings;
  sightings.points_in_world = read_points_bin(folder / "points3D.bin");
  read_images(folder / "images.bin", [&](const ColmapImage& image, BinaryReader& reader) {
    auto& places = sightings.images[image.name];
    const uint64_t count = reader.count(kObservationBytes);
    for (uint64_t i = 0; i < count; ++i) {
      ColmapSighting sighting;
      sighting.position.x() = reader.get<double>();
      sighting.position.y() = reader.get<double>();
      sighting.point = reader.get<uint64_t>();
      // The largest number stands for a place without a point.
      if (sightings.points_in_world.count(sighting.point) > 0) places.push_back(sighting);
    }
  });
  return sightings;
}

void write_colmap_binary(const std::filesystem::path& folder, const ColmapModel& model) {
  const auto tracks = colmap_tracks(model);
  BinaryWriter cameras;
  cameras.put(static_cast<uint64_t>(model.cameras.size()));
  for (const auto& [id, camera] : model.cameras) {
    cameras.put(static_cast<int32_t>(id));
    cameras.put(kind_number(camera.model));
    cameras.put(static_cast<uint64_t>(camera.width));
    cameras.put(static_cast<uint64_t>(camera.height));
    for (double value : camera.parameters) cameras.put(value);
  }
  write_file_atomically(folder / "cameras.bin", cameras.bytes());
  BinaryWriter images;
  images.put(static_cast<uint64_t>(model.images.size()));
  for (size_t i = 0; i < model.images.size(); ++i) {
    const ColmapImage& image = model.images[i];
    images.put(static_cast<int32_t>(i + 1));
    images.put(image.rotation.w());
    images.put(Eigen::Vector3d(image.rotation.vec()));
    images.put(image.translation);
    images.put(static_cast<int32_t>(image.camera_id));
    images.put_text(image.name);
    images.put(static_cast<uint64_t>(image.sightings.size()));
    for (const ColmapSighting& sighting : image.sightings) {
      images.put(sighting.position.x());
      images.put(sighting.position.y());
      images.put(sighting.point);
    }
  }
  write_file_atomically(folder / "images.bin", images.bytes());
  BinaryWriter points;
  points.put(static_cast<uint64_t>(model.points_in_world.size()));
  for (size_t i = 0; i < model.points_in_world.size(); ++i) {
    points.put(static_cast<uint64_t>(i + 1));
    points.put(model.points_in_world[i]);
    const ColmapPointLooks looks = model.point_looks.empty() ? ColmapPointLooks() : model.point_looks[i];
    for (const uint8_t value : looks.colour) points.put(value);
    points.put(looks.error);
    points.put(static_cast<uint64_t>(tracks[i].size()));
    for (const ColmapTrackElement& element : tracks[i]) {
      points.put(static_cast<int32_t>(element.image_id));
      points.put(static_cast<int32_t>(element.sighting));
    }
  }
  write_file_atomically(folder / "points3D.bin", points.bytes());
}

}  // namespace gld
