#pragma once

#include "gld/cameras/camera.h"
#include "gld/photogrammetry/depth_scale.h"
#include "gld/photogrammetry/pose_from_rays.h"
#include "infer/pipeline/sampling_pipeline.h"

#include <optional>
#include <string>
#include <vector>

#include <torch/types.h>

#include <nlohmann/json.hpp>

namespace gld {

// Which lens took a photograph, and how its focal length there follows from the lens's.
struct PhotographLens {
  int64_t number = 0;  // photographs of one number have one lens
  double longer_side =
      1;  // of the photograph as taken, in pixels of the picture; focal lengths are compared over it
  double exif_focal_length = 0;  // of the lens, over that side; 0 where EXIF names none
  double taken_pixels = 1;       // of the photograph as taken, to one of the picture
};

// What EXIF and the photographs of one lens say of its focal length, over the longer side of a photograph.
struct SharedLens {
  std::vector<size_t> photographs;
  double exif_focal_length = 0;    // 0 where EXIF names none
  double seen_focal_length = 0;    // the median of what each photograph's rays alone ask for
  double lowest = 0, highest = 0;  // of these
  // This one is taken for all: EXIF's where there is one.
  double focal_length() const { return exif_focal_length > 0 ? exif_focal_length : seen_focal_length; }
};

// What EXIF says of a photograph's focal length and what its rays alone ask for, in pixels of the photograph as taken.
struct PhotographFocalLength {
  double by_exif = 0;          // 0 where EXIF names none
  double seen = 0;             // the geometric mean of those of both directions
  double direction_error = 0;  // that the camera seen leaves (RecoveredCamera): degrees
};

// The cameras that a geometry model sees behind photographs that have none, and how far to believe them.
struct PhotoCameras {
  // One a photograph; the first one is the world, and the unit is the model's.
  std::vector<Camera> cameras;
  std::vector<RecoveredCamera> recovered;            // in the frame of the rays: how well each fits its rays
  std::vector<PhotographFocalLength> focal_lengths;  // one a photograph
  std::vector<SharedLens> lenses;                    // those of several photographs
  double spread = 0;  // root mean square distance of the centres from their mean
  double origin_error =
      0;  // median over the photographs of what the origins of one leave, in the model's unit
  double median_depth = 0;  // in the model's unit
  // What the photographs say of the depth under these cameras (gld/photogrammetry/photo_consistency.h): the scale is 1
  // where cameras and depth bear each other out. Nothing where the cameras stand at one place.
  std::optional<DepthScale> depth_check;

  // Returns why the places of the cameras are not to be relied on, as phrases; empty where they are.
  std::vector<std::string> doubts() const;
};

// Finds them from depth and rays of photographs, (views, 3, height, width) in [0, 1] (geometry_of_pictures.h). The
// principal points are the pictures' middles, as they are of photographs that were not cut off to one side. lenses are
// one a photograph, or none: then each has a lens of its own. A lens that EXIF tells of has EXIF's focal length, with
// square pixels; the photographs of another one get one together: the median over them of the geometric mean of the two
// that each one's rays ask for. A camera whose focal length is given is turned to fit again. Throws Error naming the
// photograph where no camera fits its rays.
PhotoCameras photo_cameras(const GeometryOutput& geometry, const torch::Tensor& photographs,
                           const std::vector<PhotographLens>& lenses = {});

// For report.json, one entry a photograph under `cameras`; names: one each.
nlohmann::ordered_json photo_cameras_json(const PhotoCameras& found, const std::vector<std::string>& names);
// For people: a line a photograph, what the photographs say together, and the doubts.
std::string photo_cameras_text(const PhotoCameras& found, const std::vector<std::string>& names);

}  // namespace gld
