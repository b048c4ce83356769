#include "infer/page/sample_page.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/images/image_file.h"
#include "datasets/pictures/colour_map.h"
#include "datasets/pictures/depth_preview.h"
#include "gld/base/error.h"
#include "gld/cameras/relative_cameras.h"
#include "gld/page/run_report.h"
#include "gld/splatting/splat_ply.h"
#include "infer/export/ply_file.h"
#include "infer/page/page_cloud.h"
#include "infer/page/page_pictures.h"
#include "infer/page/page_splats.h"
#include "infer/page/run_words.h"

#include <algorithm>
#include <functional>
#include <map>
#include <optional>

#include <fmt/format.h>

namespace gld {
namespace {

using Json = nlohmann::ordered_json;

// What a view of the run has on the page.
struct PageView {
  CameraRecord record;
  std::string name;  // the frame's
  Image picture;
  Image truth;
  DepthMap depth;
};

// Reads parts of a run folder, and keeps a sentence for each that cannot be read.
class RunParts {
 public:
  explicit RunParts(const std::filesystem::path& run) : run_(run) {}

  bool has(const std::string& file) const {
    std::error_code error;
    return std::filesystem::exists(run_ / file, error);
  }
  // Calls read with the path of a file; what it throws becomes a doubt.
  void read(const std::string& file, const std::function<void(const std::filesystem::path&)>& read) {
    const std::filesystem::path inside = std::filesystem::path(file).lexically_normal();
    if (inside.is_absolute() || (!inside.empty() && *inside.begin() == "..")) {
      doubts_.push_back(file + " is left out of this page: it lies outside of the run folder.");
    } else if (!has(file)) {
      doubts_.push_back(file + " is left out of this page: the file is missing.");
    } else {
      try {
        read(run_ / inside);
      } catch (const Error& error) {
        doubts_.push_back(fmt::format("{} is left out of this page: expected {}, found {}.", file,
                                      error.parts().expected, error.parts().found));
      }
    }
  }
  const std::vector<std::string>& doubts() const { return doubts_; }

 private:
  std::filesystem::path run_;
  std::vector<std::string> doubts_;
};

std::vector<PageView> read_views(RunParts& parts, const Json& report, bool& metric) {
  std::vector<PageView> views;
  parts.read("cameras.json", [&](const auto& file) {
    const CameraList list = read_cameras_json(file);
    metric = list.metric;
    for (const CameraRecord& record : list.records) {
      PageView view;
      view.record = record;
      view.name = report_text_at(report, "/scene/views/" + std::to_string(views.size()));
      if (view.name.empty()) view.name = record.name;
      views.push_back(std::move(view));
    }
  });
  if (parts.has(kDepthCamerasFile)) {
    parts.read(kDepthCamerasFile, [&](const auto& file) {
      for (const CameraRecord& record : read_cameras_json(file).records) {
        for (PageView& view : views) {
          if (view.record.name != record.name) continue;
          view.record.depth = record.depth;
          view.record.depth_unit = record.depth_unit;
        }
      }
    });
  }
  for (PageView& view : views) {
    const CameraRecord& record = view.record;
    if (!record.image.empty()) {
      parts.read(record.image, [&](const auto& file) { view.picture = read_image(file); });
    }
    if (!record.depth.empty()) {
      parts.read(record.depth,
                 [&](const auto& file) { view.depth = read_depth_png(file, record.depth_unit); });
    }
    const std::string truth = std::string(kTruthFolder) + "/" + record.name + ".png";
    if (record.role == "target" && parts.has(truth)) {
      parts.read(truth, [&](const auto& file) { view.truth = read_image(file); });
    }
  }
  return views;
}

// Returns the value of the row with that name in a list of the report; null without one.
const Json& row_value(const Json& report, const std::string& list, const std::string& name,
                      const std::string& key) {
  static const Json none;
  for (const Json& row : report_value(report, list)) {
    if (row.is_object() && row.contains("view") && row["view"] == name && row.contains(key)) return row[key];
  }
  return none;
}

// Returns the source that stands nearest to each view, by number; -1 for a source and where there is none.
std::vector<int64_t> nearest_sources(const std::vector<PageView>& views) {
  Views sources;
  std::vector<int64_t> numbers;
  for (size_t i = 0; i < views.size(); ++i) {
    if (views[i].record.role != "source") continue;
    sources.cameras.push_back(views[i].record.camera);
    numbers.push_back(static_cast<int64_t>(i));
  }
  sources.num_sources = static_cast<int64_t>(numbers.size());
  std::vector<int64_t> nearest;
  for (const PageView& view : views) {
    nearest.push_back(-1);
    if (numbers.empty() || view.record.role == "source") continue;
    Views with = sources;
    with.cameras.push_back(view.record.camera);
    nearest.back() = numbers[static_cast<size_t>(nearest_source(with, sources.num_sources))];
  }
  return nearest;
}

Json pose_rows(const Eigen::Isometry3d& world_from_camera, const Eigen::Vector3d& origin) {
  Json rows = Json::array();
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) rows.push_back(world_from_camera.linear()(row, column));
    rows.push_back(world_from_camera.translation()[row] - origin[row]);
  }
  return rows;
}

