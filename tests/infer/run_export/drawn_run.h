#pragma once

#include "datasets/formats/cameras_json.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "infer/export/depth_export.h"
#include "infer/export/image_export.h"
#include "infer/export/ply_file.h"
#include "infer/export/point_cloud.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld::test {

// What a run of gld sample would be that gave a drawn room exactly, with the files that it writes.
struct DrawnRun {
  int64_t room = 3;
  int64_t views = 4;
  int64_t sources = 1;
  int64_t width = 48;
  int64_t height = 36;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  // of the whole scene
  int64_t cut = 0;  // columns and rows cut from the left and above: the principal point leaves the middle
  double tall = 1;  // fy over fx, by leaving out rows of what is drawn
  bool depth = true;
  bool points = true;
  bool target_images = true;
};

struct DrawnView {
  Camera camera;
  Image image;
  DepthMap depth;
};

inline DrawnView drawn_view(const Frame& frame, const DrawnRun& run) {
  DrawnView view;
  const Image image = frame.image();
  const DepthMap depth = frame.depth();
  view.camera = frame.camera;
  view.camera.width -= run.cut;
  view.camera.height = static_cast<int64_t>(static_cast<double>(frame.camera.height) * run.tall) - run.cut;
  view.camera.intrinsics(1, 1) *= run.tall;
  view.camera.intrinsics(1, 2) = 0.5 * static_cast<double>(view.camera.height + run.cut);
  for (int axis = 0; axis < 2; ++axis) view.camera.intrinsics(axis, 2) -= static_cast<double>(run.cut);
  view.camera.world_from_camera.translation() += run.offset;
  view.image = Image(view.camera.width, view.camera.height);
  view.depth = DepthMap(view.camera.width, view.camera.height);
  for (int64_t y = 0; y < view.camera.height; ++y) {
    for (int64_t x = 0; x < view.camera.width; ++x) {
      // The middle of the pixel that the camera looks through.
      const auto from = static_cast<int64_t>((static_cast<double>(y + run.cut) + 0.5) / run.tall);
      const uint8_t* pixel = image.pixel(x + run.cut, std::min(from, image.height - 1));
      std::copy(pixel, pixel + 3, view.image.pixel(x, y));
      view.depth.at(x, y) = depth.at(x + run.cut, std::min(from, image.height - 1));
    }
  }
  return view;
}

inline std::vector<DrawnView> write_drawn_run(const std::filesystem::path& folder, const DrawnRun& run) {
  SyntheticOptions options;
  options.frames = run.views;
  options.width = run.width;
  options.height = run.height;
  const Scene scene = make_synthetic_scene(options, run.room);
  for (const char* name : {"sources", "images", "depth"}) std::filesystem::create_directories(folder / name);
  Provenance provenance;
  provenance.program = "gld";
  provenance.seed = 7;
  std::vector<DrawnView> views;
  views.reserve(scene.frames.size());
  for (const Frame& frame : scene.frames) views.push_back(drawn_view(frame, run));
  std::vector<DepthMap> maps;
  maps.reserve(views.size());
  for (const DrawnView& view : views) maps.push_back(view.depth);
  const double unit = choose_depth_unit(maps);
  CameraList list;
  std::vector<PointView> lifted;
  for (size_t i = 0; i < views.size(); ++i) {
    const bool target = static_cast<int64_t>(i) >= run.sources;
    CameraRecord record;
    record.name = view_name(static_cast<int64_t>(i), run.views);
    record.role = target ? "target" : "source";
    record.camera = views[i].camera;
    if (!target || run.target_images) {
      record.image = (target ? "images/" : "sources/") + record.name + ".png";
      export_image(folder / record.image, views[i].image, provenance);
    }
    if (run.depth) {
      record.depth = "depth/" + record.name + ".png";
      record.depth_unit = unit;
      export_depth_png(folder / record.depth, views[i].depth, unit, provenance);
    }
    list.records.push_back(record);
    lifted.push_back({views[i].camera, views[i].image, views[i].depth, {}, {}, {}, {}});
  }
  write_cameras_json(folder / "cameras.json", list);
  if (run.points) {
    PointCloudOptions cloud;
    cloud.confidence_quantile = 0;
    export_ply(folder / "points.ply", build_point_cloud(lifted, 1, cloud), provenance);
  }
  write_file_atomically(folder / "config.yaml",
                        "# gld sample: the options of this run, defaults included\nseed: 7\n");
  nlohmann::ordered_json report{
      {"command", "sample"},
      {"model", {{"hash", "0123456789abcdef"}}},
      {"options", {{"scene", "/home/somebody/rooms/one"}, {"out", "runs/one"}, {"seed", 7}}},
      {"precision", "float32"},
      {"seed", 7},
      {"depth_scale", {{"scale", 1}}}};
  write_file_atomically(folder / "report.json", json_text(report, 2));
  return views;
}

}  // namespace gld::test
