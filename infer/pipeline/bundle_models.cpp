#include "infer/pipeline/bundle_models.h"

#include <memory>

namespace gld {

PipelineModels bundle_models(const ModelBundle& bundle, const torch::Device& device) {
  const auto shared = std::make_shared<const ModelBundle>(bundle);
  ParameterPlacement placement;
  placement.device = device;
  PipelineModels models;
  models.backbone = [=] { return shared->load_backbone(placement); };
  models.level1 = [=] { return shared->load_level1(placement); };
  models.cascade = [=] { return shared->load_cascade(placement); };
  models.rgb_decoder = [=] { return shared->load_rgb_decoder(placement); };
  models.dpt_head = [=] { return shared->load_dpt_head(placement); };
  const double epsilon = bundle.options().latent_epsilon;
  models.level0_statistics =
      read_latent_statistics(bundle.file(BundlePart::kStatisticsLevel0), epsilon).to(device);
  models.level1_statistics =
      read_latent_statistics(bundle.file(BundlePart::kStatisticsLevel1), epsilon).to(device);
  return models;
}

PipelineModels kept_bundle_models(const ModelBundle& bundle, const torch::Device& device) {
  PipelineModels models = bundle_models(bundle, device);
  const auto keep = [](auto load) {
    using Module = decltype(load());
    auto kept = std::make_shared<Module>();
    return [load, kept] {
      if (!*kept) *kept = load();
      return *kept;
    };
  };
  models.backbone = keep(models.backbone);
  models.level1 = keep(models.level1);
  models.cascade = keep(models.cascade);
  models.rgb_decoder = keep(models.rgb_decoder);
  models.dpt_head = keep(models.dpt_head);
  return models;
}

}  // namespace gld
