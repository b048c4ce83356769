#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <torch/types.h>

namespace gld {

// Returns standard normal noise for the views of a scene, (views, shape...), float32 on the CPU. A view's noise depends
// on the seed, the stream's name ("level 1") and the view's index alone: not on the number of views, the device, the
// number of threads, or the version of LibTorch (gld/base/philox.h).
torch::Tensor views_noise(uint64_t seed, const std::string& stream, int64_t views,
                          const std::vector<int64_t>& shape);

}  // namespace gld
