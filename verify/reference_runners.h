#pragma once

#include "verify/reference_case.h"

namespace gld {

// One runner a kind; each stands in a file of its own (verify/reference_<kind>.cpp; the geometry heads of both
// families in one).
NamedTensors run_backbone_case(const ReferenceCase& reference);           // kind "backbone"
NamedTensors run_dpt_head_case(const ReferenceCase& reference);           // kind "dpt_head"
NamedTensors run_camera_head_case(const ReferenceCase& reference);        // kind "camera_head"
NamedTensors run_camera_decoder_case(const ReferenceCase& reference);     // kind "camera_decoder"
NamedTensors run_autoencoder_case(const ReferenceCase& reference);        // kind "autoencoder"
NamedTensors run_rgb_decoder_case(const ReferenceCase& reference);        // kind "rgb_decoder"
NamedTensors run_lpips_case(const ReferenceCase& reference);              // kind "lpips"
NamedTensors run_camera_case(const ReferenceCase& reference);             // kind "camera_conditioning"
NamedTensors run_dit_case(const ReferenceCase& reference);                // kind "dit"
NamedTensors run_sample_case(const ReferenceCase& reference);             // kind "sample"
NamedTensors run_pipeline_case(const ReferenceCase& reference);           // kind "pipeline"
NamedTensors run_metrics_case(const ReferenceCase& reference);            // kind "metrics_image_depth"
NamedTensors run_trajectory_case(const ReferenceCase& reference);         // kind "metrics_trajectory"
NamedTensors run_splat_projection_case(const ReferenceCase& reference);   // kind "splat_projection"
NamedTensors run_splat_compositing_case(const ReferenceCase& reference);  // kind "splat_compositing"
NamedTensors run_refiner_case(const ReferenceCase& reference);            // kind "refiner"
NamedTensors run_train_diffusion_case(const ReferenceCase& reference);    // kind "train_diffusion"

// Returns every kind, by name.
ReferenceRunners reference_runners();

}  // namespace gld
