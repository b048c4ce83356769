#include "tests/support/drawn_run.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/splats/scene_fit.h"
#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/atomic_file.h"
#include "gld/base/json_text.h"
#include "gld/report/provenance.h"
#include "infer/export/depth_export.h"
#include "infer/export/image_export.h"
#include "infer/export/ply_file.h"
#include "infer/export/point_cloud.h"

#include <algorithm>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld::test {
namespace {

struct DrawnView {
  Camera camera;
  Image image;
  DepthMap depth;
};

DrawnView cut(const DrawnView& view, int64_t left, int64_t width, int64_t height) {
  DrawnView result{view.camera, Image(width, height), DepthMap(width, height)};
  result.camera.width = width;
  result.camera.height = height;
  result.camera.intrinsics(0, 2) -= static_cast<double>(left);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      std::copy_n(view.image.pixel(x + left, y), 3, result.image.pixel(x, y));
      result.depth.at(x, y) = view.depth.at(x + left, y);
    }
  }
  return result;
}

DrawnView with_high_pixels(const DrawnView& view) {
  const int64_t height = view.image.height / 2;
  DrawnView result{view.camera, Image(view.image.width, height), DepthMap(view.image.width, height)};
  result.camera.height = height;
  result.camera.intrinsics.row(1) /= 2;
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < view.image.width; ++x) {
      const uint8_t* upper = view.image.pixel(x, 2 * y);
      const uint8_t* lower = view.image.pixel(x, 2 * y + 1);
      for (int c = 0; c < 3; ++c) {
        result.image.pixel(x, y)[c] = static_cast<uint8_t>((upper[c] + lower[c] + 1) / 2);
      }
      // On a plane seen in perspective inverse depth is affine.
      result.depth.at(x, y) = 2 / (1 / view.depth.at(x, 2 * y) + 1 / view.depth.at(x, 2 * y + 1));
    }
  }
  return result;
}

ConfidenceMap surer_to_the_right(const DepthMap& depth) {
  ConfidenceMap confidence(depth.width, depth.height);
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) confidence.at(x, y) = 1 + static_cast<float>(x);
  }
  return confidence;
}

Image brighter(Image image) {
  for (uint8_t& value : image.rgb) value = static_cast<uint8_t>(std::min(255, value + 4));
  return image;
}

}  // namespace

void write_drawn_run(const std::filesystem::path& folder, const DrawnRun& drawn) {
  SyntheticOptions options;
  options.seed = 910000;
  options.scene_count = drawn.scene + 1;
  options.frames = std::max<int64_t>(2, drawn.sources + drawn.targets);
  options.width = drawn.odd_pixels ? drawn.width * 5 / 4 : drawn.width;
  options.height = drawn.odd_pixels ? drawn.height * 16 / 7 : drawn.height;
  const Scene scene = make_synthetic_scene(options, drawn.scene);
  Provenance provenance;
  provenance.program = "gld test";
  provenance.command = "sample";
  const int64_t views = drawn.sources + drawn.targets;
  for (const char* name : {"sources", "images", "truth", "depth"}) {
    std::filesystem::create_directories(folder / name);
  }
  CameraList list;
  nlohmann::ordered_json names = nlohmann::ordered_json::array(), against = names;
  std::vector<PointView> lifted;
  std::vector<DepthMap> depths;
  std::vector<Image> truths;
  for (int64_t i = 0; i < views; ++i) {
    const Frame& frame = scene.frames[static_cast<size_t>(i)];
    DrawnView view{frame.camera, frame.image(), frame.depth()};
    if (drawn.odd_pixels) {
      view = with_high_pixels(cut(view, options.width - drawn.width, drawn.width, 2 * drawn.height));
    }
    CameraRecord record;
    record.name = view_name(i, views);
    record.role = i < drawn.sources ? "source" : "target";
    record.camera = view.camera;
    record.image = (i < drawn.sources ? "sources/" : "images/") + record.name + ".png";
    if (drawn.depth) record.depth = "depth/" + record.name + ".png";
    list.records.push_back(record);
    names.push_back(i == 0 && !drawn.first_name.empty() ? drawn.first_name : frame.name);
    truths.push_back(view.image);
    if (i >= drawn.sources) {
      view.image = brighter(view.image);
      against.push_back({{"view", frame.name}, {"psnr", 36.1}, {"ssim", 0.99}});
    }
    depths.push_back(view.depth);
    lifted.push_back({view.camera, view.image, view.depth, surer_to_the_right(view.depth), {}, {}, {}});
  }
  const double unit = choose_depth_unit(depths);
  for (size_t i = 0; i < lifted.size(); ++i) {
    CameraRecord& record = list.records[i];
    export_image(folder / record.image, lifted[i].image, provenance);
    if (record.role == "target") {
      export_image(folder / "truth" / (record.name + ".png"), truths[i], provenance);
    }
    if (!drawn.depth) continue;
    record.depth_unit = unit;
    export_depth_png(folder / record.depth, depths[i], unit, provenance);
  }
  write_cameras_json(folder / "cameras.json", list);
  PointCloudOptions all;
  all.confidence_quantile = 0;
  if (drawn.depth && drawn.points) {
    export_ply(folder / "points.ply", build_point_cloud(lifted, 1, all), provenance);
  }
  const nlohmann::ordered_json report{
      {"command", "sample"},
      {"verdict",
       {{"sentence", "These pictures are drawn, and as good as the truth."}, {"unfamiliar", false}}},
      {"options", {{"seed", 7}, {"outputs", {"image", "depth", "points", "page"}}, {"out", "somewhere"}}},
      {"model", {{"name", "drawn"}, {"hash", std::string(64, 'a')}}},
      {"command_line", "gld sample --scene " + drawn.scene_name},
      {"seed", 7},
      {"scene",
       {{"name", drawn.scene_name},
        {"width", list.records[0].camera.width},
        {"height", list.records[0].camera.height},
        {"views", names},
        {"sources", drawn.sources}}},
      {"precision", "float32"},
      {"stages",
       {{{"stage", "drawing"}, {"seconds", 1.5}, {"peak_bytes", 123000000}},
        {{"stage", "writing"}, {"seconds", 0.25}, {"peak_bytes", 45000000}}}},
      {"against_truth", against},
      {"depth_scale", {{"scale", 1.0}, {"estimator", "the truth"}}},
      {"points", {{"lifted_by", "cameras"}}},
      {"warnings", {"the cameras of the photographs are not sure: a word & a <tag>"}}};
  write_file_atomically(folder / "report.json", json_text(report, 2) + "\n");
  write_file_atomically(folder / "config.yaml",
                        "# gld sample: the options of this run, defaults included\nseed: 7\n");
  if (!drawn.splats) return;
  SceneFitOptions fit;
  fit.fit.steps = 150;
  const SceneFit fitted =
      fit_scene(open_scene(folder), fit, drawn.scene_name, KernelSettings(), [](const auto&) {});
  write_fitted_splats(folder / kSplatFile, fitted.fit.set, drawn.scene_name, fit);
}

}  // namespace gld::test
