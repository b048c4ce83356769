#include "datasets/loading/dataset.h"

namespace gld {
namespace {

constexpr size_t kScenesKept = 1000;

}  // namespace

FolderDataset::FolderDataset(const std::vector<std::string>& roots, const SceneReading& reading)
    : reading_(reading) {
  for (const auto& root : roots) {
    const auto found = list_scenes(root, reading);
    locations_.insert(locations_.end(), found.begin(), found.end());
  }
  scenes_.resize(locations_.size());
}

std::string FolderDataset::scene_name(int64_t index) const {
  const SceneLocation& location = locations_.at(static_cast<size_t>(index));
  return location.path.string() + (location.part.empty() ? "" : " " + location.part);
}

Scene FolderDataset::scene(int64_t index) const {
  const auto i = static_cast<size_t>(index);
  const SceneLocation& location = locations_.at(i);
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (scenes_[i]) return *scenes_[i];
  }
  // The scene is read outside the lock: two threads may read the same scene once each, none waits for the other's disk.
  SceneReading reading = reading_;
  if (!location.part.empty()) reading.part = location.part;
  auto scene = std::make_shared<const Scene>(open_scene(location.path, reading));
  const std::lock_guard<std::mutex> lock(mutex_);
  if (!scenes_[i]) kept_.push_back(i);
  scenes_[i] = scene;
  if (kept_.size() > kScenesKept) {
    scenes_[kept_.front()] = nullptr;
    kept_.pop_front();
  }
  return *scene;
}

}  // namespace gld
