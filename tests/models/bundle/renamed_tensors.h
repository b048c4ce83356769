#pragma once

#include <map>
#include <string>

#include <torch/types.h>

namespace gld::test {

using Tensors = std::map<std::string, torch::Tensor>;

inline Tensors with_prefix(const Tensors& tensors, const std::string& prefix) {
  Tensors renamed;
  for (const auto& [name, tensor] : tensors) renamed[prefix + name] = tensor;
  return renamed;
}

}  // namespace gld::test
