#pragma once

#include "gld/base/options.h"
#include "gld/cameras/camera.h"
#include "gld/kernels/kernel_table.h"
#include "gld/splatting/gaussian_set.h"

#include <cstdint>

#include <Eigen/Core>

namespace gld {

// The near plane where none is named, in the scene's extent.
constexpr double kNearShare = 0.01;

struct ProjectionOptions : OptionsGroup {
  double near = 0.01;      // nearest depth that is drawn, in the unit of the poses
  bool antialias = false;  // a Gaussian smaller than a pixel becomes fainter and not brighter (Mip-Splatting)
  double least_alpha = 1.0 / 255;     // from which a Gaussian reaches a pixel
  double least_transmittance = 1e-4;  // a Gaussian that would leave less ends its pixel, and is not in it

  void visit(FieldVisitor& visitor) override;
};

// A camera as Gaussians are projected by it.
struct SplatCamera {
  int64_t width = 0;  // pixels
  int64_t height = 0;
  double focal[2] = {1, 1};
  double principal[2] = {0, 0};
  Eigen::Matrix3d camera_from_world_rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d offset =
      Eigen::Vector3d::Zero();               // the set's origin seen from the camera's centre, in the world
  double low[2] = {0, 0}, high[2] = {0, 0};  // of x/z and y/z, beyond which the Jacobian is held
  double near = 0;
  bool antialias = false;
  double least_alpha = 0;
  float least_alpha_power = 0;  // log2 of it
  float least_transmittance = 0;
  HeldAlphaGradient held_alpha_gradient = HeldAlphaGradient::kNone;  // of what is composited backward
};
// origin is that of the set.
SplatCamera splat_camera(const Camera& camera, const Eigen::Vector3d& origin,
                         const ProjectionOptions& options);

// What is added to the covariance in pixels: about the size of a pixel.
constexpr double kPixelVariance = 0.3;

// The parameters of one Gaussian that its place and shape depend on, or a gradient with respect to them.
struct GaussianShape {
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d log_scale = Eigen::Vector3d::Zero();
  Eigen::Vector4d rotation = Eigen::Vector4d::Zero();  // w, x, y, z
  double logit_opacity = 0;
};
GaussianShape gaussian_shape(const GaussianSet& set, int64_t i);

// A Gaussian in the picture. With d = pixel - mean and S2 = M M^T + kPixelVariance, M = J R_cw R_q diag(s):
// alpha = opacity exp(-d^T S2^-1 d / 2). det S2 is the sum of M's squared 2x2 minors + .3 |M|^2 + .09, in which nothing
// cancels, so that needles keep their digits.
struct ProjectedGaussian {
  Eigen::Vector3d x_in_camera;
  Eigen::Vector3d from_camera;                 // mean - camera's centre, in the world
  Eigen::Vector2d mean;                        // pixels
  Eigen::Matrix<double, 2, 3> projected_axes;  // M
  double covariance[3];                        // S2: xx, xy, yy
  double determinant;                          // of S2
  double plain_determinant;                    // of M M^T
  double opacity;                              // after antialiasing
};
// Returns false where nothing is drawn: before the near plane, fainter than the camera's least alpha, or not finite in
// double.
bool project_gaussian(const GaussianShape& shape, const SplatCamera& camera, ProjectedGaussian& projected);

// d loss / d what project_gaussian gives; covariance holds that of the symmetric matrix, its xy once.
struct ProjectedGradient {
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  double covariance[3] = {0, 0, 0};
  double log_opacity = 0;
  Eigen::Vector3d direction_mean = Eigen::Vector3d::Zero();  // through what depends on the direction of view
};
// Sets gradient. Where x/z or y/z was held, what came through the Jacobian has no gradient to it.
void project_gaussian_backward(const GaussianShape& shape, const SplatCamera& camera,
                               const ProjectedGaussian& projected, const ProjectedGradient& of_projected,
                               GaussianShape& gradient);

// The colour of Gaussian i seen from a camera, max(0, 1/2 + sum of coefficients and harmonics).
struct SeenColour {
  double rgb[3];
  double harmonics[16];
  Eigen::Vector3d direction;  // of length 1, from the camera
  double distance;
};
void seen_colour(const GaussianSet& set, int64_t i, const Eigen::Vector3d& from_camera, SeenColour& colour);
// Adds to the gradients of the coefficients, and returns that of the mean.
Eigen::Vector3d seen_colour_backward(const GaussianSet& set, int64_t i, const SeenColour& colour,
                                     const double of_rgb[3], GaussianSet& gradients);

}  // namespace gld
