#include "infer/sample/sampling_outputs.h"

#include "datasets/formats/cameras_json.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/images/pfm_file.h"
#include "datasets/loading/batching.h"
#include "datasets/pictures/depth_preview.h"
#include "datasets/splats/scene_fit.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/cameras/relative_cameras.h"
#include "gld/cameras/resized_camera.h"
#include "gld/metrics/metric.h"
#include "gld/metrics/metric_list.h"
#include "gld/page/run_report.h"
#include "gld/report/progress.h"
#include "gld/tensors/tensor_pictures.h"
#include "gld/tensors/torch_version.h"
#include "gld/tensors/weight_tensors.h"
#include "infer/export/depth_export.h"
#include "infer/export/image_export.h"
#include "infer/export/ply_file.h"
#include "infer/export/point_cloud.h"
#include "infer/export/ray_export.h"
#include "infer/page/sample_page.h"
#include "infer/pipeline/placed_cloud.h"
#include "models/scene_geometry/composed_views.h"
#include "models/scene_geometry/predicted_cameras.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

DepthMap depth_map(const torch::Tensor& depth) {
  return to_depth_map(depth.to(torch::kCPU, torch::kFloat32).contiguous());
}

// Returns what report.json says of a picture beside the true one, and beside the nearest photograph, all of one size.
// shown is of the picture, (1, height, width) from 0 to 1; undefined where nothing of photographs is kept.
nlohmann::ordered_json beside_truth(const Image& truth, const Image& picture, const torch::Tensor& shown,
                                    const torch::Tensor& nearest_photograph) {
  MetricInputs inputs;
  inputs.true_images = to_tensor(truth).unsqueeze(0);
  inputs.images = to_tensor(picture).unsqueeze(0);
  if (shown.defined()) inputs.shown = shown >= 0.5;
  nlohmann::ordered_json row;
  for (const char* name : {"psnr", "psnr_seen", "psnr_unseen", "ssim", "sharpness"}) {
    const MetricValue value = measure(metric_named(name), inputs);
    if (value.absent.empty()) row[name] = value.mean();
  }
  row["psnr_nearest_source"] =
      measure_images(metric_named("psnr"), inputs.true_images, nearest_photograph.unsqueeze(0)).mean();
  return row;
}

}  // namespace

SamplingOutputs::SamplingOutputs(RunFolder& run, const SamplingScene& scene,
                                 const RequestedOutputs& requested, const SampleOptions& options,
                                 const Provenance& provenance)
    : run_(run), scene_(scene), requested_(requested), options_(options), provenance_(provenance) {
  first_geometry_view_ = requested.geometry_views() == DecodedViews::kAll ? 0 : scene.views.num_sources;
}

int64_t picture_magnification(const SamplingScene& scene, const SampleOptions& options) {
  const auto& photographs = scene.photographs.views;
  return options.size != kPhotographSize || photographs.empty()
             ? 1
             : photographs.front().width / scene.size.width;
}

std::vector<Image> target_pictures(const SamplingScene& scene, const SampleOptions& options,
                                   const torch::Tensor& images,
                                   const std::optional<ComposedViews>& composed) {
  const int64_t times = picture_magnification(scene, options);
  torch::Tensor shown = images;
  if (times > 1) shown = composed ? composed->large_images : enlarged(images, times);
  std::vector<Image> pictures;
  for (int64_t i = 0; i < images.size(0); ++i) pictures.push_back(to_image(shown[i]));
  return pictures;
}

void SamplingOutputs::write_images(const torch::Tensor& images,
                                   const std::optional<ComposedViews>& composed) {
  for (int64_t i = 0; i < images.size(0); ++i) images_.push_back(to_image(images[i]));
  std::vector<Image> pictures;
  if (requested_.image || magnification() > 1) pictures = target_pictures(scene_, options_, images, composed);
  compare_with_truth(composed, pictures);
  if (!requested_.image) return;
  const auto folder = run_.subfolder("images");
  for (size_t i = 0; i < pictures.size(); ++i) {
    const int64_t view = scene_.views.num_sources + static_cast<int64_t>(i);
    export_image(folder / (view_name(view, scene_.views.size()) + ".png"), pictures[i], provenance_);
  }
  run_.note("images", "images");
}

