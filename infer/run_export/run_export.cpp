#include "infer/run_export/run_export.h"

#include "gld/base/atomic_file.h"
#include "gld/base/atomic_folder.h"
#include "gld/base/command_options.h"
#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/base/json_text.h"
#include "gld/base/work_folder.h"
#include "gld/report/report_text.h"
#include "gld/report/run_folder.h"
#include "infer/export/ply_file.h"
#include "infer/run_export/colmap_export.h"
#include "infer/run_export/export_provenance.h"
#include "infer/run_export/film.h"
#include "infer/run_export/film_export.h"
#include "infer/run_export/finished_run.h"
#include "infer/run_export/glb_file.h"
#include "infer/run_export/nerfstudio_export.h"

#include <algorithm>
#include <cmath>
#include <iostream>
#include <optional>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kCommand = "export";

// These options can change the files of a format.
struct ExportFormat {
  std::string name;
  std::string output;  // in the run folder
  std::vector<std::string> options;
};

const std::vector<ExportFormat>& formats() {
  static const std::vector<ExportFormat> known{
      {"glb", "scene.glb", {"max_points", "surface_vertices", "edge_step", "far_limit"}},
      {"colmap", "colmap", {"max_points"}},
      {"nerfstudio", "nerfstudio", {}},
      {"webp", "path.webp", {"between", "views_per_second"}},
      {"mp4", "path.mp4", {"between", "views_per_second"}}};
  return known;
}

bool looks_at(const ExportFormat& format, const std::string& option) {
  return std::find(format.options.begin(), format.options.end(), option) != format.options.end();
}

std::string names_text(const std::vector<std::string>& names) {
  std::string text;
  for (size_t i = 0; i < names.size(); ++i) {
    if (i > 0) text += i + 1 == names.size() ? " or " : ", ";
    text += names[i];
  }
  return text;
}

// Returns the options that say what is in the files.
std::vector<std::string> options_of_results() {
  std::vector<std::string> names;
  for (const ExportFormat& format : formats())
    names.insert(names.end(), format.options.begin(), format.options.end());
  return names;
}

class Exporter {
 public:
  Exporter(const ExportOptions& options, const FinishedRun& run, RunFolder& folder)
      : options_(options), run_(run), folder_(folder) {
    report_["command"] = kCommand;
    report_["options"] = to_json(options);
    report_["model"] = {{"hash", run.model_hash}};
    report_["seed"] = run.seed;
  }

  void write(const ExportFormat& format) {
    stop_if_interrupted("the formats before " + format.name + " are in " + folder_.path().string());
    if (format.name == "glb") write_glb_format(format);
    if (format.name == "colmap") write_colmap(format);
    if (format.name == "nerfstudio") write_nerfstudio(format);
    if (format.name == "webp") write_webp(format);
    if (format.name == "mp4") write_mp4(format);
    folder_.note(format.name, format.output);
  }

  void finish() {
    if (film_) report_["film"] = film_json(run_, *film_);
    report_["warnings"] = warnings_;
    folder_.write_report(report_);
    folder_.note("report", "report.json");
    print_warnings(warnings_);
    if (film_) std::cout << film_text() << "\n";
    std::cout << folder_.closing_box();
  }

 private:
  TextItems provenance(const ExportFormat& format) const {
    const nlohmann::json all = to_json(options_);
    nlohmann::json used = nlohmann::json::object();
    for (const std::string& name : format.options) used[name] = all.at(name);
    return export_provenance(run_, json_text(used));
  }

  std::filesystem::path place(const ExportFormat& format) const { return folder_.path() / format.output; }

  void warn(const std::string& sentence) {
    if (std::find(warnings_.begin(), warnings_.end(), sentence) == warnings_.end())
      warnings_.push_back(sentence);
  }

  // Returns the run's cloud, thinned; it is empty, with a warning, where there is none.
  const PointCloud& cloud() {
    if (cloud_) return *cloud_;
    cloud_.emplace();
    if (run_.cloud.empty()) {
      warn("There are no points, because " + run_.cloud_missing + ".");
      return *cloud_;
    }
    cloud_ = read_ply(run_.cloud).cloud;
    thin_point_cloud(*cloud_, options_.max_points);
    return *cloud_;
  }

  const Film& film() {
    if (film_) return *film_;
    film_folder_.emplace("film");
    FilmOptions film_options;
    film_options.between = options_.between;
    film_options.views_a_second = options_.views_per_second;
    film_ = make_film(run_, film_options, film_folder_->path());
    return *film_;
  }

