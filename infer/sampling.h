#pragma once

#include "infer/sample_options.h"

namespace gld {

// gld sample: reads the bundle and the scene, runs the pipeline and writes the run folder (docs/FILES.md). Prints the
// plan's first lines, warnings and the closing box.
void sample(const SampleOptions& options);

}  // namespace gld
