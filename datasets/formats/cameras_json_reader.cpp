#include "datasets/formats/cameras_json_reader.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/depth_files.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/frame_pixels.h"
#include "gld/base/error.h"
#include "gld/cameras/resized_camera.h"

#include <map>
#include <optional>
#include <string>

#include <fmt/format.h>

namespace gld {
namespace {

std::filesystem::path list_file(const std::filesystem::path& path) {
  const auto file = path.filename() == "cameras.json" ? path : path / "cameras.json";
  return is_file(file) ? file : std::filesystem::path();
}

// Depth that has cameras of its own is brought to its image's size when it is read.
void add_depth_of_other_size(const std::filesystem::path& folder, CameraList& cameras) {
  const auto file = folder / kDepthCamerasFile;
  if (!is_file(file)) return;
  std::map<std::string, CameraRecord> of_depth;
  for (const CameraRecord& record : read_cameras_json(file).records) of_depth[record.name] = record;
  for (CameraRecord& record : cameras.records) {
    const auto found = of_depth.find(record.name);
    if (!record.depth.empty() || found == of_depth.end()) continue;
    const Camera &large = record.camera, &small = found->second.camera;
    const Camera scaled = resized_camera(small, large.width, large.height);
    constexpr double kPixels = 0.01, kLength = 1e-6;
    const double off = (scaled.intrinsics - large.intrinsics).cwiseAbs().maxCoeff();
    const double moved =
        (small.world_from_camera.matrix() - large.world_from_camera.matrix()).cwiseAbs().maxCoeff();
    if (!(off <= kPixels) || !(moved <= kLength * (1 + large.world_from_camera.translation().norm()))) {
      fail({file.string() + " " + record.name, "the camera of the picture in another size",
            fmt::format("one that is {:.3g} pixels and {:.3g} of the unit beside it", off, moved),
            "remove the file, or write both from one camera"});
    }
    record.depth = found->second.depth;
    record.depth_unit = found->second.depth_unit;
  }
}

}  // namespace

bool CamerasJsonReader::recognises(const std::filesystem::path& path) const {
  return !list_file(path).empty();
}

Scene CamerasJsonReader::read(const std::filesystem::path& path, const SceneReading& reading) const {
  const auto file = list_file(path);
  if (file.empty())
    fail({path.string(), "cameras.json", "none", "check the folder or choose another format"});
  const auto folder = file.parent_path();
  CameraList cameras = read_cameras_json(file);
  add_depth_of_other_size(folder, cameras);
  SceneBuilder builder(name(), folder, reading);
  FrameMaker maker;
  for (const CameraRecord& record : cameras.records) {
    const std::string where = file.string() + " " + record.name;
    builder.add(where, [&]() -> std::optional<Frame> {
      if (record.image.empty())
        fail({where, "an image", "a camera without one", "use the file as a camera path"});
      FrameRecord frame;
      frame.name = record.name;
      frame.image_file = inside(folder, record.image, where);
      if (!is_file(frame.image_file)) {
        builder.add_missing(frame.image_file);
        return std::nullopt;
      }
      frame.camera_width = record.camera.width;
      frame.camera_height = record.camera.height;
      frame.intrinsics = record.camera.intrinsics;
      frame.world_from_camera = record.camera.world_from_camera;
      if (!record.depth.empty()) {
        const auto depth = inside(folder, record.depth, where);
        frame.load_depth = [depth, unit = record.depth_unit] {
          return is_image_name(depth) ? read_depth_png(depth, unit) : read_depth_npy(depth);
        };
      }
      return maker.make(frame);
    });
  }
  builder.scene().metric = cameras.metric;
  if (!cameras.points.empty()) {
    builder.scene().points_in_world = read_points_npy(inside(folder, cameras.points, file.string()));
  }
  return builder.finish();
}

}  // namespace gld
