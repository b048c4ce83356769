#include "gld/kernels/kernel_table.h"
#include "gld/splatting/compositing.h"
#include "verify/reference_dit.h"
#include "verify/reference_runners.h"

#include <algorithm>
#include <vector>

namespace gld {
namespace {

struct SplatCaseOptions : OptionsGroup {
  int64_t width = 0;   // pixels
  int64_t height = 0;  // pixels
  int64_t degree = 0;  // of the colours' spherical harmonics
  ProjectionOptions projection;

  void visit(FieldVisitor& visitor) override {
    visitor.integer({"height", "image height in pixels"}, height, {1, 1 << 16});
    visitor.integer({"width", "image width in pixels"}, width, {1, 1 << 16});
    visitor.integer({"degree", "degree of the colours' spherical harmonics"}, degree,
                    {0, kMostHarmonicDegree});
    projection.visit(visitor);
  }
};

std::vector<float> numbers_of(const torch::Tensor& tensor) {
  const torch::Tensor values = tensor.to(torch::kFloat32).contiguous();
  return {values.data_ptr<float>(), values.data_ptr<float>() + values.numel()};
}

torch::Tensor tensor_of(const std::vector<float>& values, const std::vector<int64_t>& shape) {
  return torch::tensor(values, torch::kFloat32).reshape(shape).to(torch::kFloat64);
}

GaussianSet case_gaussians(const ReferenceCase& reference, int64_t degree) {
  const torch::Tensor means = reference.input("means", {-1, 3});
  const int64_t count = means.size(0), harmonics = harmonic_coefficients(degree);
  GaussianSet set = zero_gaussians(count, degree);
  set.means = numbers_of(means);
  set.log_scales = numbers_of(reference.input("log_scales", {count, 3}));
  set.rotations = numbers_of(reference.input("rotations", {count, 4}));
  set.logit_opacities = numbers_of(reference.input("logit_opacities", {count}));
  if (reference.inputs.count("harmonics") > 0) {
    const torch::Tensor coefficients = reference.input("harmonics", {count, harmonics, 3});
    set.colours = numbers_of(coefficients.slice(1, 0, 1));
    set.harmonics = numbers_of(coefficients.slice(1, 1));
  }
  check_gaussians(set, (reference.folder / "inputs.safetensors").string());
  return set;
}

std::vector<SplatCamera> case_cameras(const ReferenceCase& reference, const SplatCaseOptions& options) {
  const int64_t views = reference.input("camera_to_world", {-1, 4, 4}).size(0);
  std::vector<SplatCamera> cameras;
  for (const Camera& camera :
       reference_views(reference, {views, views, options.width, options.height}).cameras)
    cameras.push_back(splat_camera(camera, Eigen::Vector3d::Zero(), options.projection));
  return cameras;
}

// Gradients of shapes as tensors under the names of the outputs.
struct ShapeGradients {
  torch::Tensor means, log_scales, rotations, logit_opacities;

  explicit ShapeGradients(int64_t count)
      : means(torch::zeros({count, 3}, torch::kFloat64)),
        log_scales(torch::zeros({count, 3}, torch::kFloat64)),
        rotations(torch::zeros({count, 4}, torch::kFloat64)),
        logit_opacities(torch::zeros({count}, torch::kFloat64)) {}

