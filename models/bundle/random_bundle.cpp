#include "models/bundle/random_bundle.h"

#include "gld/base/configuration.h"
#include "gld/base/philox.h"
#include "gld/tensors/weight_tensors.h"
#include "models/decoders/dpt_head.h"
#include "models/weights/weight_loading.h"

#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include <ATen/CPUGeneratorImpl.h>
#include <torch/types.h>

#include <fmt/format.h>

namespace gld {
namespace {

bool ends_with(const std::string& text, const std::string& ending) {
  return text.size() >= ending.size() &&
         text.compare(text.size() - ending.size(), ending.size(), ending) == 0;
}

torch::Tensor normal(const std::vector<int64_t>& shape, double mean, double deviation,
                     torch::Generator generator) {
  return torch::empty(shape, torch::kFloat32).normal_(mean, deviation, std::move(generator));
}

// Scales keep activations near 1 through any depth; what training starts at zero gets a tenth of the usual scale.
torch::Tensor random_weight(const TensorEntry& entry, torch::Generator generator) {
  const std::string& name = entry.name;
  const auto& shape = entry.shape;
  if (ends_with(name, "t_embedder.W")) return normal(shape, 0, 1, std::move(generator));
  if (ends_with(name, "gamma")) return normal(shape, 0.3, 0.03, std::move(generator));
  if (ends_with(name, "pos_embed") || ends_with(name, "token"))
    return normal(shape, 0, 0.3, std::move(generator));
  if (shape.size() == 1 && ends_with(name, "weight")) return normal(shape, 1, 0.1, std::move(generator));
  if (shape.size() < 2) return normal(shape, 0, 0.02, std::move(generator));
  int64_t inputs = 1;
  for (size_t axis = 1; axis < shape.size(); ++axis) inputs *= shape[axis];
  const bool starts_at_zero = name.find("adaLN_modulation") != std::string::npos;
  return normal(shape, 0, (starts_at_zero ? 0.1 : 1.0) / std::sqrt(static_cast<double>(inputs)),
                std::move(generator));
}

std::vector<TensorEntry> entries_of(const BundlePart& part, const BundleOptions& options, DType dtype) {
  std::vector<TensorEntry> entries;
  ParameterPlacement meta;
  meta.device = torch::kMeta;
  const auto module = make_bundle_module(part, options, meta);
  if (module == nullptr) {
    for (const char* name : {"mean", "var"}) {
      TensorEntry entry;
      entry.name = name;
      entry.shape = {options.backbone.level_channels()};
      entries.push_back(entry);
    }
    return entries;
  }
  for (const auto& [name, tensor] : named_tensors(*module)) {
    TensorEntry entry;
    entry.name = name;
    entry.dtype = tensor.is_floating_point() ? dtype : file_dtype(tensor.scalar_type(), name);
    entry.shape = tensor.sizes().vec();
    entries.push_back(std::move(entry));
  }
  return entries;
}

}  // namespace

void write_random_bundle(const std::filesystem::path& folder, const BundleOptions& options, uint64_t seed,
                         DType dtype) {
  save_bundle_options(folder, options);
  for (const BundlePart& part : bundle_parts(options)) {
    const std::string part_name = bundle_part_name(part);
    const auto make = [&](const TensorEntry& entry) {
      auto generator = at::detail::createCPUGenerator(seed ^ fnv1a(part_name + "." + entry.name));
      if (entry.name == "mean") return normal(entry.shape, 0, 1, generator);
      if (entry.name == "var") return torch::empty(entry.shape, torch::kFloat32).uniform_(0.5, 2, generator);
      return random_weight(entry, generator).to(torch_dtype(entry.dtype, entry.name));
    };
    save_safetensors(folder / (part_name + ".safetensors"), entries_of(part, options, dtype), make);
  }
}

BundleOptions small_bundle_options() {
  constexpr int64_t kWidth = 64;
  BundleOptions options;
  options.name = "small random model";
  apply_setting(options, fmt::format("backbone.embed_dim={}", kWidth));
  apply_setting(options, "backbone.num_heads=4");
  auto& head = options.geometry_head.as<DptHeadOptions>();
  head.dim_in = 2 * kWidth;
  head.features = 32;
  head.out_channels = {24, 48, 96, 192};
  options.rgb_decoder.in_channels = 8 * kWidth;
  options.rgb_decoder.hidden_size = kWidth;
  options.rgb_decoder.num_layers = 3;
  options.rgb_decoder.num_heads = 4;
  options.rgb_decoder.intermediate_size = 2 * kWidth;
  for (auto& part : options.generators) {
    part.dit.in_channels = 2 * kWidth;
    part.dit.hidden_size = {kWidth, 2 * kWidth};
    part.dit.depth = {3, 2};
    part.dit.num_heads = {4, 4};
  }
  return options;
}

}  // namespace gld