Json views_json(const std::vector<PageView>& views, const Json& report, const Eigen::Vector3d& origin,
                const DepthRange& range, PagePictures& pictures) {
  Json list = Json::array();
  const auto nearest = nearest_sources(views);
  for (size_t i = 0; i < views.size(); ++i) {
    const PageView& view = views[i];
    const Camera& camera = view.record.camera;
    Json json{{"name", view.name},
              {"file", view.record.image.empty() ? view.record.name : view.record.image},
              {"role", view.record.role},
              {"width", camera.width},
              {"height", camera.height},
              {"fx", camera.intrinsics(0, 0)},
              {"fy", camera.intrinsics(1, 1)},
              {"cx", camera.intrinsics(0, 2)},
              {"cy", camera.intrinsics(1, 2)},
              {"world_from_camera", pose_rows(camera.world_from_camera, origin)}};
    if (!view.picture.empty()) json["picture"] = pictures.add(view.picture);
    if (!view.truth.empty()) json["truth"] = pictures.add(view.truth);
    if (!view.depth.empty()) json["depth"] = pictures.add(coloured_depth(view.depth, range));
    if (nearest[i] >= 0) json["nearest"] = nearest[i];
    // Sources may be called as targets are: the views of a run, given to another one.
    const bool is_target = view.record.role != "source";
    for (const char* metric : {"psnr", "ssim"}) {
      if (!is_target) continue;
      const Json& value = row_value(report, "/against_truth", view.name, metric);
      if (value.is_number()) json[metric] = value;
    }
    const Json& kept = row_value(report, "/photographs/kept", view.name, "share");
    if (is_target && kept.is_number()) json["kept"] = kept;
    const Json& expected = row_value(report, "/photographs/kept", view.name, "expected_psnr");
    if (is_target && expected.is_number()) json["expected"] = expected;
    for (const Json& carried : report_value(report, "/photographs/carried_only")) {
      if (is_target && carried == view.name) json["carried"] = true;
    }
    list.push_back(std::move(json));
  }
  return list;
}

Json depth_json(const DepthRange& range, bool metric) {
  Json colours = Json::array();
  constexpr int kStops = 9;
  for (int i = 0; i < kStops; ++i) {
    const Rgb rgb = viridis(1 - static_cast<double>(i) / (kStops - 1));  // near is bright
    colours.push_back(fmt::format("#{:02x}{:02x}{:02x}", rgb[0], rgb[1], rgb[2]));
  }
  return {{"nearest", range.nearest},
          {"farthest", range.farthest},
          {"unit", metric ? "m" : ""},
          {"colours", colours}};
}

// Returns what the run was made with, a line each.
Json facts_json(const Json& report) {
  Json facts = Json::array();
  const auto add = [&](const char* what, const std::string& text) {
    if (!text.empty()) facts.push_back({what, text});
  };
  add("Scene", report_text_at(report, "/scene/name"));
  add("Model", report_text_at(report, "/model/name"));
  add("SHA-256 of its weights", report_text_at(report, "/model/hash"));
  add("Seed", report_number_at(report, "/seed"));
  add("How it was sampled", report_text_at(report, "/sampling/in_words"));
  add("Precision", report_text_at(report, "/precision"));
  add("Threads", report_number_at(report, "/threads"));
  add("Cameras of the photographs found by", report_text_at(report, "/photo_cameras/from"));
  add("Scale of depth from", report_text_at(report, "/depth_scale/estimator"));
  return facts;
}

Json stages_json(const Json& report) {
  Json stages = Json::array();
  const Json& list = report_value(report, "/stages");
  if (!list.is_array()) return stages;
  for (const Json& stage : list) {
    if (stage.is_object() && stage.contains("stage") && stage["stage"].is_string()) stages.push_back(stage);
  }
  return stages;
}

// Returns two corners of the box of Gaussians' means without the outermost hundredth on each side.
std::vector<Eigen::Vector3d> usual_corners(const GaussianSet& set) {
  const auto count = static_cast<size_t>(set.size());
  if (count == 0) return {};
  std::vector<Eigen::Vector3d> corners(2);
  const auto outermost = static_cast<std::ptrdiff_t>(count / 100);
  for (int axis = 0; axis < 3; ++axis) {
    std::vector<double> values(count);
    for (size_t i = 0; i < count; ++i) values[i] = set.mean_in_world(i)[axis];
    std::sort(values.begin(), values.end());
    corners[0][axis] = values[static_cast<size_t>(outermost)];
    corners[1][axis] = *(values.end() - 1 - outermost);
  }
  return corners;
}