void SamplingOutputs::compare_with_truth(const std::optional<ComposedViews>& composed,
                                         const std::vector<Image>& pictures) {
  const auto shown = [&](const torch::Tensor& of_views, size_t i) {
    return of_views.defined() ? of_views.slice(0, static_cast<int64_t>(i), static_cast<int64_t>(i) + 1)
                              : torch::Tensor();
  };
  auto rows = nlohmann::ordered_json::array();
  for (size_t i = 0; i < images_.size(); ++i) {
    psnr_.push_back(std::numeric_limits<double>::quiet_NaN());
    if (scene_.true_images[i].empty()) continue;
    const int64_t target = scene_.views.num_sources + static_cast<int64_t>(i);
    const auto nearest = static_cast<size_t>(nearest_source(scene_.views, target));
    nlohmann::ordered_json row{{"view", scene_.view_names[static_cast<size_t>(target)]}};
    row.update(beside_truth(scene_.true_images[i], images_[i],
                            shown(composed ? composed->shown : torch::Tensor(), i),
                            to_tensor(scene_.source_images[nearest])));
    psnr_.back() = row.at("psnr");
    if (magnification() > 1 && !scene_.large_true_images[i].empty()) {
      const PicturedView& photograph = scene_.photographs.views[nearest];
      row["large"] = {{"width", pictures[i].width}, {"height", pictures[i].height}};
      row["large"].update(beside_truth(scene_.large_true_images[i], pictures[i],
                                       shown(composed ? composed->large_shown : torch::Tensor(), i),
                                       picture_of(photograph.rgb, photograph.width, photograph.height)));
    }
    rows.push_back(row);
  }
  if (!rows.empty()) findings_["against_truth"] = rows;
}

void SamplingOutputs::write_rest(const PipelineResult& result) {
  if (requested_.needs_rays()) place(result);
  if (requested_.needs_depth()) write_depth(result);
  if (requested_.rays) write_rays(result);
  if (requested_.points) write_points(result);
  if (requested_.latents) write_latents(result);
  write_cameras();
  if (requested_.page && requested_.image) write_true_images();
}

void SamplingOutputs::write_depth(const PipelineResult& result) {
  const auto& depth = result.geometry.depth;
  // All depth files are in the unit of the poses, so that cameras.json describes one scene.
  const double scale = placement_.scale ? placement_.scale->scale : 1;
  for (int64_t i = 0; i < depth.size(0); ++i) {
    if (!result.view_depth.empty()) {
      depths_.push_back(depth_map_of(result.view_depth[static_cast<size_t>(i)]));
      continue;
    }
    depths_.push_back(depth_map(depth[i]));
    for (float& value : depths_.back().metres) value = static_cast<float>(value * scale);
  }
  for (size_t i = 0; i < depths_.size(); ++i) {
    const auto& values = depths_[i].metres;
    if (std::any_of(values.begin(), values.end(), is_known_depth)) continue;
    fail({"depth of " + view_name(first_geometry_view_ + static_cast<int64_t>(i), scene_.views.size()),
          "positive, finite numbers",
          fmt::format("none in the model's {} values times the scale {:g}", values.size(), scale),
          "check the DPT head and the backbone with gld inspect, and the unit of the scene's poses"});
  }
  depth_unit_ = choose_depth_unit(depths_);
  if (!requested_.depth) return;
  const auto folder = run_.subfolder("depth");
  const auto range = robust_depth_range(depths_);
  for (size_t i = 0; i < depths_.size(); ++i) {
    const auto name = view_name(first_geometry_view_ + static_cast<int64_t>(i), scene_.views.size());
    export_depth_png(folder / (name + ".png"), depths_[i], depth_unit_, provenance_);
    write_pfm(folder / (name + ".pfm"), depths_[i]);
    export_image(folder / (name + "_preview.png"), depth_preview(depths_[i], range, depth_unit_name()),
                 provenance_);
  }
  findings_["depth_unit"] = depth_unit_;
  findings_["depth_from"] = result.view_depth.empty() ? "geometry head" : result.view_depth_from;
  run_.note("depth", "depth");
}

