#pragma once

#include "gld/cameras/camera.h"
#include "gld/report/provenance.h"
#include "infer/export/point_cloud.h"
#include "infer/run_export/depth_surface.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace gld {

// A view as a GLB file shows it.
struct GlbView {
  std::string name;
  bool target = false;
  Camera camera;
  std::string png;       // the bytes of its picture; needed where there is a surface
  DepthSurface surface;  // may be empty
};

struct GlbScene {
  std::vector<GlbView> views;
  PointCloud cloud;  // may be empty
  TextItems provenance;
  double typical_depth = 1;  // in the unit of the cameras: what viewers clip at is far from it
};

// Returns what is subtracted from the coordinates of a scene before they become floats: it is zero as long as a float's
// rounding is below a millionth of the box around cameras, cloud and surfaces, else the middle of that box, rounded to
// whole numbers of float.
Eigen::Vector3d glb_origin(const GlbScene& scene);

// Writes a binary glTF 2.0 file by tinygltf. Its nodes:
//   y_up                    turns OpenCV's axes (y down) to glTF's (y up)
//     recentred             only for coordinates too large for floats: moves the scene to the origin
//       world               moves it back; without the nodes above it all is in the world of cameras.json
//         VIEW              a view's pose; its surface as an unlit, double-sided mesh with its picture
//           VIEW camera     a glTF camera where the principal point is in the middle, and in any case width, height,
//                           fx, fy, cx, cy (pixels) and the role in "extras"
//         cloud             points with linear colours
// Surfaces and clouds that are empty are left out. Writing is atomic. Throws Error for a file beyond 2 GiB, and for
// points that are not finite.
void write_glb(const std::filesystem::path& file, const GlbScene& scene);

}  // namespace gld
