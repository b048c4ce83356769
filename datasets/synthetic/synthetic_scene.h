#pragma once

#include "datasets/loading/dataset.h"
#include "datasets/scenes/scene.h"
#include "gld/base/options.h"

#include <cstdint>

namespace gld {

// Which rooms are generated.
enum class SyntheticRooms {
  kFirst,  // the first small model's: tidy, matte, filmed from a smooth path; measurements are made with these
  kVaried,  // half of them as before; in the others more kinds of furniture, glossy and dark things, a hand-held camera
  // Half of them are as kVaried; the others have beside that surfaces, heaps and light such as photographs show, as a
  // camera takes them (exposure, blur, noise, vignetting).
  kPhotographic,
};

// Generated rooms. Scene i of a seed is the same whatever the number of scenes and the compiler; different seeds give
// different scenes.
struct SyntheticOptions : OptionsGroup {
  SyntheticRooms rooms = SyntheticRooms::kFirst;
  int64_t seed = 0;
  int64_t first_scene = 0;
  int64_t scene_count = 1000;
  int64_t frames = 24;
  int64_t width = 112;   // pixels
  int64_t height = 112;  // pixels
  int64_t fewest_objects = 3;
  int64_t most_objects = 8;
  double field_of_view_low = 50;   // degrees
  double field_of_view_high = 75;  // degrees

  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Frames are drawn when their image or depth is asked for. index counts from 0 and is added to first_scene.
Scene make_synthetic_scene(const SyntheticOptions& options, int64_t index);

class SyntheticDataset : public Dataset {
 public:
  explicit SyntheticDataset(const SyntheticOptions& options);
  int64_t size() const override { return options_.scene_count; }
  std::string scene_name(int64_t index) const override;
  Scene scene(int64_t index) const override;

 private:
  SyntheticOptions options_;
};

}  // namespace gld
