#pragma once

#include "models/bundle/bundle.h"
#include "models/depth_refinement/refined_source_depth.h"
#include "models/latent_spaces/latent_space.h"
#include "train/loop/objective.h"
#include "train/objectives/kept_scenes.h"

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <torch/types.h>

namespace gld {

struct DepthRefinementObjectiveOptions : OptionsGroup {
  ModelStart start = ModelStart::kRandom;
  // Of log(|e| + 0.01), e the error of log depth: a pixel that is right to a hundredth is worth more than one that is
  // wrong by a tenth in the place of two tenths, which carries a photograph to a wrong place as well.
  double logarithmic_weight = 0.05;
  double edge_weight = 1;  // of what neighbouring pixels' log depths differ by, where it should be otherwise
  double kept_gib = 0;     // of what the network is shown of scenes that were seen before

  void visit(FieldVisitor& visitor) override;
};

// Trains the network that mends the depth of source views (models/depth_refinement) on what frozen backbone and
// geometry head, and the photographs themselves, say of scenes with two sources or more and true depth:
// mean |e| + logarithmic_weight log(|e| + 0.01) + edge_weight |difference of e between neighbours|, e = log(depth /
// true depth), over the source views' pixels whose depth is known. Half of the time all of a scene is mirrored.
class DepthRefinementObjective : public Objective {
 public:
  DepthRefinementObjective(const BundleOptions& model, const DepthRefinementObjectiveOptions& options,
                           std::shared_ptr<const Backbone> backbone, std::shared_ptr<const GeometryHead> head,
                           int64_t seed);
  // Goes on with a trained network of the same architecture.
  void start_from(std::shared_ptr<DepthRefinement> trained) { refinement_ = std::move(trained); }

  // Keeps what the network is shown in that folder too.
  void keep_in(std::shared_ptr<const KeptFolder> folder) { kept_.keep_in(std::move(folder)); }

  std::string kind() const override { return "depth"; }
  torch::Device device() const override { return torch::kCPU; }
  bool concurrent() const override { return true; }
  int64_t learn_in(ComputePrecision precision) override;
  std::vector<NamedParameter> parameters() const override;
  std::vector<NamedParameter> untrained() const override;
  Losses losses(const TrainingBatch& batch, const StepContext& context) override;
  // Measures depth that is not mended and mended depth: abs_rel of source views, not scaled to the truth, the mean of
  // scenes; the same over all pixels that another source view shows as well (shared) and that none does (alone); and
  // the PSNR of target views that photographs are carried into by it, by rule and with gaps filled.
  Validation validate(const std::vector<TrainingScene>& scenes) override;
  void export_model(const std::filesystem::path& folder, DType dtype) const override;

 private:
  struct Lesson {
    DepthEvidence evidence;
    torch::Tensor off;    // (sources, 1, height, width): log(depth / true depth); 0 where either is not known
    torch::Tensor known;  // (sources, 1, height, width), bool
  };
  static std::array<std::pair<const char*, torch::Tensor*>, 8> named_parts(Lesson& lesson);
  // Returns nothing where the depth is not known.
  std::optional<Lesson> lesson_of(const TrainingScene& scene) const;
  std::optional<Lesson> kept_lesson_of(const TrainingScene& scene);

  BundleOptions model_;
  DepthRefinementObjectiveOptions options_;
  LatentSpace space_;
  std::shared_ptr<const GeometryHead> head_;
  std::shared_ptr<DepthRefinement> refinement_;
  KeptScenes kept_;
};

}  // namespace gld