void SamplingOutputs::write_rays(const PipelineResult& result) {
  const auto folder = run_.subfolder("rays");
  int64_t not_finite = 0;
  for (int64_t i = 0; i < result.geometry.rays.size(0); ++i) {
    const auto name = view_name(first_geometry_view_ + i, scene_.views.size());
    not_finite += export_rays(folder / (name + ".npz"), to_ray_map(result.geometry.rays[i]),
                              to_confidence_map(result.geometry.ray_confidence[i]), provenance_);
  }
  if (not_finite > 0) {
    warnings_.push_back(
        fmt::format("{} predicted rays were not finite; they are zero in the files.", not_finite));
  }
  if (result.geometry.points.defined()) {
    save_safetensors(
        folder / "point_maps.safetensors",
        {{"points", result.geometry.points.cpu()}, {"confidence", result.geometry.point_confidence.cpu()}});
  }
  if (placement_.predicted.empty()) {
    warnings_.push_back("rays/predicted_cameras.json is left out.");
  } else {
    CameraList list;
    for (const Camera& camera : placement_.predicted) {
      CameraRecord record;
      record.name =
          view_name(first_geometry_view_ + static_cast<int64_t>(list.records.size()), scene_.views.size());
      record.camera = camera;
      list.records.push_back(record);
    }
    write_cameras_json(folder / "predicted_cameras.json", list);
  }
  run_.note("rays", "rays");
}

std::vector<Camera> SamplingOutputs::geometry_cameras() const {
  const auto& cameras = scene_.views.cameras;
  return {cameras.begin() + first_geometry_view_, cameras.end()};
}

void SamplingOutputs::place(const PipelineResult& result) {
  const bool sources = first_geometry_view_ == 0;
  placement_ =
      place_geometry(result.geometry, geometry_cameras(),
                     sources ? scale_evidence(scene_, options_.scale_from, result) : ScaleEvidence());
  if (placement_.predicted.empty()) {
    warnings_.push_back(fmt::format("No camera fits the predicted rays: {}", placement_.problem));
  } else {
    const PoseAlignment& alignment = *placement_.alignment;
    findings_["pose_alignment"] = {{"rotation_error_degrees", alignment.rotation_error},
                                   {"centre_error", alignment.centre_error},
                                   {"spread", alignment.spread}};
  }
  if (!requested_.needs_depth()) return;
  depth_has_scene_unit_ = placement_.scale || !result.view_depth.empty();
  findings_["depth_scale_estimates"] = estimates_json(placement_.estimates);
  if (placement_.scale) findings_["depth_scale"] = depth_scale_json(*placement_.scale);
  if (placement_.scale && placement_.scale->estimator == kUsualUnitEvidence) {
    warnings_.push_back(fmt::format(
        "Depth, cloud and what is carried of the photograph are in a unit that the model guesses: "
        "{:.0f} % less or {:.0f} % more would not surprise.",
        100 * (1 - placement_.scale->low / placement_.scale->scale),
        100 * (placement_.scale->high / placement_.scale->scale - 1)));
  }
  if (depth_has_scene_unit_) return;
  warnings_.push_back(fmt::format(
      "{} ({}). {}", kScaleNotKnown, estimates_text(placement_.estimates),
      placement_.predicted.empty()
          ? "Depth keeps the model's own unit, points.ply its frame as well, and cameras.json goes without depth."
          : "Depth, points.ply and cameras.json are in the model's own unit, with the cameras that the model "
            "predicts, turned and moved as one to the given ones, which are in given_cameras.json."));
}

std::string SamplingOutputs::scale_text() const {
  if (!requested_.needs_depth()) return "";
  if (!depth_has_scene_unit_) return "depth is in the model's own unit: its scale is not known\n";
  if (!placement_.scale) return "depth is in the unit of the cameras, by what photographs agree on\n";
  const DepthScale& scale = *placement_.scale;
  return fmt::format("depth scale {:.4g} (95 %: {:.4g} to {:.4g}; the fit leaves {:.0f} %), from {}\n",
                     scale.scale, scale.low, scale.high, 100 * scale.residual, scale.estimator);
}

