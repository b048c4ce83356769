#pragma once

#include "gld/base/options.h"
#include "gld/flow/guidance.h"
#include "gld/flow/solvers/solver.h"
#include "gld/machine/matrix_unit.h"
#include "infer/pipeline/sampling_pipeline.h"
#include "models/bundle/bundle_options.h"
#include "models/dit/approximate_savings.h"

#include <string>
#include <vector>

namespace gld {

// Everything that trades error for time when a scene is sampled. Not the guidance scale: that changes what is sampled.
struct SamplingMethod : OptionsGroup {
  std::string name;  // for people
  SolverOptions solver;
  std::vector<double> guidance_interval{0, 1};  // flow times where guidance acts, both included
  ApproximateSavings approximate;
  // Whether the latents that the flows made are repaired in one call a target view
  // (infer/pipeline/sample_refinement.h).
  bool refine = false;
  ComputePrecision precision = ComputePrecision::kFloat32;

  SamplingMethod();
  void visit(FieldVisitor& visitor) override;
};

// Returns what --solver, --guidance and --approximate say, in that precision.
SamplingMethod method_of_options(const SolverOptions& solver, const GuidanceOptions& guidance,
                                 const ApproximateSavings& approximate, ComputePrecision precision);

// Returns whether both sample alike, whatever they are called.
bool same_method(const SamplingMethod& a, const SamplingMethod& b);

// Returns for example "unipc3 on logsnr, 16 evaluations a level; cascade encoder at 6 flow times".
std::string method_text(const SamplingMethod& method, const std::string& device = "cpu");

// --quality. `options` is what the other options say; the rest are fixed methods, guided everywhere and without
// approximate savings, none of which beat fewer steps where it was measured (docs/NUMBERS.md, "What can be left out
// approximately").
//
// | quality   | solver on schedule | evaluations |
// |-----------|--------------------|-------------|
// | published | euler on published | 49          |
// | exact     | unipc3 on logsnr   | 16          |
// | fast      | unipc3 on logsnr   | 6           |
enum class SamplingQuality { kOptions, kPublished, kExact, kFast };
const std::vector<std::string>& sampling_quality_names();

// Returns whether a cascade's condition encoder can be computed at nodes (models/dit/node_field.h).
bool can_have_encoder_nodes(const BundleOptions& bundle);

// Returns the method of any quality but kOptions.
SamplingMethod quality_method(SamplingQuality quality);

// Throws Error, naming --refine, where a model has no refiner of samples.
void require_sample_refiner(const BundleOptions& bundle);

// Returns the method with a model's time shifts and a guidance scale: what the flows are run with. guidance gives what
// the method does not say: scale and how branches are evaluated. A shift of 0 in the method's schedule is the model's.
FlowSettings flow_settings(const SamplingMethod& method, const GuidanceOptions& guidance,
                           const BundleOptions& bundle);
// Returns the settings that predict the mean of what could be there: one evaluation of each flow from t = 1, without
// guidance. It is a regression, which PSNR rewards, and not a sample: neighbouring possibilities are averaged.
FlowSettings mean_prediction_settings(const BundleOptions& bundle);

}  // namespace gld
