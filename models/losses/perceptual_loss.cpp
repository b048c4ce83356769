#include "models/losses/perceptual_loss.h"

#include "gld/base/error.h"

namespace gld {
namespace {

constexpr int64_t kLargestStep = 1'000'000'000'000;

}  // namespace

void PerceptualOptions::visit(FieldVisitor& visitor) {
  visitor.real({"weight", "weight of the perceptual loss"}, weight, {0.0, 1e6});
  visitor.integer({"start", "first step with the perceptual loss"}, start, {0, kLargestStep});
  lpips.visit(visitor);
  visitor.group({"standin", "the loss used without LPIPS weights"}, standin);
}

void PerceptualOptions::check() const { lpips.check(); }

std::string standin_note() {
  return "the perceptual loss is a stand-in of gradients and SSIM; LPIPS needs objective.perceptual.lpips_backbone and "
         "lpips_heads";
}

PerceptualLoss::PerceptualLoss(const PerceptualOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)), lpips_(load_lpips(options.lpips, placement)) {
  if (!lpips_) return;
  for (auto& parameter : lpips_->parameters()) parameter.set_requires_grad(false);
}

torch::Tensor PerceptualLoss::operator()(const torch::Tensor& image, const torch::Tensor& prediction) const {
  return (lpips_ ? lpips_->forward(image, prediction)
                 : perceptual_standin(image, prediction, options_.standin))
      .mean();
}

}  // namespace gld
