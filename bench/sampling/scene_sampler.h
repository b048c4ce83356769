#pragma once

#include "bench/sampling/sample_table.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/losses/lpips.h"

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

// A scene and everything that does not depend on how it is sampled.
struct BenchmarkScene {
  std::string name;
  PipelineRequest request;  // without the method
  torch::Tensor truth;      // (targets, 3, height, width); undefined where a target has none
  LatentGrid grid;          // of all views
};

// What sampling a scene one way gave.
struct SampledScene {
  PipelineResult result;
  double seconds = 0;  // of M1, the cascade and a refiner of what they made
  int64_t peak_bytes = 0;
  bool finite = true;  // false: sampling stopped at a value that was not, and result is empty
};

// Samples scenes in all ways, with the models of each precision loaded when it is first asked for. It is for one thread
// at a time; lpips is null where its weights are not there.
class SceneSampler {
 public:
  using ModelLoader = std::function<PipelineModels(ComputePrecision)>;
  SceneSampler(const BundleOptions& bundle, ModelLoader load, std::shared_ptr<Lpips> lpips)
      : bundle_(bundle), load_(std::move(load)), lpips_(std::move(lpips)) {}

  SampledScene run(const BenchmarkScene& scene, const ComparedMethod& compared);
  // Runs it and compares it with the reference, which is finite.
  Sample measure(const BenchmarkScene& scene, const ComparedMethod& compared, const SampledScene& reference);
  // Measures the reference itself. Throws Error where it is not finite.
  Sample reference_sample(const BenchmarkScene& scene, const SampledScene& reference) const;

 private:
  using Latents = std::map<int64_t, torch::Tensor>;

  Sample sample_of(const BenchmarkScene& scene, const SampledScene& made) const;
  Latents latents_in_float32(const BenchmarkScene& scene, ComparedMethod compared);

  BundleOptions bundle_;
  ModelLoader load_;
  std::shared_ptr<Lpips> lpips_;
  std::map<ComputePrecision, std::optional<PipelineModels>> models_;  // those that were needed
  // Of the last scene and guidance scale: of the plain method at each count, which other precisions are compared with.
  std::string kept_scene_;
  double kept_scale_ = 0;
  std::map<int64_t, Latents> plain_latents_;
};

}  // namespace gld
