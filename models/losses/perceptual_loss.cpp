#include "models/losses/perceptual_loss.h"

#include "gld/base/error.h"

namespace gld {
namespace {

constexpr int64_t kLargestStep = 1'000'000'000'000;

}  // namespace

void PerceptualOptions::visit(FieldVisitor& visitor) {
  visitor.real({"weight", "weight of the perceptual loss"}, weight, {0.0, 1e6});
  visitor.integer({"start", "first step with the perceptual loss"}, start, {0, kLargestStep});
  visitor.text({"lpips_backbone", "classification network of LPIPS; empty uses the stand-in"},
               lpips_backbone);
  visitor.text({"lpips_heads", "published linear heads of LPIPS"}, lpips_heads);
  visitor.group({"lpips", "which LPIPS"}, lpips);
  visitor.group({"standin", "the loss used without LPIPS weights"}, standin);
}

void PerceptualOptions::check() const {
  if (lpips_backbone.empty() != lpips_heads.empty()) {
    fail({"perceptual", "both lpips_backbone and lpips_heads, or neither",
          lpips_backbone.empty() ? "only lpips_heads" : "only lpips_backbone",
          "give the other file as well"});
  }
}

std::string standin_note() {
  return "the perceptual loss is a stand-in of gradients and SSIM; LPIPS needs objective.perceptual.lpips_backbone and "
         "lpips_heads";
}

PerceptualLoss::PerceptualLoss(const PerceptualOptions& options, const ParameterPlacement& placement)
    : options_((options.check(), options)) {
  if (options_.lpips_backbone.empty()) return;
  lpips_ = std::make_shared<Lpips>(options_.lpips, placement);
  load_lpips(*lpips_, *WeightFile::open(options_.lpips_backbone), *WeightFile::open(options_.lpips_heads));
  for (auto& parameter : lpips_->parameters()) parameter.set_requires_grad(false);
}

torch::Tensor PerceptualLoss::operator()(const torch::Tensor& image, const torch::Tensor& prediction) const {
  return (lpips_ ? lpips_->forward(image, prediction)
                 : perceptual_standin(image, prediction, options_.standin))
      .mean();
}

}  // namespace gld
