#pragma once

// This makes novel views for other programs: it is the sampler of gld as a library. CMake takes it by
// find_package(gld), target gld::gld. It prints nothing, installs no signal handler, and its pictures are those of `gld
// sample` to the byte. A process may make one call at a time: the number of threads belongs to all of it.

#include <array>
#include <cstdint>
#include <functional>
#include <limits>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#if defined(__GNUC__)
#define GLD_SAMPLER_API __attribute__((visibility("default")))
#else
#define GLD_SAMPLER_API
#endif

namespace gld::sampler {

// What is wrong with a request, a model or a file, in one sentence: what was expected, what was found, what to do.
class GLD_SAMPLER_API SamplerError : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// Pixels are red, green, blue, row by row.
struct Picture {
  int64_t width = 0, height = 0;
  std::vector<uint8_t> rgb;
};

// A pinhole camera as OpenCV has it: x right, y down, z forward, and pixel (0, 0) has its centre at (0.5, 0.5).
struct PinholeCamera {
  int64_t width = 0, height = 0;                                // pixels
  double focal_x = 0, focal_y = 0, centre_x = 0, centre_y = 0;  // pixels
  // A rotation and a place, 4 x 4, row by row.
  std::array<double, 16> world_from_camera = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
};

// A photograph whose camera is known; both have one size.
struct SourceView {
  Picture picture;
  PinholeCamera camera;
};

struct SampleRequest {
  std::string model;  // a bundle: a folder with model.yaml
  // Either these are photographs without cameras: image files, folders of them, videos. Views are made on a path
  // between them.
  std::vector<std::string> photographs;
  int64_t path_views = 8;  // how many
  // Or these are views with cameras in one world, and the cameras of the views that are wanted.
  std::vector<SourceView> sources;
  std::vector<PinholeCamera> targets;
  int64_t seed = 0;
  int64_t threads = 0;  // 0: one a core
  // Any other option of gld sample by its name in config.yaml, with its value as text: {"solver.evaluations", "8"}.
  std::vector<std::pair<std::string, std::string>> options;
};

struct SampleProgress {
  std::string stage;        // "level 1"
  int64_t step = 0;         // accepted so far; 0 as the stage begins
  int64_t steps = 0;        // of how many; 0 where that is not known
  double time = 1;          // of the flow: 1 is noise, 0 the view
  int64_t evaluations = 0;  // of the model so far
};

struct SampleCallbacks {
  // After each step of a flow. False stops: sample() gives nothing then. May be empty.
  std::function<bool(const SampleProgress&)> progress;
  // Asked before each evaluation of the model, of which a step of some solvers has several, and before each stage; true
  // stops as well. May be empty.
  std::function<bool()> cancelled;
  // It gets after every so many evaluations of a flow the views that it would end with now, without what is kept of the
  // photographs. It takes the decoder's memory beside the flow's. It may be empty.
  std::function<void(const std::string& stage, const std::vector<Picture>& views)> preview;
  int64_t preview_every = 4;
};

struct SampledView {
  std::string name;
  PinholeCamera
      camera;  // of the picture; where cameras were found, in their own unit with the first photograph's in the world's origin
  Picture picture;
  double from_photographs = 0;  // the share of its pixels that photographs show
  // dB of PSNR that can be expected of it at the model's size, by what photographs predict of each other; not a number
  // where they tell none.
  double expected_psnr = std::numeric_limits<double>::quiet_NaN();
};

struct SampleResult {
  std::vector<SampledView> sources;  // as the model saw them
  std::vector<SampledView> views;
  std::string verdict;              // what these pictures are worth, a sentence
  std::vector<std::string> doubts;  // a sentence each
  double seconds = 0;
};

// Samples. Returns nothing where a callback stopped it. Throws SamplerError.
GLD_SAMPLER_API std::optional<SampleResult> sample(const SampleRequest& request,
                                                   const SampleCallbacks& callbacks = {});

// Returns for example "gld 0.1.0".
GLD_SAMPLER_API std::string version();

}  // namespace gld::sampler
