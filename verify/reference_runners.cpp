#include "verify/reference_runners.h"

namespace gld {

ReferenceRunners reference_runners() {
  return {
      {"backbone", run_backbone_case},
      {"dpt_head", run_dpt_head_case},
      {"camera_head", run_camera_head_case},
      {"camera_decoder", run_camera_decoder_case},
      {"autoencoder", run_autoencoder_case},
      {"rgb_decoder", run_rgb_decoder_case},
      {"lpips", run_lpips_case},
      {"metrics_image_depth", run_metrics_case},
      {"metrics_trajectory", run_trajectory_case},
      {"splat_projection", run_splat_projection_case},
      {"splat_compositing", run_splat_compositing_case},
      {"refiner", run_refiner_case},
      {"camera_conditioning", run_camera_case},
      {"dit", run_dit_case},
      {"sample", run_sample_case},
      {"pipeline", run_pipeline_case},
      {"train_diffusion", run_train_diffusion_case},
  };
}

}  // namespace gld
