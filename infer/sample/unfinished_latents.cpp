#include "infer/sample/unfinished_latents.h"

#include "gld/base/error.h"
#include "gld/base/sha256.h"
#include "gld/files/weight_file.h"
#include "gld/tensors/weight_tensors.h"

#include <cstdio>
#include <system_error>

#include <torch/types.h>

namespace gld {
namespace {

constexpr const char* kModelHash = "gld:model";
constexpr const char* kMethod = "gld:method";
constexpr const char* kInputs = "gld:inputs";
constexpr const char* kChecksum = "gld:checksum";

std::string checksum_of(const torch::Tensor& latent) {
  const auto bytes = latent.detach().cpu().contiguous();
  Sha256 hash;
  hash.update(shape_text(bytes.sizes().vec()));
  hash.update(ByteView{static_cast<const uint8_t*>(bytes.data_ptr()), bytes.nbytes()});
  return hash.hex_digest();
}

// Adds the bits of the numbers, with their length, so that two lists never run into each other.
template <class Number>
void add(Sha256& hash, const Number* numbers, size_t count) {
  const uint64_t length = count * sizeof(Number);
  hash.update(ByteView{reinterpret_cast<const uint8_t*>(&length), sizeof(length)});
  hash.update(ByteView{reinterpret_cast<const uint8_t*>(numbers), length});
}

void add(Sha256& hash, const Camera& camera) {
  const int64_t size[] = {camera.width, camera.height};
  const Eigen::Matrix4d pose = camera.world_from_camera.matrix();
  add(hash, size, 2);
  add(hash, camera.intrinsics.data(), 9);
  add(hash, pose.data(), 16);
}

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
    try {
      const auto file = WeightFile::open(item.path());
      const auto is = [&](const char* key, const std::string& value) {
        const auto found = file->metadata().find(key);
        return found != file->metadata().end() && found->second == value;
      };
      if (!is(kModelHash, origin.model_hash) || !is(kMethod, origin.method) || !is(kInputs, origin.inputs))
        continue;
      const torch::Tensor latent = read_tensor(*file, "latent").clone();
      if (is(kChecksum, checksum_of(latent))) latents[level] = latent;
    } catch (const Error&) {
      // The file is damaged, which costs no more than the stage that made it.
    }
  }
  return latents;
}

void UnfinishedLatents::write(int64_t level, const torch::Tensor& latent, const Origin& origin) const {
  std::filesystem::create_directories(folder_);
  save_safetensors(folder_ / ("level" + std::to_string(level) + ".safetensors"), {{"latent", latent}},
                   {{kModelHash, origin.model_hash},
                    {kMethod, origin.method},
                    {kInputs, origin.inputs},
                    {kChecksum, checksum_of(latent)}});
}

void UnfinishedLatents::remove() const {
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

std::string inputs_hash(const SamplingScene& scene) {
  Sha256 hash;
  const int64_t counts[] = {scene.size.width, scene.size.height, scene.views.num_sources,
                            scene.metric ? 1 : 0};
  add(hash, counts, 4);
  for (const auto& name : scene.view_names) add(hash, name.data(), name.size());
  for (const Camera& camera : scene.views.cameras) add(hash, camera);
  for (const Image& image : scene.source_images) add(hash, image.rgb.data(), image.rgb.size());
  for (const DepthMap& depth : scene.source_depths) add(hash, depth.metres.data(), depth.metres.size());
  if (scene.seen_depth) {
    for (const PlanarDepth& depth : scene.seen_depth->views)
      add(hash, depth.values.data(), depth.values.size());
  }
  for (const PicturedView& view : scene.photographs.views) {
    add(hash, view.camera);
    add(hash, view.rgb.data(), view.rgb.size());
  }
  for (const auto& points : {scene.points_in_world, scene.photographs.points_in_world}) {
    for (const Eigen::Vector3d& point : points) add(hash, point.data(), 3);
  }
  return hash.hex_digest();
}

}  // namespace gld
