#pragma once

#include "datasets/images/image.h"
#include "gld/cameras/camera.h"
#include "infer/export/point_cloud.h"

#include <cstdint>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// A camera with the depth that it sees, of any size.
struct SeenDepth {
  Camera camera;
  DepthMap depth;  // empty: not known
};

// Returns the cloud as the page's script cloud.js takes it apart, thinned to at most so many points. Positions are 16
// bits of the box around it, so that none moves by more than its 131070th part; `origin` is the point of the world that
// is the page's 0. Every point has a footprint, how far apart its neighbours may be: the pixel of the nearest camera
// that sees it (of all within whose picture it lies where none does), at least the cell of the thinning, to 4 %; and a
// rank by confidence, the share of points that are not surer than it, of 255. The object has {"count", "of", "low",
// "step", "footprint", "bytes"}: bytes is base64 of deflated planes.
nlohmann::ordered_json page_cloud(PointCloud cloud, const std::vector<SeenDepth>& views,
                                  const Eigen::Vector3d& origin, int64_t most_points);

}  // namespace gld
