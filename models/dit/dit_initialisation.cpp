// Random weights of a DiT^DH before training.
#include "models/dit/dit_dh.h"

#include <cmath>
#include <map>
#include <string>

#include <torch/types.h>

namespace gld {
namespace {

bool contains(const std::string& name, const std::string& part) {
  return name.find(part) != std::string::npos;
}

bool ends_with(const std::string& name, const std::string& part) {
  return name.size() >= part.size() && name.compare(name.size() - part.size(), part.size(), part) == 0;
}

bool starts_at_zero(const std::string& name) {
  return contains(name, "adaLN_modulation.") || contains(name, "final_layer.linear.") ||
         contains(name, "special_output_proj.") ||
         // So that weights of a model without it are a good beginning of one with it.
         contains(name, "warp_embedder.") || name == "carried_gate.weight";
}

bool is_embedder(const std::string& name) {
  return contains(name, "embedder") && !contains(name, "t_embedder.");
}

}  // namespace

void DitDh::initialise(const torch::Generator& generator) {
  torch::NoGradGuard no_grad;
  std::map<std::string, torch::Tensor> parameters;
  for (const auto& item : named_parameters()) parameters[item.key()] = item.value();
  for (auto& [name, parameter] : parameters) {
    const auto normal = [&, &target = parameter](double deviation) {
      target.copy_(torch::empty(target.sizes(), torch::kFloat32).normal_(0, deviation, generator));
    };
    const auto uniform = [&, &target = parameter](double bound) {
      target.copy_(torch::empty(target.sizes(), torch::kFloat32).uniform_(-bound, bound, generator));
    };
    if (starts_at_zero(name)) {
      parameter.zero_();
    } else if (name == "carried_gate.bias") {
      parameter.fill_(2.0);  // what all photographs agree on is nearly believed
    } else if (name == "t_embedder.W") {
      normal(1.0);
    } else if (contains(name, "special_pos_embed_") ||
               (contains(name, "t_embedder.mlp.") && ends_with(name, ".weight"))) {
      normal(0.02);
    } else if (is_embedder(name)) {
      if (ends_with(name, ".bias")) {
        parameter.zero_();
      } else {
        const int64_t outputs = parameter.size(0), inputs = parameter.numel() / outputs;
        uniform(std::sqrt(6.0 / static_cast<double>(inputs + outputs)));
      }
    } else if (parameter.dim() == 1 && ends_with(name, ".weight")) {
      parameter.fill_(1.0);  // norms
    } else {
      const auto& matrix =
          parameters.at(ends_with(name, ".bias") ? name.substr(0, name.size() - 4) + "weight" : name);
      uniform(1.0 / std::sqrt(static_cast<double>(matrix.size(1))));
    }
  }
}

}  // namespace gld
