#include "gld/metrics/depth_metrics.h"
#include "gld/metrics/image_metrics.h"
#include "verify/reference_runners.h"

namespace gld {
namespace {

struct NoOptions : OptionsGroup {
  void visit(FieldVisitor& /*visitor*/) override {}
};

// Views without a valid pixel count as perfect in the published code.
torch::Tensor published(const torch::Tensor& errors, double perfect) {
  return torch::where(torch::isnan(errors), torch::full_like(errors, perfect), errors);
}

}  // namespace

NamedTensors run_metrics_case(const ReferenceCase& reference) {
  NoOptions options;
  reference.read_config(options);
  NamedTensors outputs;
  if (reference.expects("psnr") || reference.expects("ssim")) {
    const auto image = reference.module_input("image", {-1, -1, -1, -1});
    const auto prediction = reference.module_input("prediction", image.sizes().vec());
    if (reference.expects("psnr")) outputs["psnr"] = psnr(image, prediction);
    if (reference.expects("ssim")) outputs["ssim"] = ssim(image, prediction);
  }
  if (reference.expects("abs_rel") || reference.expects("rmse") || reference.expects("delta1")) {
    const auto depth = reference.module_input("depth", {-1, -1, -1});
    const auto errors = depth_errors(depth, reference.module_input("depth_prediction", depth.sizes().vec()));
    outputs["abs_rel"] = published(errors.abs_rel, 0);
    outputs["rmse"] = published(errors.rmse, 0);
    outputs["delta1"] = published(errors.delta1, 1);
  }
  return outputs;
}

}  // namespace gld
