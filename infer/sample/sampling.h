#pragma once

#include "gld/report/report_text.h"
#include "infer/method/sample_options.h"
#include "infer/sample/planned_sampling.h"

namespace gld {

// gld plan says which stages would run for this scene and why, with predicted work, time and memory. It computes and
// writes nothing; options.out is not used.
ReportText sampling_plan_report(const SampleOptions& options, PlanTiming timing);

// gld sample reads the bundle and the scene, runs the pipeline and writes the run folder (docs/FILES.md). It prints the
// plan's first lines, warnings and the closing box.
void sample(const SampleOptions& options);

}  // namespace gld
