#include "train/objectives/kept_scenes.h"

#include "gld/base/sha256.h"

#include <utility>

namespace gld {
namespace {

// Different views of one scene have different cameras, and so have crops of one view.
std::string cameras_key(const TrainingScene& scene) {
  std::string key = std::to_string(scene.views.num_sources) + '/';
  const auto append = [&key](const auto& matrix) {
    key.append(reinterpret_cast<const char*>(matrix.data()),
               sizeof(double) * static_cast<size_t>(matrix.size()));
  };
  for (const Camera& camera : scene.views.cameras) {
    append(Eigen::Matrix4d(camera.world_from_camera.matrix()));
    append(camera.intrinsics);
    key += std::to_string(camera.width) + 'x' + std::to_string(camera.height);
  }
  return key;
}

std::string content_hash(const torch::Tensor& tensor) {
  Sha256 hash;
  if (tensor.defined()) {
    const auto values = tensor.contiguous();
    hash.update({static_cast<const uint8_t*>(values.data_ptr()), values.nbytes()});
  }
  return hash.hex_digest();
}

}  // namespace

KeptScenes::KeptScenes(double gib) : most_bytes_(static_cast<int64_t>(gib * (int64_t{1} << 30))) {}

KeptTensors KeptScenes::from_folder(const TrainingScene& scene, const std::string& variant,
                                    const std::function<KeptTensors()>& make) const {
  if (!folder_) return make();
  const std::string key = variant + '/' + content_hash(scene.images) + '/' + content_hash(scene.depth) +
                          (scene.metric ? "/metric/" : "/") + cameras_key(scene);
  if (auto found = folder_->find(key)) return std::move(found->tensors);
  KeptThing made{make(), {}};
  folder_->keep(key, made);
  return std::move(made.tensors);
}

KeptTensors KeptScenes::get(const TrainingScene& scene, const std::string& variant,
                            const std::function<KeptTensors()>& make) {
  if (most_bytes_ == 0) return from_folder(scene, variant, make);
  std::string key = scene.name + '/' + variant + '/' + cameras_key(scene);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = kept_.find(key);
    if (found != kept_.end()) return found->second;
  }
  KeptTensors made = from_folder(scene, variant, make);
  auto bytes = static_cast<int64_t>(key.size());
  for (const auto& item : made) bytes += static_cast<int64_t>(item.second.nbytes());
  const std::lock_guard<std::mutex> lock(mutex_);
  if (bytes_ + bytes > most_bytes_) return made;
  // A file that stays open is one of the few thousand mappings that a process may have.
  if (folder_) {
    for (auto& item : made) item.second = item.second.clone();
  }
  if (kept_.emplace(std::move(key), made).second) bytes_ += bytes;
  return made;
}

}  // namespace gld
