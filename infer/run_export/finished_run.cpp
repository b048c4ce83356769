#include "infer/run_export/finished_run.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/file_listing.h"
#include "datasets/formats/json_file.h"
#include "datasets/images/image_file.h"
#include "gld/base/error.h"
#include "gld/report/run_folder.h"

#include <algorithm>
#include <map>

namespace gld {
namespace {

constexpr const char* kReport = "report.json";
constexpr const char* kCameras = "cameras.json";
constexpr const char* kCloud = "points.ply";
constexpr double kFarthestStep = 65535;

void require_finished(const std::filesystem::path& folder) {
  const std::string what = "a run folder of gld sample";
  if (!std::filesystem::is_directory(folder)) {
    fail({folder.string(), what, std::filesystem::exists(folder) ? "a file" : "nothing",
          "name the --out of a gld sample"});
  }
  const std::string command = command_of_run(folder);
  if (command != "sample") {
    fail({folder.string(), what, command.empty() ? "a folder without one" : "a run of gld " + command,
          "name the --out of a gld sample"});
  }
  for (const char* name : {kReport, kCameras}) {
    if (std::filesystem::is_regular_file(folder / name)) continue;
    fail({folder.string(), std::string("a finished run, which has ") + name, "one without it",
          "let gld sample come to its end, with --resume where it was stopped"});
  }
}

std::filesystem::path listed_file(const std::filesystem::path& folder, const std::string& listed,
                                  const std::string& where) {
  if (listed.empty()) return {};
  auto file = inside(folder, listed, where);
  if (std::filesystem::is_regular_file(file)) return file;
  fail({where, "the file " + file.string(), "none", "copy the run folder whole, or sample again"});
}

void require_size(int64_t width, int64_t height, const Camera& camera, const std::filesystem::path& file) {
  if (width == camera.width && height == camera.height) return;
  fail({file.string(), "the camera's size " + size_text(camera.width, camera.height),
        size_text(width, height), "copy the run folder whole, or sample again"});
}

bool cloud_is_in_world(const nlohmann::json& report) {
  const auto in_world = report.find("points") != report.end() && report["points"].is_object()
                            ? report["points"].value("in_world", nlohmann::json())
                            : nlohmann::json();
  if (in_world.is_boolean()) return in_world.get<bool>();
  // Programs that did not note it found a scale, or said how the model's cameras fit the given ones.
  return report.contains("depth_scale") || report.contains("pose_alignment");
}

void read_report(FinishedRun& run) {
  const std::string where = (run.folder / kReport).string();
  const nlohmann::json report = read_json_file(run.folder / kReport);
  if (!report.is_object() || !report.contains("model") || !report.contains("options")) {
    fail({where, "the report of a gld sample", "other JSON", "copy the run folder whole, or sample again"});
  }
  run.model_hash = json_text(report["model"], "hash", where + " model");
  run.seed = json_integer(report, "seed", where);
  if (report.contains("precision")) run.precision = json_text(report, "precision", where);
  run.options = identifying_options(report["options"]);
  if (!std::filesystem::is_regular_file(run.folder / kCloud)) {
    run.cloud_missing = "the run has no points.ply (--outputs image,depth,points makes one)";
  } else if (!cloud_is_in_world(report)) {
    run.cloud_missing =
        "points.ply is in the model's own frame, because neither the scale nor cameras were found";
  } else {
    run.cloud = run.folder / kCloud;
  }
}

}  // namespace

Image RunView::picture() const {
  Image result = read_image(image);
  require_size(result.width, result.height, camera, image);
  return result;
}

DepthMap RunView::depth_map() const {
  DepthMap map = read_depth_png(depth, depth_unit);
  require_size(map.width, map.height, depth_camera, depth);
  const auto saturated = static_cast<float>((kFarthestStep - 0.5) * depth_unit);
  for (float& value : map.metres) {
    if (value >= saturated) value = 0;
  }
  return map;
}

PlanarDepth planar_depth(const DepthMap& depth) {
  PlanarDepth result;
  result.width = depth.width;
  result.height = depth.height;
  result.values = depth.metres;
  return result;
}

FinishedRun open_finished_run(const std::filesystem::path& folder) {
  require_finished(folder);
  FinishedRun run;
  run.folder = folder;
  read_report(run);
  const CameraList cameras = read_cameras_json(folder / kCameras);
  run.metric = cameras.metric;
  // With --size photographs depth has cameras of its own.
  std::map<std::string, CameraRecord> of_depth;
  if (std::filesystem::is_regular_file(folder / kDepthCamerasFile)) {
    for (const CameraRecord& record : read_cameras_json(folder / kDepthCamerasFile).records)
      of_depth[record.name] = record;
  }
  for (const CameraRecord& record : cameras.records) {
    const std::string where = (folder / kCameras).string() + " " + record.name;
    RunView view;
    view.name = record.name;
    view.target = record.role == "target";
    view.camera = record.camera;
    view.image = listed_file(folder, record.image, where);
    const auto found = of_depth.find(record.name);
    const CameraRecord& depth = found == of_depth.end() ? record : found->second;
    view.depth_camera = depth.camera;
    view.depth = listed_file(folder, depth.depth, where);
    view.depth_unit = depth.depth_unit;
    run.views.push_back(std::move(view));
  }
  std::stable_partition(run.views.begin(), run.views.end(), [](const RunView& view) { return !view.target; });
  return run;
}

}  // namespace gld
