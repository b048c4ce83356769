#include "infer/run_export/film.h"

#include "datasets/images/image_file.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/photogrammetry/photograph_composition.h"
#include "gld/report/progress.h"
#include "infer/paths/spline_path.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <Eigen/Geometry>
#include <fmt/format.h>

namespace gld {
namespace {

constexpr double kNearlyAStep = 1.5;
// Depth of generated views says where their pixels lie to a few per cent; more is not looked for, so that it stays
// smooth from picture to picture.
constexpr double kDepthReach = 0.05;

struct Way {
  double distance = 0;
  double angle = 0;
};

Way way(const Camera& from, const Camera& to) {
  const Eigen::Isometry3d& a = from.world_from_camera;
  const Eigen::Isometry3d& b = to.world_from_camera;
  return {(b.translation() - a.translation()).norm(),
          Eigen::Quaterniond(a.linear()).angularDistance(Eigen::Quaterniond(b.linear()))};
}

std::vector<size_t> filmed_views(const FinishedRun& run) {
  std::vector<size_t> filmed;
  for (size_t i = 0; i < run.views.size(); ++i) {
    if (run.views[i].target && !run.views[i].image.empty()) filmed.push_back(i);
  }
  return filmed;
}

PicturedView pictured(const RunView& view) {
  PicturedView result;
  result.camera = view.camera;
  result.depth = planar_depth(view.depth_map());
  const Image image = view.picture();
  result.width = image.width;
  result.height = image.height;
  for (const uint8_t value : image.rgb) result.rgb.push_back(static_cast<float>(value) / 255);
  return result;
}

Image image_of(const std::vector<float>& rgb, int64_t width, int64_t height) {
  Image image(width, height);
  for (size_t i = 0; i < rgb.size(); ++i) {
    image.rgb[i] = static_cast<uint8_t>(std::lround(255 * std::clamp(rgb[i], 0.0F, 1.0F)));
  }
  return image;
}

// Cameras of a closed path with those before its beginning and behind its end, so that it is smooth there too.
struct SplinePath {
  std::vector<Camera> cameras;
  double first = 0;  // position of the first view
};

SplinePath spline_of(const std::vector<Camera>& cameras, bool closes) {
  if (!closes) return {cameras, 0};
  SplinePath path;
  path.cameras.push_back(cameras.back());
  path.cameras.insert(path.cameras.end(), cameras.begin(), cameras.end());
  for (size_t i = 0; i < 2; ++i) path.cameras.push_back(cameras[i]);
  path.first = 1;
  return path;
}

void require_depth(const FinishedRun& run, const std::vector<size_t>& filmed) {
  for (const size_t view : filmed) {
    if (run.views[view].has_depth()) continue;
    fail({"--between", "depth of the target views, which carries pictures between them",
          "none of " + run.views[view].name + " in " + run.folder.string(),
          "sample with --outputs image,depth,points, or leave --between out"});
  }
}

}  // namespace

void check_film(const FinishedRun& run, int64_t between) {
  const std::vector<size_t> filmed = filmed_views(run);
  if (filmed.empty()) {
    fail({run.folder.string(), "pictures of target views", "none",
          "sample with --outputs image,depth,points, or leave webp and mp4 out"});
  }
  const Camera& first = run.views[filmed.front()].camera;
  for (const size_t view : filmed) {
    const Camera& camera = run.views[view].camera;
    if (camera.width == first.width && camera.height == first.height) continue;
    fail({run.folder.string(), "target views of one size, " + size_text(first.width, first.height),
          size_text(camera.width, camera.height) + " of " + run.views[view].name, "leave webp and mp4 out"});
  }
  if (between > 0) require_depth(run, filmed);
}

bool path_closes(const std::vector<Camera>& cameras) {
  if (cameras.size() < 3) return false;
  Way longest;
  for (size_t i = 0; i + 1 < cameras.size(); ++i) {
    const Way step = way(cameras[i], cameras[i + 1]);
    longest.distance = std::max(longest.distance, step.distance);
    longest.angle = std::max(longest.angle, step.angle);
  }
  const Way back = way(cameras.back(), cameras.front());
  return back.distance <= kNearlyAStep * longest.distance && back.angle <= kNearlyAStep * longest.angle;
}

std::vector<size_t> shown_frames(size_t frames, bool closes) {
  std::vector<size_t> shown;
  for (size_t i = 0; i < frames; ++i) shown.push_back(i);
  if (closes) return shown;
  for (size_t i = frames; i > 2; --i) shown.push_back(i - 2);
  return shown;
}

Film make_film(const FinishedRun& run, const FilmOptions& options, const std::filesystem::path& folder) {
  check_film(run, options.between);
  const std::vector<size_t> filmed = filmed_views(run);
  std::vector<Camera> cameras;
  cameras.reserve(filmed.size());
  for (const size_t view : filmed) cameras.push_back(run.views[view].camera);
  Film film;
  film.width = cameras.front().width;
  film.height = cameras.front().height;
  film.closes = path_closes(cameras);
  film.pictures_a_second = options.views_a_second * (options.between + 1);
  const SplinePath path = spline_of(cameras, film.closes);
  const size_t segments = film.closes ? filmed.size() : filmed.size() - 1;
  const auto carried = static_cast<int64_t>(segments) * options.between;
  std::optional<Progress> progress;
  if (carried > 0) progress.emplace("pictures between views", carried);
  int64_t done = 0;
  for (size_t i = 0; i < filmed.size(); ++i) {
    const size_t next = filmed[(i + 1) % filmed.size()];
    film.frames.push_back({filmed[i], filmed[i], 0, 1, run.views[filmed[i]].image});
    if (i == segments || options.between == 0) continue;
    const std::vector<PicturedView> around{pictured(run.views[filmed[i]]), pictured(run.views[next])};
    for (int64_t k = 1; k <= options.between; ++k) {
      stop_if_interrupted(fmt::format("{} of {} pictures between views were made", done, carried));
      FilmFrame frame;
      frame.view = filmed[i];
      frame.next_view = next;
      frame.position = static_cast<double>(k) / static_cast<double>(options.between + 1);
      frame.file = folder / fmt::format("between_{:06}.png", done);
      PhotographViewOptions carrying;
      carrying.carry.depth_reach = kDepthReach;
      const Camera camera = spline_camera(path.cameras, path.first + static_cast<double>(i) + frame.position);
      const PhotographView view =
          view_from_photographs(around, {ColourGains{1, 1, 1}, ColourGains{1, 1, 1}}, camera, carrying);
      frame.carried = view.shown_share();
      write_png(frame.file, image_of(filled(view), film.width, film.height));
      film.frames.push_back(frame);
      progress->update(++done);
    }
  }
  if (progress) progress->finish();
  film.shown = shown_frames(film.frames.size(), film.closes);
  return film;
}

std::string carried_frames_text(const Film& film) {
  std::string text;
  for (size_t i = 0; i < film.shown.size(); ++i) {
    if (!film.frames[film.shown[i]].between()) continue;
    size_t last = i;
    while (last + 1 < film.shown.size() && film.frames[film.shown[last + 1]].between()) ++last;
    text += (text.empty() ? "" : ", ") +
            (last == i ? std::to_string(i) : std::to_string(i) + "-" + std::to_string(last));
    i = last;
  }
  return text;
}

TextItems film_provenance(const FinishedRun& run, const Film& film, TextItems provenance) {
  std::string views;
  for (const size_t shown : film.shown) {
    const FilmFrame& frame = film.frames[shown];
    if (!frame.between()) views += (views.empty() ? "" : ", ") + run.views[frame.view].name;
  }
  provenance.emplace_back("gld:frame_views", views);
  if (const std::string carried = carried_frames_text(film); !carried.empty())
    provenance.emplace_back("gld:carried_frames", carried);
  return provenance;
}

nlohmann::ordered_json film_json(const FinishedRun& run, const Film& film) {
  nlohmann::ordered_json json;
  json["width"] = film.width;
  json["height"] = film.height;
  json["pictures_a_second"] = film.pictures_a_second;
  json["pictures"] = film.shown.size();
  json["seconds"] = static_cast<double>(film.shown.size()) / static_cast<double>(film.pictures_a_second);
  json["closes"] = film.closes;
  json["shown"] = film.shown;
  json["frames"] = nlohmann::ordered_json::array();
  for (const FilmFrame& frame : film.frames) {
    const std::string& name = run.views[frame.view].name;
    if (!frame.between()) {
      json["frames"].push_back({{"view", name}});
      continue;
    }
    json["frames"].push_back({{"between", {name, run.views[frame.next_view].name}},
                              {"position", frame.position},
                              {"carried", frame.carried}});
  }
  return json;
}

}  // namespace gld
