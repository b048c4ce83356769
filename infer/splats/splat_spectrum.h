#pragma once

#include "datasets/formats/scene_reader.h"
#include "datasets/splats/scene_fit.h"
#include "gld/splatting/feature_solve.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// gld splat spectrum measures which latent space is the same from everywhere, by what splatting leaves of its
// frequencies.
struct SplatSpectrumOptions : OptionsGroup {
  std::vector<std::string> scenes;
  std::vector<std::string> models{"configs/tiny"};
  std::vector<std::string> levels{"all"};
  std::string out;
  bool overwrite = false;
  int64_t latent_side = 32;
  int64_t side = 256;
  int64_t held_out = 5;
  int64_t seed = 0;
  int64_t threads = 0;
  SceneReading reading;
  SplatFitOptions fit;
  FeatureSolveOptions solve;

  SplatSpectrumOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes rings.csv, spaces.csv, spectrum.md, spectrum.png, spectrum.svg, pictures/ and report.json into options.out.
void run_splat_spectrum(const SplatSpectrumOptions& options);

}  // namespace gld
