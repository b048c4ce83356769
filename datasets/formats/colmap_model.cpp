#include "datasets/formats/colmap_model.h"

#include "datasets/formats/colmap_binary.h"
#include "datasets/formats/colmap_text.h"
#include "datasets/formats/file_listing.h"
#include "datasets/images/decoded_pixels.h"
#include "datasets/scenes/frame_checks.h"
#include "gld/base/error.h"

#include <algorithm>

namespace gld {

const std::vector<ColmapModelKind>& colmap_model_kinds() {
  static const std::vector<ColmapModelKind> kinds{{"SIMPLE_PINHOLE", 3},
                                                  {"PINHOLE", 4},
                                                  {"SIMPLE_RADIAL", 4},
                                                  {"RADIAL", 5},
                                                  {"OPENCV", 8},
                                                  {"OPENCV_FISHEYE", 8},
                                                  {"FULL_OPENCV", 12},
                                                  {"FOV", 5},
                                                  {"SIMPLE_RADIAL_FISHEYE", 4},
                                                  {"RADIAL_FISHEYE", 5},
                                                  {"THIN_PRISM_FISHEYE", 12}};
  return kinds;
}

ColmapLens colmap_lens(const ColmapCamera& camera, const std::string& where) {
  const auto& kinds = colmap_model_kinds();
  const auto kind = std::find_if(kinds.begin(), kinds.end(),
                                 [&](const ColmapModelKind& known) { return camera.model == known.name; });
  if (kind == kinds.end() || camera.model == "FOV") {
    fail({where, "a camera model such as PINHOLE, SIMPLE_RADIAL or OPENCV", camera.model,
          "undistort the images with COLMAP's image_undistorter"});
  }
  const std::vector<double>& p = camera.parameters;
  if (p.size() != kind->parameters) {
    fail({where, std::to_string(kind->parameters) + " parameters for " + camera.model,
          std::to_string(p.size()), "correct the file"});
  }
  ColmapLens result;
  LensDistortion& lens = result.lens;
  const std::string& model = camera.model;
  const bool one_focal = model == "SIMPLE_PINHOLE" || model == "SIMPLE_RADIAL" || model == "RADIAL" ||
                         model == "SIMPLE_RADIAL_FISHEYE" || model == "RADIAL_FISHEYE";
  const size_t rest = one_focal ? 3 : 4;
  result.intrinsics =
      one_focal ? intrinsic_matrix(p[0], p[0], p[1], p[2]) : intrinsic_matrix(p[0], p[1], p[2], p[3]);
  if (model == "SIMPLE_PINHOLE" || model == "PINHOLE") return result;
  lens.model = model == "THIN_PRISM_FISHEYE"                ? LensModel::kThinPrismFisheye
               : model.find("FISHEYE") != std::string::npos ? LensModel::kFisheye
                                                            : LensModel::kRadialTangential;
  lens.k1 = p[rest];
  if (model == "SIMPLE_RADIAL" || model == "SIMPLE_RADIAL_FISHEYE") return result;
  lens.k2 = p[rest + 1];
  if (model == "RADIAL" || model == "RADIAL_FISHEYE") return result;
  if (model == "OPENCV_FISHEYE") {
    lens.k3 = p[6];
    lens.k4 = p[7];
    return result;
  }
  lens.p1 = p[6];
  lens.p2 = p[7];
  if (model == "OPENCV") return result;
  lens.k3 = p[8];
  lens.k4 = p[9];
  if (model == "FULL_OPENCV") {
    lens.k5 = p[10];
    lens.k6 = p[11];
  } else {
    lens.sx1 = p[10];
    lens.sy1 = p[11];
  }
  return result;
}

ColmapModel read_colmap_model(const std::filesystem::path& folder, ColmapForm form) {
  ColmapModel model = form == ColmapForm::kText ? read_colmap_text(folder) : read_colmap_binary(folder);
  std::sort(model.images.begin(), model.images.end(),
            [](const ColmapImage& a, const ColmapImage& b) { return natural_less(a.name, b.name); });
  return model;
}

void write_colmap_model(const std::filesystem::path& folder, const ColmapModel& model, ColmapForm form) {
  if (form == ColmapForm::kText) {
    write_colmap_text(folder, model);
  } else {
    write_colmap_binary(folder, model);
  }
}

std::vector<std::vector<ColmapTrackElement>> colmap_tracks(const ColmapModel& model) {
  const size_t points = model.points_in_world.size();
  if (!model.point_looks.empty() && model.point_looks.size() != points) {
    fail({"COLMAP model", std::to_string(points) + " points with colours",
          std::to_string(model.point_looks.size()), "give one a point, or none"});
  }
  std::vector<std::vector<ColmapTrackElement>> tracks(points);
  for (size_t i = 0; i < model.images.size(); ++i) {
    const ColmapImage& image = model.images[i];
    for (size_t k = 0; k < image.sightings.size(); ++k) {
      const uint64_t point = image.sightings[k].point;
      if (point < 1 || point > points) {
        fail({"COLMAP model, image " + image.name, "sightings of points 1 to " + std::to_string(points),
              std::to_string(point), "add the point or leave the sighting out"});
      }
      tracks[point - 1].push_back({static_cast<int64_t>(i) + 1, static_cast<int64_t>(k)});
    }
  }
  return tracks;
}

ColmapLocation find_colmap_model(const std::filesystem::path& scene) {
  for (const auto& folder : {scene, scene / "sparse" / "0", scene / "sparse",
                             scene / "colmap" / "sparse" / "0", scene / "sparse_txt"}) {
    if (is_file(folder / "cameras.bin")) return {folder, ColmapForm::kBinary};
    if (is_file(folder / "cameras.txt") && is_file(folder / "images.txt")) {
      return {folder, ColmapForm::kText};
    }
  }
  return {};
}

FrameRecord colmap_record(const ColmapModel& model, const ColmapImage& image,
                          const std::filesystem::path& image_file, const std::string& where) {
  const auto camera = model.cameras.find(image.camera_id);
  if (camera == model.cameras.end()) {
    fail({where, "camera " + std::to_string(image.camera_id) + " in the model", "none",
          "export the model again"});
  }
  check_picture_size(camera->second.width, camera->second.height, where);
  const ColmapLens lens = colmap_lens(camera->second, where);
  FrameRecord record;
  record.name = image_file.stem().string();
  record.image_file = image_file;
  record.camera_width = camera->second.width;
  record.camera_height = camera->second.height;
  record.intrinsics = lens.intrinsics;
  record.lens = lens.lens;
  record.world_from_camera = checked_pose(QuaternionPose{image.rotation, image.translation}, where).inverse();
  return record;
}

}  // namespace gld