  std::string film_text() const {
    std::string text =
        fmt::format("{} pictures at {} a second, {}", film_->shown.size(), film_->pictures_a_second,
                    film_->closes ? "once around, because the path closes"
                                  : "there and back, because the path does not close");
    const std::string carried = carried_frames_text(*film_);
    if (!carried.empty()) text += "; carried by depth between generated views, and not generated: " + carried;
    return text;
  }

  void write_glb_format(const ExportFormat& format) {
    GlbScene scene;
    scene.cloud = cloud();
    scene.provenance = provenance(format);
    std::vector<DepthMap> maps;
    std::vector<float> known;
    int64_t pixels = 0;
    for (const RunView& view : run_.views) {
      maps.push_back(view.has_depth() ? view.depth_map() : DepthMap());
      pixels += static_cast<int64_t>(maps.back().metres.size());
      std::copy_if(maps.back().metres.begin(), maps.back().metres.end(), std::back_inserter(known),
                   is_known_depth);
    }
    DepthSurfaceOptions surface;
    surface.edge_step = options_.edge_step;
    while (pixels > options_.surface_vertices * surface.step * surface.step) ++surface.step;
    if (!known.empty()) {
      const auto middle = known.begin() + static_cast<std::ptrdiff_t>(known.size() / 2);
      std::nth_element(known.begin(), middle, known.end());
      scene.typical_depth = *middle;
      if (options_.far_limit > 0) surface.farthest = options_.far_limit * scene.typical_depth;
    }
    int64_t vertices = 0, triangles = 0;
    for (size_t i = 0; i < run_.views.size(); ++i) {
      const RunView& view = run_.views[i];
      GlbView shown;
      shown.name = view.name;
      shown.target = view.target;
      shown.camera = view.camera;
      if (!maps[i].empty()) {
        shown.surface = depth_surface(maps[i], view.depth_camera, surface);
        shown.png = read_file(view.image);
      }
      vertices += static_cast<int64_t>(shown.surface.x_in_camera.size());
      triangles += static_cast<int64_t>(shown.surface.corners.size() / 3);
      scene.views.push_back(std::move(shown));
    }
    if (known.empty())
      warn("There are no surfaces, because the run has no depth in the world of its cameras.");
    write_glb(place(format), scene);
    const Eigen::Vector3d moved = Eigen::Vector3d::Zero() - glb_origin(scene);
    report_["glb"] = {{"points", scene.cloud.size()},
                      {"surface_step", surface.step},
                      {"vertices", vertices},
                      {"triangles", triangles},
                      {"recentred_by", {moved.x(), moved.y(), moved.z()}}};
  }

  void write_colmap(const ExportFormat& format) {
    AtomicFolder whole(place(format));
    const ColmapCounts counts = export_colmap(whole.temporary(), run_, cloud(), provenance(format));
    whole.commit();
    report_["colmap"] = {{"images", run_.views.size()},
                         {"points", counts.points},
                         {"sightings", counts.sightings},
                         {"seen_once", counts.seen_once},
                         {"seen_nowhere", counts.seen_nowhere}};
  }

  void write_nerfstudio(const ExportFormat& format) {
    AtomicFolder whole(place(format));
    export_nerfstudio(whole.temporary(), run_, provenance(format));
    whole.commit();
    if (run_.cloud.empty()) warn("There are no points, because " + run_.cloud_missing + ".");
    report_["nerfstudio"] = {{"images", run_.views.size()}};
  }

  void write_webp(const ExportFormat& format) {
    export_webp(place(format), film(), film_provenance(run_, film(), provenance(format)));
  }

  void write_mp4(const ExportFormat& format) {
    export_mp4(place(format), film(), film_provenance(run_, film(), provenance(format)), require_ffmpeg());
  }

  const ExportOptions& options_;
  const FinishedRun& run_;
  RunFolder& folder_;
  nlohmann::ordered_json report_;
  std::vector<std::string> warnings_;
  std::optional<PointCloud> cloud_;
  std::optional<WorkFolder> film_folder_;
  std::optional<Film> film_;
};

bool asked_for(const ExportOptions& options, const std::string& format) {
  return std::find(options.as.begin(), options.as.end(), format) != options.as.end();
}

