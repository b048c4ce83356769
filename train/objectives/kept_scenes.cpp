#include "train/objectives/kept_scenes.h"

#include <utility>

namespace gld {
namespace {

// Different views of one scene have different cameras, and so have crops of one view.
std::string key_of(const TrainingScene& scene, const std::string& variant) {
  std::string key = scene.name + '/' + std::to_string(scene.views.num_sources) + '/' + variant + '/';
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

}  // namespace

KeptScenes::KeptScenes(double gib) : most_bytes_(static_cast<int64_t>(gib * (int64_t{1} << 30))) {}

std::shared_ptr<const void> KeptScenes::get(const TrainingScene& scene, const std::string& variant,
                                            const std::function<Made()>& make) {
  std::string key = key_of(scene, variant);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto found = kept_.find(key);
    if (found != kept_.end()) return found->second;
  }
  const Made made = make();
  const int64_t bytes = made.bytes + static_cast<int64_t>(key.size());
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (bytes_ + bytes <= most_bytes_ && kept_.emplace(std::move(key), made.value).second) bytes_ += bytes;
  }
  return made.value;
}

}  // namespace gld
