#pragma once

#include <string>

#include <torch/types.h>

namespace gld {

// Whether something says what is read from LibTorch's meta device, which has shapes without numbers: never in the
// program, in tests where whole commands run on it (tests/support/meta_device.h).
bool reads_meta_device();

// "cpu", "cuda" or "cuda:N"; "meta" where reads_meta_device(). Throws Error for another text and for a device that
// LibTorch does not have.
torch::Device device_from_text(const std::string& text);

}  // namespace gld
