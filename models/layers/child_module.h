#pragma once

#include <memory>
#include <string>

#include <torch/nn/module.h>

namespace gld {

// Returns a module that only gives the parameters below it a name.
inline std::shared_ptr<torch::nn::Module> child_module(torch::nn::Module& parent, const std::string& name) {
  return parent.register_module(name, std::make_shared<torch::nn::Module>());
}

}  // namespace gld
