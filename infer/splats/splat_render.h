#pragma once

#include "gld/base/options.h"
#include "gld/splatting/projection.h"
#include "infer/paths/camera_path.h"

#include <cstdint>
#include <string>

namespace gld {

// gld splat render: Gaussians drawn along a path of gld sample.
struct SplatRenderOptions : OptionsGroup {
  std::string splats;
  std::string cameras;
  std::string out;
  bool overwrite = false;
  int64_t threads = 0;
  CameraPathOptions path;
  ProjectionOptions projection;

  SplatRenderOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes images/NAME.png, cameras.json and report.json into options.out. Stops between pictures on Ctrl-C.
void run_splat_render(const SplatRenderOptions& options);

}  // namespace gld
