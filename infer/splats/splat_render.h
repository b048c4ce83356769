#pragma once

#include "datasets/images/image.h"
#include "gld/base/options.h"
#include "gld/kernels/attention_kernel.h"
#include "gld/splatting/gaussian_set.h"
#include "gld/splatting/projection.h"
#include "infer/paths/camera_path.h"

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

namespace gld {

// The fitted and the held-out views of a run folder.
constexpr const char* kSplatCamerasFile = "cameras.json";

// What pictures of Gaussians show.
enum class SplatShown {
  kColours,
  kLatents,  // features of gld splat fit --features, decoded
  kRefined,  // the same, repaired by the model's refiner before
};

// gld splat render draws Gaussians along a path of gld sample.
struct SplatRenderOptions : OptionsGroup {
  std::string splats;
  std::string cameras;
  std::string out;
  bool overwrite = false;
  int64_t threads = 0;
  SplatShown show = SplatShown::kColours;
  std::string model = "configs/splat";  // of latents
  CameraPathOptions path;
  ProjectionOptions projection;

  SplatRenderOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// What is drawn, as it was read.
struct DrawnSplats {
  const GaussianSet& set;
  ProjectionOptions projection;
  std::filesystem::path file;  // the PLY file
  KernelSettings settings;
};
// This draws a picture of them; it may have another size than the camera, which is then changed to that.
using DrawSplats = std::function<Image(Camera& camera)>;

// Writes images/NAME.png, cameras.json and report.json into options.out. It stops between pictures on Ctrl-C.
// make_drawing is asked for what draws latents, which this part of the program, without LibTorch, does not know
// (latent_render.h).
void run_splat_render(const SplatRenderOptions& options,
                      const std::function<DrawSplats(const DrawnSplats&)>& make_drawing);

// Returns the file of that name in a run folder, or that file as it is.
std::filesystem::path splat_file_in(const std::filesystem::path& place, const std::string& name);

}  // namespace gld
