#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/undistortion.h"
#include "gld/cameras/camera.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <nlohmann/json.hpp>

namespace gld {

// A photograph whose camera is asked for. Pictures and their sizes are upright, turned as EXIF says.
struct UnregisteredPhotograph {
  std::string name;
  std::filesystem::path file;
  int64_t width = 0;        // pixels
  int64_t height = 0;       // pixels
  int64_t lens = 0;         // photographs of one number have one lens, whatever their sizes
  double focal_length = 0;  // by EXIF, over the longer side; 0 where nothing tells

  double longer_side() const { return static_cast<double>(width > height ? width : height); }
};

// A lens as registration finds it: square pixels, the principal point in the picture's middle.
struct RegisteredLens {
  int64_t number = 0;
  double focal_length = 0;       // over the longer side
  double exif_focal_length = 0;  // likewise, what it began with; 0 where nothing told
  LensDistortion distortion;
  int64_t photographs = 0;  // registered ones
};

struct RegisteredPhotograph {
  bool registered = false;
  std::string reason;                                                   // why not, as a phrase
  Eigen::Isometry3d world_from_camera = Eigen::Isometry3d::Identity();  // OpenCV axes
  LensCamera camera;              // of the upright photograph, in its pixels
  int64_t points = 0;             // of the sparse points, how many it shows
  double reprojection_error = 0;  // root mean square over them, pixels of the photograph
};

// Cameras of photographs from what they show in common. The first registered photograph is the world. The unit is the
// median distance along the axis from a camera to a point that its photograph shows: nothing tells another one.
struct Registration {
  std::string way;                                // "colmap" or "features"
  std::vector<RegisteredPhotograph> photographs;  // one each, as they were given
  std::vector<RegisteredLens> lenses;             // those of registered photographs
  std::vector<Eigen::Vector3d> points_in_world;   // sparse
  double reprojection_error =
      0;  // root mean square over all observations of points, pixels of the photographs
  std::vector<std::string> doubts;  // why the cameras are not to be relied on, as phrases

  int64_t registered() const;
};

// Puts the first registered photograph at the origin and makes the unit what Registration says. depths are those of the
// points in the cameras that see them, in the present unit.
void normalise(Registration& registration, std::vector<double> depths);

// Adds what is known to be wrong where photographs say too little: a lens that nobody has, cameras that hang on a few
// points.
void add_doubts(Registration& registration);

// Fewer than two photographs have nothing in common: this throws Error for any way that needs it. where is the option.
void require_several(const std::vector<UnregisteredPhotograph>& photographs, const std::string& where);

// Why a registration of which too little is left is none; reasons come from its photographs. Error where fewer than
// two registered.
void require_registered(const Registration& registration,
                        const std::vector<UnregisteredPhotograph>& photographs, const std::string& where);

// The photograph with the distortion of its lens undone, cut to what the lens saw.
struct IdealPhotograph {
  Camera camera;
  Image image;
};
IdealPhotograph ideal_photograph(const RegisteredPhotograph& photograph, const Image& upright);

// For report.json.
nlohmann::ordered_json registration_json(const Registration& registration,
                                         const std::vector<UnregisteredPhotograph>& photographs);
// For people: what the cameras are from, a line a photograph and a line a lens.
std::string registration_text(const Registration& registration,
                              const std::vector<UnregisteredPhotograph>& photographs);
// Returns one sentence for each photograph that did not register and for each doubt.
std::vector<std::string> registration_warnings(const Registration& registration,
                                               const std::vector<UnregisteredPhotograph>& photographs);

}  // namespace gld
