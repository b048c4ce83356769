#include "infer/bundle_models.h"

#include "gld/error.h"

#include <memory>

#include <torch/cuda.h>

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

torch::Device device_from_text(const std::string& text) {
  const bool cuda = text == "cuda" || text.rfind("cuda:", 0) == 0;
  const std::string number = text.rfind("cuda:", 0) == 0 ? text.substr(5) : "0";
  const bool plain_number =
      !number.empty() && number.size() < 4 && number.find_first_not_of("0123456789") == std::string::npos;
  if (text != "cpu" && !(cuda && plain_number)) {
    fail({"--device", "cpu, cuda or cuda:N", "'" + text + "'", "write for example --device cpu"});
  }
  if (!cuda) return torch::kCPU;
  const auto available = static_cast<int64_t>(torch::cuda::device_count());
  if (std::stoll(number) >= available) {
    fail({"--device", "one of the " + std::to_string(available) + " CUDA devices that this LibTorch sees",
          "'" + text + "'", available == 0 ? "use --device cpu" : "choose a smaller number"});
  }
  return {torch::kCUDA, static_cast<c10::DeviceIndex>(std::stoi(number))};
}

}  // namespace gld
