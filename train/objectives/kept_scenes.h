#pragma once

#include "train/data/training_scene.h"

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace gld {

// Keeps what was made of scenes for the next time they are trained on.
class KeptScenes {
 public:
  struct Made {
    std::shared_ptr<const void> value;
    int64_t bytes = 0;
  };

  // gib bounds their memory; past it they are made every time. 0 keeps none.
  explicit KeptScenes(double gib);

  bool enabled() const { return most_bytes_ > 0; }
  // Returns what make() gave for that scene (its name and cameras tell) and that variant of it. It may be called from
  // several threads, which may both make it.
  std::shared_ptr<const void> get(const TrainingScene& scene, const std::string& variant,
                                  const std::function<Made()>& make);

 private:
  int64_t most_bytes_;
  std::mutex mutex_;
  int64_t bytes_ = 0;
  std::map<std::string, std::shared_ptr<const void>> kept_;
};

}  // namespace gld
