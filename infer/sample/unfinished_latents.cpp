#include "infer/sample/unfinished_latents.h"

#include "gld/files/weight_file.h"
#include "gld/tensors/weight_tensors.h"

#include <cstdio>
#include <system_error>

#include <torch/types.h>

namespace gld {
namespace {

constexpr const char* kModelHash = "gld:model";
constexpr const char* kMethod = "gld:method";

}  // namespace

std::map<int64_t, torch::Tensor> UnfinishedLatents::read(const Origin& origin) const {
  std::map<int64_t, torch::Tensor> latents;
  std::error_code none;
  for (const auto& item : std::filesystem::directory_iterator(folder_, none)) {
    const std::string name = item.path().filename().string();
    long long level = 0;
    int end = 0;
    if (std::sscanf(name.c_str(), "level%lld.safetensors%n", &level, &end) != 1 ||
        end != static_cast<int>(name.size())) {
      continue;
    }
    const auto file = WeightFile::open(item.path());
    const auto is = [&](const char* name, const std::string& value) {
      const auto found = file->metadata().find(name);
      return found != file->metadata().end() && found->second == value;
    };
    if (!is(kModelHash, origin.model_hash) || !is(kMethod, origin.method)) continue;
    latents[level] = read_tensor(*file, "latent").clone();
  }
  return latents;
}

void UnfinishedLatents::write(int64_t level, const torch::Tensor& latent, const Origin& origin) const {
  std::filesystem::create_directories(folder_);
  save_safetensors(folder_ / ("level" + std::to_string(level) + ".safetensors"), {{"latent", latent}},
                   {{kModelHash, origin.model_hash}, {kMethod, origin.method}});
}

void UnfinishedLatents::remove() const {
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

}  // namespace gld