void SamplingOutputs::write_points(const PipelineResult& result) {
  std::vector<Image> images = scene_.source_images;
  images.insert(images.end(), images_.begin(), images_.end());
  const PlacedDepth depth{result.geometry, placement_, result.view_depth};
  const PointCloud cloud = point_cloud_of(depth, geometry_cameras(), images, options_.points);
  export_ply(run_.path() / "points.ply", cloud, provenance_);
  const PointCounts& counts = cloud.counts;
  if (cloud.size() == 0) {
    warnings_.push_back(fmt::format(
        "points.ply has no point: of {} pixels {} have no known depth, {} too little confidence, {} lie at edges of "
        "depth, and {} are farther away than --far-limit lets them.",
        counts.pixels, counts.unknown_depth, counts.low_confidence, counts.depth_edges, counts.too_far));
  }
  const PointLifting lifting = lifting_of(depth, options_.points);
  findings_["points"] = {{"written", cloud.size()},
                         {"lifted_by", point_lifting_names()[static_cast<size_t>(lifting)]},
                         {"in_world", cloud_is_in_world(depth, options_.points)},
                         {"pixels", counts.pixels},
                         {"unknown_depth", counts.unknown_depth},
                         {"low_confidence", counts.low_confidence},
                         {"depth_edges", counts.depth_edges},
                         {"too_far", counts.too_far},
                         {"thinned", counts.thinned}};
  run_.note("point cloud", "points.ply");
}

void SamplingOutputs::write_latents(const PipelineResult& result) {
  std::map<std::string, torch::Tensor> tensors;
  for (const auto& [level, latent] : result.latents) tensors["level" + std::to_string(level)] = latent;
  save_safetensors(run_.path() / "latents.safetensors", tensors,
                   {{"gld", provenance_.options}, {"model", provenance_.model_hash}});
  run_.note("latents", "latents.safetensors");
}

void SamplingOutputs::write_source_images() {
  // As the model saw them, or as large as they are kept, so that the run folder is a scene that every command reads.
  const auto folder = run_.subfolder("sources");
  for (size_t view = 0; view < scene_.source_images.size(); ++view) {
    const auto file = folder / (view_name(static_cast<int64_t>(view), scene_.views.size()) + ".png");
    if (magnification() == 1) {
      export_image(file, scene_.source_images[view], provenance_);
      continue;
    }
    const PicturedView& photograph = scene_.photographs.views[view];
    export_image(file, to_image(picture_of(photograph.rgb, photograph.width, photograph.height)),
                 provenance_);
  }
}

// For the page, which is made of the run folder alone.
void SamplingOutputs::write_true_images() {
  const bool any = std::any_of(scene_.true_images.begin(), scene_.true_images.end(),
                               [](const Image& image) { return !image.empty(); });
  if (!any) return;
  const auto folder = run_.subfolder(kTruthFolder);
  const std::vector<Image>& truth = magnification() > 1 ? scene_.large_true_images : scene_.true_images;
  for (size_t i = 0; i < truth.size(); ++i) {
    if (truth[i].empty()) continue;
    const int64_t view = scene_.views.num_sources + static_cast<int64_t>(i);
    export_image(folder / (view_name(view, scene_.views.size()) + ".png"), truth[i], provenance_);
  }
}

CameraList SamplingOutputs::of_pictures(CameraList list) const {
  const int64_t times = magnification();
  for (CameraRecord& record : list.records) {
    if (times == 1) break;
    record.camera = resized_camera(record.camera, times * record.camera.width, times * record.camera.height);
    record.depth.clear();
    record.depth_unit = 0;
  }
  return list;
}

