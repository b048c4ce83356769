#pragma once

#include "datasets/images/image.h"
#include "datasets/scenes/resize_crop.h"
#include "datasets/scenes/scene.h"
#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "infer/paths/camera_path.h"
#include "models/scene_geometry/photograph_depth.h"

#include <cstdint>
#include <string>
#include <utility>
#include <vector>

namespace gld {

// A frame of a scene as it is asked for: by number, from 0, or by name.
struct FrameChoice {
  int64_t number = -1;  // -1 until a name is looked up
  std::string name;     // empty where the number was given

  FrameChoice(int64_t chosen) : number(chosen) {}  // NOLINT: a number is a choice
  explicit FrameChoice(std::string chosen) : name(std::move(chosen)) {}
  operator int64_t() const { return number; }  // NOLINT: of a choice that was looked up
  std::string text() const { return name.empty() ? std::to_string(number) : name; }
};

// Which views of a scene are given and which are asked for.
struct ViewSelection : OptionsGroup {
  std::vector<FrameChoice> sources;
  std::vector<FrameChoice> targets;  // their images are only used to compare with
  CameraPathOptions path;            // instead of targets; unused while path.path is empty

  ViewSelection();
  void visit(FieldVisitor& visitor) override;
  void check() const override;    // not both targets and path; no frame twice
  void require_complete() const;  // Error without sources, or with neither targets nor path
};

// The scene as the sampler takes it: source views first, all at one size.
struct SamplingScene {
  std::string name;
  bool metric = false;  // poses and depth are in metres
  ImageSize size;
  Views views;
  std::vector<std::string>
      view_names;  // frame names; for views along a path the name of their picture, "view_05"
  std::vector<Image> source_images;  // one a source view
  // The source views' photographs at a whole multiple of the size where they were taken larger, and the scene's sparse
  // points; empty unless load_source_photographs was called.
  SourcePhotographs photographs;
  std::vector<DepthMap>
      source_depths;  // measured, one a source view; empty unless load_source_depths was called
  // What a model sees of the source views, in the unit of the cameras, where it saw these too: that of one photograph.
  std::optional<SourceDepth> seen_depth;
  std::vector<Image> true_images;  // one a target view; empty where the scene has none
  // The same as large as the photographs of the source views; empty unless load_large_true_images was called.
  std::vector<Image> large_true_images;
  std::vector<DepthMap> true_depths;  // one a target view; empty where the scene has none
  std::vector<Eigen::Vector3d>
      points_in_world;                // sparse points of a reconstruction, where the scene has them
  std::string path_note;              // what an orbit turns about; empty for other targets
  std::vector<std::string> warnings;  // what is unusual about the cameras, one sentence each
};

// Returns the selection with the numbers of all frames. "7" is a number, also where a frame has that name; "007" is a
// name. Throws Error for a name that the scene does not have, and for a frame that is chosen twice under two names.
ViewSelection looked_up(const ViewSelection& selection, const Scene& scene);

// Returns the selected frames and views without their pixels, for which no image file is decoded: images and depths are
// empty. Throws Error as load_sampling_scene does.
SamplingScene sampling_views(const Scene& scene, const ViewSelection& selection, const ImageSize& size);

// Loads the selected frames, resized and centre-cropped to `size` with their intrinsics. Throws Error for frame
// numbers that the scene does not have and for cameras that make no sense (gld/cameras/camera_checks.h).
SamplingScene load_sampling_scene(const Scene& scene, const ViewSelection& selection, const ImageSize& size);

// Loads the measured depth of the source views, an empty map for one that has none.
void load_source_depths(const Scene& scene, const ViewSelection& selection, SamplingScene& sampling);

// Photographs are matched and kept at this unless their own size is asked for: it is the sweep's default.
constexpr int64_t kMatchedPhotographSide = 448;
// Their own size is kept up to this, as far as memory and the time of carrying go along: with --size photographs.
constexpr int64_t kLargestPhotographSide = 2048;
// This asks for it: the model's size is as for "auto", pictures are larger.
constexpr const char* kPhotographSize = "photographs";

// Returns the pixels of the longer side that photographs are kept at, by what --size says.
int64_t largest_photograph_side(const std::string& size);

// Returns how many times as large as the size photographs are kept: whole times, as all source views' frames were
// taken, with a longer side of at most `largest_side` pixels.
int64_t photograph_magnification(const Scene& scene, const ViewSelection& selection, int64_t largest_side,
                                 const ImageSize& size);
// Loads the photographs of the source views as large as all of them were taken, in whole multiples of the size, of
// which the longer side is at most `largest_side` pixels.
void load_source_photographs(const Scene& scene, const ViewSelection& selection, int64_t largest_side,
                             SamplingScene& sampling);

// Loads the target views' images as large as photographs are kept, to stand beside pictures of that size. It is called
// after load_source_photographs.
void load_large_true_images(const Scene& scene, const ViewSelection& selection, SamplingScene& sampling);

// Returns that size for "504x280"; for "auto" and "photographs" it is the trained size whose aspect is nearest to the
// first frame's. Sides must be whole patches. Throws Error otherwise.
ImageSize choose_size(const std::string& text, const Scene& scene,
                      const std::vector<ImageSize>& trained_sizes, int64_t patch_size);

}  // namespace gld
