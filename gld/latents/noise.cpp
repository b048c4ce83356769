#include "gld/latents/noise.h"

#include "gld/base/philox.h"

#include <torch/types.h>

namespace gld {

torch::Tensor views_noise(uint64_t seed, const std::string& stream, int64_t views,
                          const std::vector<int64_t>& shape) {
  std::vector<int64_t> sizes = {views};
  sizes.insert(sizes.end(), shape.begin(), shape.end());
  auto noise = torch::empty(sizes, torch::kFloat32);
  const int64_t per_view = views == 0 ? 0 : noise.numel() / views;
  NormalRun run;
  run.key = philox_key(seed, stream);
  for (int64_t view = 0; view < views; ++view) {
    run.index = static_cast<uint64_t>(view);
    fill_normal(run, noise.data_ptr<float>() + view * per_view, per_view);
  }
  return noise;
}

}  // namespace gld
