#include "infer/verify/reference_runners.h"

namespace gld {

ReferenceRunners standard_reference_runners() {
  return {
      {"backbone", run_backbone_case},
      {"dpt_head", run_dpt_head_case},
      {"camera_head", run_camera_head_case},
      {"autoencoder", run_autoencoder_case},
      {"rgb_decoder", run_rgb_decoder_case},
      {"lpips", run_lpips_case},
      {"metrics_image_depth", run_metrics_case},
      {"metrics_trajectory", run_trajectory_case},
      {"camera_conditioning", run_camera_case},
      {"dit", run_dit_case},
      {"sample", run_sample_case},
      {"pipeline", run_pipeline_case},
  };
}

}  // namespace gld
