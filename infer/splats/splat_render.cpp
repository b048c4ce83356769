#include "infer/splats/splat_render.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/splats/scene_fit.h"
#include "datasets/splats/splat_picture.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/base/run_journal.h"
#include "gld/base/yaml_text.h"
#include "gld/machine/timing.h"
#include "gld/report/progress.h"
#include "gld/report/provenance.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "gld/splatting/splat_ply.h"
#include "infer/export/image_export.h"

#include <algorithm>
#include <filesystem>
#include <iostream>

#include <fmt/format.h>

namespace gld {
namespace {

// Returns the cameras that a path is made from: those that a fit names as its sources, or all.
std::vector<Camera> path_sources(const CameraList& list) {
  std::vector<Camera> sources, all;
  for (const CameraRecord& record : list.records) {
    all.push_back(record.camera);
    if (record.role == "source") sources.push_back(record.camera);
  }
  return sources.empty() ? all : sources;
}

}  // namespace

std::filesystem::path splat_file_in(const std::filesystem::path& place, const std::string& name) {
  return std::filesystem::is_directory(place) ? place / name : place;
}

SplatRenderOptions::SplatRenderOptions() {
  path.frames = 30;
  projection.near = 0;
}

void SplatRenderOptions::visit(FieldVisitor& visitor) {
  visitor.text({"splats", "what is drawn: a run folder of gld splat fit, or a PLY file of 3DGS"}, splats);
  visitor.text(
      {"cameras",
       "cameras.json, or a folder with one, whose cameras the path is about; empty: of the run folder"},
      cameras);
  visit_out(visitor, out, overwrite);
  visit_threads(visitor, threads);
  visit_choice(
      visitor,
      {"show",
       "colours, latents of gld splat fit --features decoded, or what the refiner makes of these or of colours"},
      show, {"colours", "latents", "refined"});
  visitor.text({"model", "of latents: the model bundle that they were encoded with"}, model);
  visitor.group({"path", "where the cameras go"}, path);
  visitor.group({"projection", "how Gaussians are drawn"}, projection);
}

void SplatRenderOptions::check() const {
  check_out(out, "runs/splat_views");
  if (splats.empty())
    fail({"--splats", "a run folder of gld splat fit or a PLY file", "nothing",
          "add for example --splats runs/splats"});
  if (cameras.empty() && !std::filesystem::is_directory(splats)) {
    fail({"--cameras", "a cameras.json beside a file of Gaussians", "nothing",
          "name one, or the run folder in --splats"});
  }
  if (show != SplatShown::kColours && !std::filesystem::is_directory(splats)) {
    fail({"--show", "colours of a file of Gaussians, which has no latents", "another choice",
          "name the run folder of gld splat fit --features in --splats"});
  }
  path.check();
}

namespace {

// Returns how Gaussians are drawn: as they were fitted, where they come with their run and the options do not say
// otherwise.
ProjectionOptions projection_of(const SplatRenderOptions& options) {
  const std::filesystem::path run = options.splats;
  const auto configuration = run / kRunConfiguration, report = run / "report.json";
  const bool says = to_yaml(options.projection) != to_yaml(SplatRenderOptions().projection);
  if (says || !std::filesystem::is_regular_file(configuration) || !std::filesystem::is_regular_file(report))
    return options.projection;
  ProjectionOptions projection;
  const auto fitted = parse_yaml(read_file(configuration), configuration.string());
  if (fitted["fit"] && fitted["fit"]["projection"]) {
    YAML::Emitter text;
    text << fitted["fit"]["projection"];
    load_yaml_text(projection, text.c_str(), configuration.string());
  }
  const auto found = parse_json(read_file(report), report.string());
  if (found.contains("near") && found.at("near").is_number())
    projection.near = found.at("near").get<double>();
  return projection;
}

}  // namespace

void run_splat_render(const SplatRenderOptions& options,
                      const std::function<DrawSplats(const DrawnSplats&)>& make_drawing) {
  options.check();
  check_run_folder(options.out, "splat render", earlier_run(options.overwrite));
  const auto file = splat_file_in(options.splats, kSplatFile);
  const GaussianSet set = read_splat_ply(file);
  const CameraList list = read_cameras_json(
      splat_file_in(options.cameras.empty() ? options.splats : options.cameras, kSplatCamerasFile));
  const std::vector<Camera> sources = path_sources(list);
  PathSurroundings surroundings;
  for (const CameraRecord& record : list.records) surroundings.cameras.push_back(record.camera);
  const CameraPath path = make_camera_path(options.path, sources, surroundings);
  ProjectionOptions projection = projection_of(options);
  if (projection.near == 0)
    projection.near = kNearShare * std::max(known_reach(sources, surroundings), 1e-30);
  KernelSettings settings;
  settings.threads = static_cast<int>(threads_to_use(options.threads));
  DrawSplats draw = [&](Camera& camera) {
    return image_of(splat_picture(set, camera, projection, settings).image);
  };
  if (options.show != SplatShown::kColours) draw = make_drawing({set, projection, file, settings});
  RunFolder run(options.out, "splat render", options, earlier_run(options.overwrite));
  const Provenance provenance = make_provenance("splat render", options);
  CameraList written;
  written.metric = list.metric;
  const auto views = static_cast<int64_t>(path.cameras.size());
  Progress progress({"views", views, 0, run.path()});
  double seconds = 0;
  const auto folder = run.subfolder("images");
  for (int64_t view = 0; view < views; ++view) {
    stop_if_interrupted(fmt::format("{} of {} views are in {}", view, views, folder.string()));
    CameraRecord record;
    record.name = view_name(view, views);
    record.role = "target";
    record.camera = path.cameras[static_cast<size_t>(view)];
    record.image = "images/" + record.name + ".png";
    Image picture;
    seconds += seconds_of([&] { picture = draw(record.camera); });
    export_image(run.path() / record.image, picture, provenance);
    written.records.push_back(record);
    progress.update(view + 1);
  }
  progress.finish();
  write_cameras_json(run.path() / kSplatCamerasFile, written);
  nlohmann::ordered_json report;
  report["gaussians"] = set.size();
  report["views"] = views;
  report["seconds_a_view"] = seconds / static_cast<double>(std::max<int64_t>(1, views));
  report["near"] = projection.near;
  if (!path.note.empty()) report["path"] = path.note;
  run.write_report(report);
  print_warnings(path.warnings);
  run.note("views", "images/");
  run.note("cameras", kSplatCamerasFile);
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