void SamplingOutputs::write_cameras() {
  write_source_images();
  // Depth belongs to the cameras that it is written with: where it keeps the model's unit, to the model's.
  const bool of_model = requested_.needs_depth() && !depth_has_scene_unit_;
  const std::vector<Camera> model_cameras =
      of_model ? cameras_of_depth(placement_, geometry_cameras()) : std::vector<Camera>();
  CameraList list;
  list.metric = scene_.metric && model_cameras.empty();
  const bool with_depth = requested_.depth && (!of_model || !model_cameras.empty());
  cameras_have_depth_ = with_depth;
  for (int64_t view = 0; view < scene_.views.size(); ++view) {
    const bool target = view >= scene_.views.num_sources;
    CameraRecord record;
    record.name = view_name(view, scene_.views.size());
    record.role = target ? "target" : "source";
    record.camera = scene_.views.cameras[static_cast<size_t>(view)];
    if (!target) record.image = "sources/" + record.name + ".png";
    if (target && requested_.image) record.image = "images/" + record.name + ".png";
    if (with_depth && view >= first_geometry_view_) {
      record.depth = "depth/" + record.name + ".png";
      record.depth_unit = depth_unit_;
    }
    list.records.push_back(record);
  }
  if (!model_cameras.empty()) {
    CameraList given = list;
    given.metric = scene_.metric;
    for (CameraRecord& record : given.records) record.depth.clear();
    write_cameras_json(run_.path() / "given_cameras.json", of_pictures(given));
    run_.note("given cameras", "given_cameras.json");
    for (size_t view = 0; view < model_cameras.size(); ++view)
      list.records[view].camera = model_cameras[view];
  }
  if (magnification() > 1 && with_depth) {
    // Depth has the model's size, and a camera is of one.
    CameraList of_depth = list;
    for (CameraRecord& record : of_depth.records) record.image.clear();
    write_cameras_json(run_.path() / kDepthCamerasFile, of_depth);
    run_.note("cameras of depth", kDepthCamerasFile);
  }
  write_cameras_json(run_.path() / "cameras.json", of_pictures(std::move(list)));
  run_.note("cameras", "cameras.json");
}

void SamplingOutputs::write_splats() {
  if (!cameras_have_depth_) {
    warnings_.push_back(
        "splats.ply is left out: without a camera that fits the predicted rays, depth has no place.");
    return;
  }
  const SceneFitOptions options = options_.splats.scene_fit(options_.seed);
  KernelSettings settings;
  settings.threads = static_cast<int>(thread_count());
  const Scene scene = open_scene(run_.path());
  Progress progress({"splats", options.fit.steps, 0, run_.path()});
  const SceneFit fitted =
      fit_scene(scene, options, run_.path().string(), settings, [&](const SplatFitStep& step) {
        stop_if_interrupted(fmt::format("{} of {} steps of the splats are done; --resume begins them anew",
                                        step.step, options.fit.steps));
        progress.update(step.step, fmt::format("loss {:.4f}, {} Gaussians", step.loss, step.gaussians));
      });
  progress.finish();
  write_fitted_splats(run_.path() / kSplatFile, fitted.fit.set, scene.name, options);
  findings_["splats"] = {
      {"gaussians", {{"at_first", fitted.started_with}, {"at_last", fitted.fit.set.size()}}},
      {"steps", fitted.fit.step},
      {"views", fitted.views},
      {"near", fitted.near},
      {"fitted_psnr", fitted.fitted_psnr}};
  run_.note("3D Gaussians", kSplatFile);
}

void SamplingOutputs::write_contact_sheet(SheetText text, const std::vector<ExpectedView>& expected) {
  const auto range = robust_depth_range(depths_);
  std::vector<SheetView> views;
  for (int64_t view = 0; view < scene_.views.size(); ++view) {
    const auto index = static_cast<size_t>(view);
    SheetView sheet;
    sheet.name = scene_.view_names[index];
    const bool target = view >= scene_.views.num_sources;
    sheet.role = target ? SheetRole::kTarget : SheetRole::kSource;
    if (target) {
      const auto number = index - static_cast<size_t>(scene_.views.num_sources);
      if (number < images_.size()) {
        sheet.image = images_[number];
        if (std::isfinite(psnr_[number])) {
          sheet.note = fmt::format("{:.1f} dB", psnr_[number]);
        } else if (!expected.empty()) {
          sheet.note = fmt::format("about {:.0f} dB expected", expected[number].psnr);
        }
      }
      sheet.truth = scene_.true_images[number];
    } else {
      sheet.image = scene_.source_images[index];
    }
    if (!depths_.empty() && view >= first_geometry_view_) {
      sheet.depth = coloured_depth(depths_[static_cast<size_t>(view - first_geometry_view_)], range);
    }
    views.push_back(std::move(sheet));
  }
  text.title = "gld sample, scene " + scene_.name;
  text.depth_range = range;
  text.depth_unit = depth_unit_name();
  export_image(run_.path() / "contact_sheet.png", make_contact_sheet(views, text), provenance_);
  run_.note("contact sheet", "contact_sheet.png");
}

}  // namespace gld
