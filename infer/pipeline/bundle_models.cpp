#include "infer/pipeline/bundle_models.h"

#include "gld/base/error.h"

#include <map>
#include <memory>

namespace gld {

PipelineModels bundle_models(const ModelBundle& bundle, const torch::Device& device,
                             ComputePrecision precision) {
  const auto packed = [precision](auto module, ModelKind kind) {
    LayerPrecision layers = layer_precision(precision, kind);
    layers.originals = PackedOriginals::kRelease;
    use_precision(*module, layers);
    return module;
  };
  const auto shared = std::make_shared<const ModelBundle>(bundle);
  ParameterPlacement placement;
  placement.device = device;
  PipelineModels models;
  models.backbone = [=] {
    return packed(shared->load_backbone(placement), model_kind_of(StageKind::kSourceEncoding));
  };
  models.levels = bundle.options().level_set();
  models.generator = [=](size_t number) {
    return packed(shared->load_generator(shared->options().generators.at(number).generator, placement),
                  model_kind_of(StageKind::kFlow));
  };
  models.rgb_decoder = [=] {
    return packed(shared->load_image_decoder(placement), model_kind_of(StageKind::kRgbDecoding));
  };
  // It stays in float32 (ModelKind::kLeanedOn).
  models.geometry_head = [=] { return shared->load_geometry_head(placement); };
  // On the CPU, where photographs are.
  if (bundle.options().blending.exists()) models.blending = [=] { return shared->load_blending(); };
  if (bundle.options().depth_refinement.exists())
    models.depth_refinement = [=] { return shared->load_depth_refinement(); };
  if (bundle.options().refiner.repairs_samples()) {
    models.refiner = [=] {
      return packed(shared->load_refiner(placement), model_kind_of(StageKind::kSampleRefinement));
    };
  }
  for (const auto& part : bundle.options().generators) {
    models.statistics.push_back(bundle.load_statistics(part.generator).to(device));
  }
  return models;
}

PhotographUse photograph_use_of(const PhotographOptions& options, const ModelBundle& bundle) {
  PhotographModel model;
  model.warped_sources = bundle.options().level_set().warped_sources;
  model.has_geometry_head = bundle.options().geometry_head.predicts_rays();
  model.has_blending = bundle.options().blending.exists() && bundle.has(BundlePart::blending());
  model.has_depth_refinement =
      bundle.options().depth_refinement.exists() && bundle.has(BundlePart::depth_refinement());
  return options.use(model);
}

void require_geometry_head(const ModelBundle& bundle) {
  if (bundle.options().geometry_head.exists()) return;
  fail({"--geometry-model", "a bundle with a geometry head", bundle.folder().string() + ", which has none",
        "choose a DA3 or VGGT model"});
}

void take_geometry_from(PipelineModels& models, const ModelBundle& bundle, const torch::Device& device) {
  require_geometry_head(bundle);
  const auto shared = std::make_shared<const ModelBundle>(bundle);
  ParameterPlacement placement;
  placement.device = device;
  models.geometry_model_backbone = [=] { return shared->load_backbone(placement); };
  models.geometry_model_head = [=] { return shared->load_geometry_head(placement); };
}

PipelineModels kept_bundle_models(const ModelBundle& bundle, const torch::Device& device,
                                  ComputePrecision precision) {
  PipelineModels models = bundle_models(bundle, device, precision);
  const auto keep = [](auto load) {
    using Module = decltype(load());
    auto kept = std::make_shared<Module>();
    return [load, kept] {
      if (!*kept) *kept = load();
      return *kept;
    };
  };
  models.backbone = keep(models.backbone);
  auto generators = std::make_shared<std::map<size_t, std::shared_ptr<DitDh>>>();
  models.generator = [load = models.generator, generators](size_t number) {
    auto& kept = (*generators)[number];
    if (!kept) kept = load(number);
    return kept;
  };
  models.rgb_decoder = keep(models.rgb_decoder);
  models.geometry_head = keep(models.geometry_head);
  if (models.blending) models.blending = keep(models.blending);
  if (models.depth_refinement) models.depth_refinement = keep(models.depth_refinement);
  if (models.refiner) models.refiner = keep(models.refiner);
  return models;
}

}  // namespace gld
