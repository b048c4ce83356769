#pragma once

#include "infer/forecast/sampling_plan.h"
#include "models/bundle/bundle_options.h"

#include <cstdint>
#include <string>

namespace gld {

// Returns a sentence about what this request takes, that it does not fit into so many bytes, and which number of
// photographs or views or which image size would; empty where it fits.
std::string memory_refusal(const BundleOptions& bundle, const PlanRequest& request, int64_t available_bytes);

}  // namespace gld
