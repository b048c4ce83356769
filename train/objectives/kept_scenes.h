#pragma once

#include "train/data/kept_folder.h"
#include "train/data/training_scene.h"

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace gld {

// Keeps what was made of scenes for the next time they are trained on: in memory for this run, in a folder for others
// too.
class KeptScenes {
 public:
  // gib bounds their memory; past it they are made every time. 0 keeps none.
  explicit KeptScenes(double gib);
  // Keeps them in that folder as well, however many they are; null does not.
  void keep_in(std::shared_ptr<const KeptFolder> folder) { folder_ = std::move(folder); }

  bool enabled() const { return most_bytes_ > 0 || folder_ != nullptr; }
  // Returns what make() gave for that scene and that variant of it: in memory its name and cameras tell it from others,
  // in a folder its pictures, depth and cameras. It may be called from several threads, which may both make it.
  KeptTensors get(const TrainingScene& scene, const std::string& variant,
                  const std::function<KeptTensors()>& make);

 private:
  KeptTensors from_folder(const TrainingScene& scene, const std::string& variant,
                          const std::function<KeptTensors()>& make) const;

  int64_t most_bytes_;
  std::shared_ptr<const KeptFolder> folder_;
  std::mutex mutex_;
  int64_t bytes_ = 0;
  std::map<std::string, KeptTensors> kept_;
};

}  // namespace gld
