#pragma once

#include "gld/machine/stage_record.h"

#include <string>

#include <torch/types.h>

namespace gld {

// Returns whether something says what is read from LibTorch's meta device, which has shapes without numbers: never in
// the program, in tests where whole commands run on it (tests/support/meta_device.h).
bool reads_meta_device();

// text is "cpu", "cuda" or "cuda:N", and "meta" where reads_meta_device(). Throws Error for another text and for a
// device that LibTorch does not have.
torch::Device device_from_text(const std::string& text);

// Returns the name under which it is sold: "NVIDIA H100 80GB HBM3", or the processor's.
std::string device_name(const torch::Device& device);

// Waits until a GPU has computed all that was asked of it: what follows, a clock among it, sees it done. Elsewhere
// nothing is queued.
void finish_queued_work(const torch::Device& device);

// Has stages wait for that device and record the memory that its tensors had at most (most_used_device_bytes in
// torch_version.h).
void record_device(StageRecords& stages, const torch::Device& device);

}  // namespace gld
