#pragma once

#include "datasets/formats/frame_pixels.h"
#include "datasets/scenes/lens_distortion.h"

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace gld {

// A COLMAP reconstruction as its files store it. Poses are camera_from_world, OpenCV axes; pixels are counted so that
// the first centre is at (0.5, 0.5), as here.
struct ColmapCamera {
  std::string model;  // "SIMPLE_RADIAL"
  int64_t width = 0;
  int64_t height = 0;
  std::vector<double> parameters;  // in the model's order
};

// Where an image shows a point.
struct ColmapSighting {
  uint64_t point = 0;                                  // its id
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  // pixels, distorted as in the photograph
};

struct ColmapImage {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  int64_t camera_id = 0;
  std::string name;  // path below the image folder
  // For writing; much more than the model itself, so that reading is read_colmap_sightings()'s.
  std::vector<ColmapSighting> sightings;
};

// What a reconstruction says of a point beside its place and where it is seen.
struct ColmapPointLooks {
  std::array<uint8_t, 3> colour{128, 128, 128};
  double error = 0;  // pixels; -1: not known
};

struct ColmapModel {
  std::map<int64_t, ColmapCamera> cameras;       // by id
  std::vector<ColmapImage> images;               // by name, natural order
  std::vector<Eigen::Vector3d> points_in_world;  // by id; written with the ids 1, 2, ...
  std::vector<ColmapPointLooks> point_looks;     // for writing, one a point, or none
  std::vector<std::string> comments;             // for writing, lines of text files; binary ones hold none
};

// For writers: the track of each point of a model, the images (counted from 1) that show it and the place in their
// sightings (counted from 0). Throws Error for a sighting of a point that the model does not have.
struct ColmapTrackElement {
  int64_t image_id = 0;
  int64_t sighting = 0;
};
std::vector<std::vector<ColmapTrackElement>> colmap_tracks(const ColmapModel& model);

enum class ColmapForm { kText, kBinary };

// These read and write cameras, images and, where it exists, points3D of the form. Errors name the file and the line or
// byte. Counts in binary files are checked against the file's size before memory is taken.
ColmapModel read_colmap_model(const std::filesystem::path& folder, ColmapForm form);
void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model, ColmapForm form);

// The folder of model files at or below a scene (itself, sparse/0, sparse, colmap/sparse/0), or empty.
struct ColmapLocation {
  std::filesystem::path folder;
  ColmapForm form = ColmapForm::kBinary;
};
ColmapLocation find_colmap_model(const std::filesystem::path& scene);

// What the parameters mean. Error for the model FOV and unknown ones, and for wrong counts.
struct ColmapLens {
  Eigen::Matrix3d intrinsics = Eigen::Matrix3d::Identity();
  LensDistortion lens;
};
ColmapLens colmap_lens(const ColmapCamera& camera, const std::string& where);

// Returns what the model says of an image whose file was found: pose, lens and size. Throws Error when its camera is
// not in the model.
FrameRecord colmap_record(const ColmapModel& model, const ColmapImage& image,
                          const std::filesystem::path& image_file, const std::string& where);

// Name and number of parameters of the models by their number in binary files.
struct ColmapModelKind {
  const char* name;
  size_t parameters;
};
const std::vector<ColmapModelKind>& colmap_model_kinds();

}  // namespace gld
