#pragma once

#include "datasets/formats/cameras_json.h"
#include "datasets/pictures/contact_sheet.h"
#include "gld/report/provenance.h"
#include "gld/report/run_folder.h"
#include "infer/method/sample_options.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "infer/request/sampling_scene.h"
#include "infer/request/scale_evidence.h"
#include "infer/sample/picture_verdict.h"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

// Returns how many times as large as the model's the pictures of views are, where they are asked for in the
// photographs' size.
int64_t picture_magnification(const SamplingScene& scene, const SampleOptions& options);
// Returns the target views as they are written, of (targets, 3, height, width) and what was composed of them.
std::vector<Image> target_pictures(const SamplingScene& scene, const SampleOptions& options,
                                   const torch::Tensor& images, const std::optional<ComposedViews>& composed);

// Writes what the pipeline made into a run folder (docs/FILES.md lists the files).
class SamplingOutputs {
 public:
  // All five must outlive this object.
  SamplingOutputs(RunFolder& run, const SamplingScene& scene, const RequestedOutputs& requested,
                  const SampleOptions& options, const Provenance& provenance);

  // Writes images/ with the target views, (targets, 3, height, width), with --size photographs as large as these. It
  // keeps them for the sheet and the point cloud.
  void write_images(const torch::Tensor& images, const std::optional<ComposedViews>& composed);
  // Writes depth/, rays/, points.ply as requested, latents.safetensors, cameras.json, and truth/ for the page.
  void write_rest(const PipelineResult& result);
  // Writes contact_sheet.png, last; text is verdict, doubts and subtitle; expected is of the target views, or none.
  void write_contact_sheet(SheetText text, const std::vector<ExpectedView>& expected);

  // Writes splats.ply: Gaussians fitted to the run folder as gld splat fit --run reads it, with the same bytes. It is
  // called after write_rest; the file is left out, with a warning, where cameras.json has no depth.
  void write_splats();

  // Returns what is known of the depth's unit, a line; nothing where no depth was asked for.
  std::string scale_text() const;

  // Returns how each target view compares with its truth where it has one, depth scale, counts of points: for
  // report.json.
  const nlohmann::ordered_json& findings() const { return findings_; }
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  void write_depth(const PipelineResult& result);
  void write_rays(const PipelineResult& result);
  void write_points(const PipelineResult& result);
  void write_latents(const PipelineResult& result);
  void write_cameras();
  void write_source_images();
  void write_true_images();
  // Makes cameras of the model's size those of the pictures that are written, without depth where that has another
  // size.
  CameraList of_pictures(CameraList list) const;
  int64_t magnification() const { return picture_magnification(scene_, options_); }
  // Fills placement_, with what is unusual about it among the warnings.
  void place(const PipelineResult& result);
  std::vector<Camera> geometry_cameras() const;
  // Returns "m" where depth is in metres.
  std::string depth_unit_name() const { return scene_.metric && depth_has_scene_unit_ ? "m" : ""; }
  // Apart for pixels of which at least half comes from photographs, and for the others. pictures are as they are
  // written, images_ of the model's size; they may be none where both are of one size.
  void compare_with_truth(const std::optional<ComposedViews>& composed, const std::vector<Image>& pictures);

  RunFolder& run_;
  const SamplingScene& scene_;
  const RequestedOutputs& requested_;
  const SampleOptions& options_;
  const Provenance& provenance_;
  std::vector<Image> images_;     // one a target view
  std::vector<double> psnr_;      // one a target view; NaN without truth
  std::vector<DepthMap> depths_;  // one a geometry view
  GeometryPlacement placement_;   // empty where no rays were asked for
  double depth_unit_ = 0;
  bool depth_has_scene_unit_ = false;  // otherwise the geometry model's own
  bool cameras_have_depth_ = false;    // in cameras.json, or in the file of their own
  int64_t first_geometry_view_ = 0;    // 0, or the first target where only rays were asked for
  nlohmann::ordered_json findings_ = nlohmann::ordered_json::object();
  std::vector<std::string> warnings_;
};

}  // namespace gld
