#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/scenes/scene.h"

#include <cstdint>
#include <deque>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

namespace gld {

// A list of scenes. Safe to use from several threads.
class Dataset {
 public:
  virtual ~Dataset() = default;
  virtual int64_t size() const = 0;
  virtual std::string scene_name(int64_t index) const = 0;
  // Throws Error when the scene cannot be read.
  virtual Scene scene(int64_t index) const = 0;
};

// All scenes below some folders, folder by folder, in any of the layouts. The cameras of the last thousand scenes that
// were read are kept, pixels are not: all cameras of RealEstate10K would take gigabytes.
class FolderDataset : public Dataset {
 public:
  FolderDataset(const std::filesystem::path& root, const SceneReading& reading)
      : FolderDataset(std::vector<std::string>{root.string()}, reading) {}
  FolderDataset(const std::vector<std::string>& roots, const SceneReading& reading);
  int64_t size() const override { return static_cast<int64_t>(locations_.size()); }
  std::string scene_name(int64_t index) const override;
  Scene scene(int64_t index) const override;

 private:
  SceneReading reading_;
  std::vector<SceneLocation> locations_;
  mutable std::mutex mutex_;
  mutable std::vector<std::shared_ptr<const Scene>> scenes_;
  mutable std::deque<size_t> kept_;  // indices into scenes_, the oldest first
};

}  // namespace gld
