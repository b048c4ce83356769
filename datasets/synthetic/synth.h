#pragma once

#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/options.h"

#include <string>

namespace gld {

struct SynthOptions : OptionsGroup {
  SyntheticOptions scene;
  std::string layout = "cameras-json";
  std::string out;  // run folder
  bool overwrite = false;
  int64_t threads = 0;

  SynthOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// Writes generated scenes under OUT/scenes/NAME in the layout, with report.json. Stops between scenes on Ctrl-C; what
// is written is whole.
void run_synth(const SynthOptions& options);

}  // namespace gld
