#pragma once

#include "datasets/check/pose_hypotheses.h"
#include "datasets/formats/scene_reader.h"
#include "datasets/scenes/scene.h"
#include "gld/base/options.h"

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

namespace gld {

struct DataCheckOptions : OptionsGroup {
  SceneReading reading;
  std::string out;  // run folder; empty: only text
  bool overwrite = false;
  bool json = false;
  int64_t most_scenes = 5;  // of a folder of scenes, those that are checked to their pixels
  int64_t most_images = 8;  // decoded to see whether they can be
  int64_t most_pairs = 6;   // of frames compared
  double max_translation_norm = 100;

  DataCheckOptions();
  void visit(FieldVisitor& visitor) override;
};

// How closely a scene is looked at.
enum class CheckDepth {
  kFiles,   // cameras, and header and end of every image file: what a folder of thousands of scenes allows
  kPixels,  // some images are decoded and compared as well
};

struct Span {
  double low = 0;
  double high = 0;
};

struct CheckedFrame {
  std::string name;
  int64_t width = 0, height = 0;  // pixels
};

// What was found in one scene.
struct DataCheck {
  std::string scene;
  std::string format;
  CheckDepth depth_of_check = CheckDepth::kPixels;
  int64_t frames = 0;
  std::vector<CheckedFrame> list;  // in the order of their numbers
  int64_t decoded_images = 0;
  int64_t image_files = 0;  // whose header and end were looked at
  int64_t missing_files = 0;
  int64_t broken_frames = 0;
  int64_t frames_with_depth = 0;
  Span width, height;        // pixels
  Span focal_x, focal_y;     // pixels
  Span field_of_view;        // degrees, across the width
  Span depth;                // of the frames that were loaded; 0 without
  double extent = 0;         // largest distance between a camera and their mean
  double largest_norm = 0;   // largest distance of a camera from the origin
  double median_step = 0;    // between neighbouring frames
  double mean_overlap = -1;  // share of a frame seen by its neighbour; -1 where it cannot be told
  std::string overlap_method;
  int64_t turned_images = 0;  // with an EXIF orientation other than 1
  PoseHypotheses poses;
  std::vector<std::string> problems;  // mistakes, each a sentence with its evidence
  std::vector<std::string> notes;     // what is unusual but not wrong
};

// Looks at a scene that could be read.
DataCheck check_scene(const Scene& scene, const DataCheckOptions& options,
                      CheckDepth depth = CheckDepth::kPixels);

// Opens and checks; a scene that cannot be read is one problem, its sentence.
DataCheck check_scene(const SceneLocation& location, const DataCheckOptions& options,
                      CheckDepth depth = CheckDepth::kPixels);

std::string data_check_text(const DataCheck& check);
nlohmann::ordered_json data_check_json(const DataCheck& check);

// The command: checks every scene at or below path, options.most_scenes of them, evenly spread, to their pixels and the
// others by their files. Prints the checks of the first kind and of scenes with problems, then what was looked at, and
// which scenes have problems as a warning. Where there is a run folder, writes report.json and a picture of the cameras
// of each scene that was checked to its pixels. Exit status 1 when there are problems.
int run_data_check(const std::filesystem::path& path, const DataCheckOptions& options);

}  // namespace gld