  void add(int64_t i, const GaussianShape& gradient) {
    for (int k = 0; k < 3; ++k) {
      means.data_ptr<double>()[3 * i + k] += gradient.mean[k];
      log_scales.data_ptr<double>()[3 * i + k] += gradient.log_scale[k];
    }
    for (int k = 0; k < 4; ++k) rotations.data_ptr<double>()[4 * i + k] += gradient.rotation[k];
    logit_opacities.data_ptr<double>()[i] += gradient.logit_opacity;
  }
  void name(NamedTensors& outputs) const {
    outputs["gradient.means"] = means;
    outputs["gradient.log_scales"] = log_scales;
    outputs["gradient.rotations"] = rotations;
    outputs["gradient.logit_opacities"] = logit_opacities;
  }
};

// The gradient goes through conic = (Q_xx, Q_xy, Q_yy) with Q = S2^-1: dS2 = -Q G Q.
ProjectedGradient gradient_of_conic(const Eigen::Matrix2d& q, const double* of_conic) {
  Eigen::Matrix2d g;
  g << of_conic[0], of_conic[1] / 2, of_conic[1] / 2, of_conic[2];
  const Eigen::Matrix2d of_covariance = -q * g * q;
  ProjectedGradient gradient;
  gradient.covariance[0] = of_covariance(0, 0);
  gradient.covariance[1] = of_covariance(0, 1);
  gradient.covariance[2] = of_covariance(1, 1);
  return gradient;
}

void project_case(const ReferenceCase& reference, const GaussianSet& set,
                  const std::vector<SplatCamera>& cameras, NamedTensors& outputs) {
  const auto views = static_cast<int64_t>(cameras.size()), count = set.size();
  const auto seeds = [&](const char* name, const std::vector<int64_t>& shape) {
    return reference.input(name, shape).to(torch::kFloat64).contiguous();
  };
  const torch::Tensor of_places = seeds("of_places", {views, count, 2}),
                      of_conics = seeds("of_conics", {views, count, 3}),
                      of_opacities = seeds("of_opacities", {views, count});
  torch::Tensor places = torch::zeros_like(of_places), conics = torch::zeros_like(of_conics),
                opacities = torch::zeros_like(of_opacities), seen = torch::zeros_like(of_opacities),
                depths = torch::zeros_like(of_opacities);
  ShapeGradients gradients(count);
  for (int64_t row = 0; row < views * count; ++row) {
    const SplatCamera& camera = cameras[static_cast<size_t>(row / count)];
    const GaussianShape shape = gaussian_shape(set, row % count);
    ProjectedGaussian projected;
    if (!project_gaussian(shape, camera, projected)) continue;
    Eigen::Matrix2d q;
    q << projected.covariance[2], -projected.covariance[1], -projected.covariance[1], projected.covariance[0];
    q /= projected.determinant;
    seen.data_ptr<double>()[row] = 1;
    depths.data_ptr<double>()[row] = projected.x_in_camera[2];
    opacities.data_ptr<double>()[row] = projected.opacity;
    for (int k = 0; k < 2; ++k) places.data_ptr<double>()[2 * row + k] = projected.mean[k];
    double* const conic = conics.data_ptr<double>() + 3 * row;
    conic[0] = q(0, 0);
    conic[1] = q(0, 1);
    conic[2] = q(1, 1);
    ProjectedGradient of_projected = gradient_of_conic(q, of_conics.data_ptr<double>() + 3 * row);
    for (int k = 0; k < 2; ++k) of_projected.mean[k] = of_places.data_ptr<double>()[2 * row + k];
    of_projected.log_opacity = of_opacities.data_ptr<double>()[row] * projected.opacity;
    GaussianShape gradient;
    project_gaussian_backward(shape, camera, projected, of_projected, gradient);
    gradients.add(row % count, gradient);
  }
  outputs["seen"] = seen;
  outputs["depths"] = depths;
  outputs["places"] = places;
  outputs["conics"] = conics;
  outputs["opacities"] = opacities;
  gradients.name(outputs);
}

torch::Tensor all_harmonics(const GaussianSet& set) {
  const int64_t count = set.size();
  return torch::cat({tensor_of(set.colours, {count, 1, 3}),
                     tensor_of(set.harmonics, {count, harmonic_coefficients(set.degree) - 1, 3})},
                    1);
}

void colour_case(const ReferenceCase& reference, const GaussianSet& set,
                 const std::vector<SplatCamera>& cameras, NamedTensors& outputs) {
  const auto views = static_cast<int64_t>(cameras.size()), count = set.size();
  const torch::Tensor of_colours =
      reference.input("of_colours", {views, count, 3}).to(torch::kFloat64).contiguous();
  torch::Tensor colours = torch::zeros_like(of_colours);
  GaussianSet gradients = zero_gaussians(count, set.degree);
  ShapeGradients of_shapes(count);
  for (int64_t row = 0; row < views * count; ++row) {
    const int64_t i = row % count;
    SeenColour colour;
    seen_colour(set, i, gaussian_shape(set, i).mean + cameras[static_cast<size_t>(row / count)].offset,
                colour);
    for (int k = 0; k < 3; ++k) colours.data_ptr<double>()[3 * row + k] = colour.rgb[k];
    GaussianShape gradient;
    gradient.mean = seen_colour_backward(set, i, colour, of_colours.data_ptr<double>() + 3 * row, gradients);
    of_shapes.add(i, gradient);
  }
  outputs["colours"] = colours;
  outputs["gradient.harmonics"] = all_harmonics(gradients);
  outputs["gradient_through_colours.means"] = of_shapes.means;
}

SplatImage image_of_tensor(const torch::Tensor& planes) {
  SplatImage image(planes.size(0), planes.size(2), planes.size(1));
  const torch::Tensor values = planes.to(torch::kFloat32).contiguous();
  for (int64_t row = 0; row < image.channels * image.height; ++row) {
    const float* from = values.data_ptr<float>() + row * image.width;
    std::copy(from, from + image.width, image.row(row / image.height, row % image.height));
  }
  return image;
}

torch::Tensor tensor_of_image(const SplatImage& image) {
  return tensor_of(image.values, {image.channels, image.height, image.stride})
      .slice(2, 0, image.width)
      .contiguous();
}

}  // namespace

NamedTensors run_splat_projection_case(const ReferenceCase& reference) {
  SplatCaseOptions options;
  reference.read_config(options);
  const GaussianSet set = case_gaussians(reference, options.degree);
  const std::vector<SplatCamera> cameras = case_cameras(reference, options);
  NamedTensors outputs;
  if (reference.expects("places")) project_case(reference, set, cameras, outputs);
  if (reference.expects("colours")) colour_case(reference, set, cameras, outputs);
  return outputs;
}

NamedTensors run_splat_compositing_case(const ReferenceCase& reference) {
  SplatCaseOptions options;
  reference.read_config(options);
  const GaussianSet set = case_gaussians(reference, options.degree);
  const std::vector<SplatCamera> cameras = case_cameras(reference, options);
  const auto views = static_cast<int64_t>(cameras.size()), count = set.size();
  const bool of_features = reference.inputs.count("features") > 0;
  SplatFeatures features;
  features.channels = 3;
  std::vector<float> values;
  if (of_features) {
    const torch::Tensor given = reference.input("features", {count, -1});
    values = numbers_of(given);
    features.values = values.data();
    features.channels = given.size(1);
    features.by_index = true;
    features.background = numbers_of(reference.input("background", {features.channels}));
  }
  const torch::Tensor of_pictures =
      reference.input("of_pictures", {views, features.channels, options.height, options.width});
  const KernelSettings settings;
  std::vector<torch::Tensor> pictures, transmittances;
  ShapeGradients gradients(count);
  torch::Tensor of_values = torch::zeros({count, features.channels}, torch::kFloat64),
                of_harmonics =
                    torch::zeros({count, harmonic_coefficients(options.degree), 3}, torch::kFloat64);
  for (int64_t number = 0; number < views; ++number) {
    const SplatView view = view_of_splats(set, cameras[static_cast<size_t>(number)], settings);
    const CompositedView composited =
        of_features ? composite(view, features, settings) : render_colours(set, view, settings);
    pictures.push_back(tensor_of_image(composited.image));
    transmittances.push_back(tensor_of_image(composited.transmittance)[0]);
    const SplatImage of_image = image_of_tensor(of_pictures[number]);
    if (!of_features) {
      ColourGradients found;
      render_colours_backward(set, view, view_colours(set, view, settings), of_image,
                              SplatGradients::kFeaturesAndShapes, settings, found);
      for (int64_t i = 0; i < count; ++i) gradients.add(i, gaussian_shape(found.of_set, i));
      of_harmonics += all_harmonics(found.of_set);
      continue;
    }
    const CompositingGradients found =
        composite_backward(view, features, of_image, SplatGradients::kFeaturesAndShapes, settings);
    for (int64_t k = 0; k < view.size(); ++k) {
      const VisibleSplat& splat = view.splats[static_cast<size_t>(k)];
      const GaussianShape shape = gaussian_shape(set, splat.index);
      ProjectedGaussian projected;
      project_gaussian(shape, view.camera, projected);
      GaussianShape gradient;
      project_gaussian_backward(shape, view.camera, projected,
                                projected_gradient(splat, found.moments.data() + kSplatMoments * k),
                                gradient);
      gradients.add(splat.index, gradient);
      for (int64_t c = 0; c < features.channels; ++c)
        of_values.data_ptr<double>()[splat.index * features.channels + c] +=
            found.features[static_cast<size_t>(k * features.channels + c)];
    }
  }
  NamedTensors outputs{{"pictures", torch::stack(pictures)},
                       {"transmittances", torch::stack(transmittances)}};
  gradients.name(outputs);
  if (of_features) outputs["gradient.features"] = of_values;
  if (!of_features) outputs["gradient.harmonics"] = of_harmonics;
  return outputs;
}

}  // namespace gld