// Checks what a run must have, before anything is written.
void check_run(const ExportOptions& options, const FinishedRun& run) {
  const std::string where = run.folder.string();
  const std::string remedy = "sample again with --outputs image,depth,points";
  for (const RunView& view : run.views) {
    if (view.image.empty()) fail({where, "pictures of all views", "none of " + view.name, remedy});
  }
  const bool films = asked_for(options, "webp") || asked_for(options, "mp4");
  if (films) check_film(run, options.between);
  if (asked_for(options, "mp4")) require_ffmpeg();
  const bool has_depth =
      std::any_of(run.views.begin(), run.views.end(), [](const RunView& view) { return view.has_depth(); });
  if (asked_for(options, "glb") && !has_depth && run.cloud.empty())
    fail({where, "depth or points for --as glb", "neither", remedy + ", or leave glb out"});
}

}  // namespace

const std::vector<std::string>& export_format_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> result;
    for (const ExportFormat& format : formats()) result.push_back(format.name);
    return result;
  }();
  return names;
}

void ExportOptions::visit(FieldVisitor& visitor) {
  visitor.text({"run", "the run folder of gld sample; also without the flag"}, run);
  visitor.texts({"as", "formats, some of glb, colmap, nerfstudio, webp, mp4"}, as);
  visit_out(visitor, out, overwrite);
  visitor.integer({"max_points", "glb, colmap: thin the cloud to at most this many points"}, max_points,
                  {1, 1'000'000'000});
  visitor.integer({"surface_vertices", "glb: coarser surfaces where those of all views have more vertices"},
                  surface_vertices, {4, 100'000'000});
  visitor.real({"edge_step", "glb: surfaces are cut where inverse depth steps by this share of itself"},
               edge_step, {1e-6, 1e6});
  visitor.real(
      {"far_limit", "glb: surfaces without what is deeper than this many median depths (0: with all)"},
      far_limit, {0, 1e30});
  visitor.integer({"between", "webp, mp4: pictures between two views, carried by their depth"}, between,
                  {0, 30});
  visitor.integer({"views_per_second", "webp, mp4: how fast the views follow each other"}, views_per_second,
                  {1, 30});
}

void ExportOptions::check() const {
  check_out(out, "runs/exported");
  const std::string known = names_text(export_format_names());
  if (as.empty()) fail({"--as", "some of " + known, "nothing", "add for example --as glb"});
  for (size_t i = 0; i < as.size(); ++i) {
    const auto& names = export_format_names();
    if (std::find(names.begin(), names.end(), as[i]) == names.end()) {
      const std::string nearest = nearest_name(as[i], names);
      fail({"--as", known, "\"" + as[i] + "\"",
            nearest.empty() ? "choose one of these" : "did you mean \"" + nearest + "\"?"});
    }
    if (std::find(as.begin(), as.begin() + static_cast<std::ptrdiff_t>(i), as[i]) !=
        as.begin() + static_cast<std::ptrdiff_t>(i)) {
      fail({"--as", "each format once", as[i] + " twice", "leave one out"});
    }
  }
  const std::vector<std::string> of_results = options_of_results();
  for (const std::string& key : named) {
    if (std::find(of_results.begin(), of_results.end(), key) == of_results.end()) continue;
    std::vector<std::string> takers;
    for (const ExportFormat& format : formats()) {
      if (looks_at(format, key)) takers.push_back(format.name);
    }
    const bool looked_at = std::any_of(takers.begin(), takers.end(), [&](const std::string& name) {
      return std::find(as.begin(), as.end(), name) != as.end();
    });
    if (looked_at) continue;
    std::string flag = "--" + key;
    std::replace(flag.begin(), flag.end(), '_', '-');
    fail({flag, names_text(takers) + " in --as, without which nothing looks at it", "none",
          "change that, or leave " + flag + " out"});
  }
}

void run_export(const ExportOptions& options) {
  options.check();
  if (options.run.empty()) {
    fail({"gld export", "the run folder of a gld sample", "nothing",
          "name one, for example gld export runs/first --as glb --out runs/first_glb"});
  }
  const EarlierRun earlier = earlier_run(options.overwrite);
  check_run_folder(options.out, kCommand, earlier);
  const FinishedRun run = open_finished_run(options.run);
  check_run(options, run);
  RunFolder folder(options.out, kCommand, options, earlier);
  Exporter exporter(options, run, folder);
  for (const ExportFormat& format : formats()) {
    if (asked_for(options, format.name)) exporter.write(format);
  }
  exporter.finish();
}

}  // namespace gld