// Returns the middle of cameras and cloud, or without a cloud of cameras and Gaussians, which becomes the page's 0:
// floats of a browser hold no scene far from it. A Gaussian astray may lie anywhere, so that a cloud is asked first.
Eigen::Vector3d middle_of(const std::vector<PageView>& views, const PointCloud& cloud,
                          const std::optional<GaussianSet>& splats) {
  std::optional<Eigen::Vector3d> low, high;
  const auto add = [&](const Eigen::Vector3d& x) {
    low = low ? low->cwiseMin(x) : x;
    high = high ? high->cwiseMax(x) : x;
  };
  for (const PageView& view : views) add(view.record.camera.world_from_camera.translation());
  for (const Eigen::Vector3d& point : cloud.x_in_world) add(point);
  if (splats && cloud.x_in_world.empty()) {
    for (const Eigen::Vector3d& corner : usual_corners(*splats)) add(corner);
  }
  return low ? (*low + *high) / 2 : Eigen::Vector3d(Eigen::Vector3d::Zero());
}

// Depth that photographs agree on has the unit of the cameras, with a scale of the head's own or without.
bool unit_of_depth_is_known(const Json& report) {
  return report.contains("depth_scale") || report_text_at(report, "/depth_from").rfind("photographs", 0) == 0;
}

// Returns why the page shows no cloud, or none with cameras; empty where it does.
std::string cloud_note(const Json& report, const PointCloud& cloud, bool has_file,
                       const PageOptions& options) {
  if (options.page_points == 0) return "The cloud was left out of this page (--page-points 0).";
  if (!has_file) return "This run has no point cloud: it was not asked for (--outputs points).";
  if (cloud.size() == 0) return "The point cloud of this run has no point.";
  const auto& noted = report_value(report, "/points/in_world");
  const bool in_world = noted.is_boolean() ? noted.get<bool>()
                                           : report_text_at(report, "/points/lifted_by") == "cameras" ||
                                                 report.contains("depth_scale");
  return !in_world ? "The cloud is in the model's own frame, in which the cameras are not known." : "";
}

}  // namespace

Page sample_page(const std::filesystem::path& run, const PageOptions& options) {
  const Json report = read_run_report(run);
  RunParts parts(run);
  bool metric = false;
  const std::vector<PageView> views = read_views(parts, report, metric);
  PointCloud cloud;
  const bool has_cloud = parts.has("points.ply");
  if (has_cloud) parts.read("points.ply", [&](const auto& file) { cloud = read_ply(file).cloud; });
  std::optional<GaussianSet> splats;  // none where the file is missing, damaged or left out
  if (parts.has(kSplatFile) && options.page_points > 0) {
    parts.read(kSplatFile, [&](const auto& file) { splats = read_splat_ply(file); });
  }

  std::vector<SeenDepth> seen;
  std::vector<DepthMap> depths;
  for (const PageView& view : views) {
    seen.push_back({view.record.camera, view.depth});
    depths.push_back(view.depth);
  }
  const bool has_depth =
      std::any_of(depths.begin(), depths.end(), [](const DepthMap& depth) { return !depth.empty(); });
  const DepthRange range = robust_depth_range(depths);
  const Eigen::Vector3d origin = middle_of(views, cloud, splats);

  Page page;
  page.title = "gld sample, " + report_text_at(report, "/scene/name");
  page.heading = "New views of " + report_text_at(report, "/scene/name");
  page.asked = asked_of_sample(report);
  page.verdict = verdict_of_sample(report);
  page.provenance = provenance_of_run(report);
  PagePictures pictures;
  page.data["kind"] = "sample";
  page.data["views"] = views_json(views, report, origin, range, pictures);
  if (has_depth) page.data["depth"] = depth_json(range, metric && unit_of_depth_is_known(report));
  page.data["unit"] = metric ? "m" : "";
  page.data["origin"] = {origin.x(), origin.y(), origin.z()};
  page.data["cloud_note"] = cloud_note(report, cloud, has_cloud, options);
  page.data["cloud"] = page_cloud(std::move(cloud), seen, origin, options.page_points);
  if (splats) page.data["splats"] = page_splats(*splats, origin, options.page_points);
  page.data["facts"] = facts_json(report);
  page.data["stages"] = stages_json(report);
  page.data["command"] = report_text_at(report, "/command_line");
  page.doubts = doubts_of_run(report);
  page.doubts.insert(page.doubts.end(), parts.doubts().begin(), parts.doubts().end());

  const auto most = static_cast<size_t>(options.page_megabytes * 1e6);
  const size_t rest = page_size(page);
  page.data["pictures"] = pictures.addresses(most > rest ? most - rest : 0);
  return page;
}

}  // namespace gld
