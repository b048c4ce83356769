#include "datasets/formats/nerfstudio_writer.h"

#include "datasets/formats/json_file.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"

#include <nlohmann/json.hpp>

namespace gld {

void write_transforms_json(const std::filesystem::path& file, const Transforms& transforms) {
  nlohmann::ordered_json content;
  content["camera_model"] = "OPENCV";
  if (transforms.depth_unit > 0) content["depth_unit_scale_factor"] = transforms.depth_unit;
  if (!transforms.point_cloud.empty()) content["ply_file_path"] = transforms.point_cloud;
  for (const auto& [name, text] : transforms.comments) content["gld"][name] = text;
  content["frames"] = nlohmann::ordered_json::array();
  for (const TransformsFrame& frame : transforms.frames) {
    const Eigen::Matrix3d& k = frame.camera.intrinsics;
    nlohmann::ordered_json entry;
    entry["file_path"] = frame.image;
    if (!frame.depth.empty()) entry["depth_file_path"] = frame.depth;
    entry["w"] = frame.camera.width;
    entry["h"] = frame.camera.height;
    entry["fl_x"] = k(0, 0);
    entry["fl_y"] = k(1, 1);
    entry["cx"] = k(0, 2);
    entry["cy"] = k(1, 2);
    // Turning y and z around is its own inverse.
    entry["transform_matrix"] =
        pose_to_json(opencv_from_opengl_pose(frame.camera.world_from_camera).matrix());
    content["frames"].push_back(entry);
  }
  write_file_atomically(file, json_text(content, 1) + "\n");
}

}  // namespace gld
