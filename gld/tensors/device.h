#pragma once

#include <string>

#include <torch/types.h>

namespace gld {

// "cpu", "cuda" or "cuda:N". Throws Error for another text and for a device that LibTorch does not have.
torch::Device device_from_text(const std::string& text);

}  // namespace gld
