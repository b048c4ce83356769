#pragma once

#include "infer/evaluate/pose_estimation.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/bundle/bundle.h"
#include "models/losses/lpips.h"

#include <memory>
#include <optional>
#include <string>

#include <torch/types.h>

namespace gld {

// Why a model does not say where its pictures stand.
constexpr const char* kNoCameraHead = "the model has no geometry head that sees cameras";
// Why its head says nothing of what it generates.
constexpr const char* kNotAllLevels = "the model does not generate all levels, which its geometry head takes";

// Returns why a model's own geometry head says nothing of its samples; none where it does.
inline std::optional<std::string> no_geometry_of_samples(const BundleOptions& model) {
  if (!model.geometry_head.predicts_rays()) return kNoCameraHead;
  if (!model.has_geometry()) return kNotAllLevels;
  return std::nullopt;
}

// All scenes of an evaluation share these.
struct EvaluationModels {
  BundleOptions bundle;
  PipelineModels models;
  std::shared_ptr<Lpips> lpips;  // null without weights
  torch::Device device = torch::kCPU;
  PhotographUse photographs;  // of the samples
  PoseEstimator poses = PoseEstimator::kOurs;
  // The geometry head of this model looks at the sources and the generated pictures, for poses; the model's own reads
  // the levels.
  std::optional<PipelineModels> pose_model;
};

}  // namespace gld
