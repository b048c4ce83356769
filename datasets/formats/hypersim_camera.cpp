#include "datasets/formats/hypersim_camera.h"

#include "datasets/formats/file_listing.h"
#include "datasets/formats/text_fields.h"
#include "datasets/images/decoded_pixels.h"
#include "gld/base/error.h"

#include <cmath>
#include <map>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace gld {
namespace {

constexpr double kPi = 3.14159265358979323846;
constexpr double kVisibleSkew = 0.05;  // pixels

// Returns the row of a table whose first column is key, by column name; empty when there is none.
std::map<std::string, std::string> table_row(const std::filesystem::path& file, const std::string& key) {
  const auto lines = read_lines(file);
  if (lines.empty()) return {};
  const auto names = comma_separated(lines.begin()->text);
  for (const TextLine& line : lines) {
    const auto fields = comma_separated(line.text);
    if (fields.front() != key) continue;
    if (fields.size() != names.size()) {
      fail({line.where, std::to_string(names.size()) + " columns", std::to_string(fields.size()),
            "correct the file"});
    }
    std::map<std::string, std::string> row;
    for (size_t i = 0; i < names.size(); ++i) row[names[i]] = fields[i];
    return row;
  }
  return {};
}

std::map<std::string, std::string> camera_parameters(const std::filesystem::path& scene) {
  const std::string name = folder_name(scene);
  auto folder = std::filesystem::absolute(scene).lexically_normal();
  for (int level = 0; level < 4; ++level) {
    const auto file = folder / "metadata_camera_parameters.csv";
    if (is_file(file)) return table_row(file, name);
    folder = folder.parent_path();
  }
  return {};
}

double scene_scale(const std::filesystem::path& scene) {
  const auto file = scene / "_detail" / "metadata_scene.csv";
  if (!is_file(file)) return 0;
  for (const TextLine& line : read_lines(file)) {
    const auto fields = comma_separated(line.text);
    if (fields.size() == 2 && fields[0] == "meters_per_asset_unit") {
      const auto values = blank_separated(fields[1]);
      if (values.size() == 1) return parse_number(values[0], line.where);
    }
  }
  return 0;
}

DepthMap distances_to_depth(const DepthMap& distance, const Eigen::Matrix3d& ray_from_pixel) {
  DepthMap depth(distance.width, distance.height);
  for (int64_t y = 0; y < depth.height; ++y) {
    for (int64_t x = 0; x < depth.width; ++x) {
      const Eigen::Vector3d ray =
          ray_from_pixel * Eigen::Vector3d(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5, 1);
      depth.at(x, y) = static_cast<float>(distance.at(x, y) * ray.z() / ray.norm());
    }
  }
  return depth;
}

}  // namespace

HypersimSettings read_hypersim_settings(const std::filesystem::path& scene) {
  HypersimSettings settings;
  const auto row = camera_parameters(scene);
  const std::string where = scene.string() + " metadata_camera_parameters.csv";
  const auto number = [&](const std::string& column) {
    const auto found = row.find(column);
    if (found == row.end()) fail({where, "the column " + column, "none", "download the table again"});
    return parse_number(found->second, where + " " + column);
  };
  if (!row.empty()) {
    const auto side = [&](const std::string& column) {
      const double value = number(column);
      if (!(value >= 2 && value <= kLargestSide)) {
        fail({where + " " + column, "2 to " + std::to_string(kLargestSide) + " pixels", row.at(column),
              "download the table again"});
      }
      return static_cast<int64_t>(value);
    };
    settings.width = side("settings_output_img_width");
    settings.height = side("settings_output_img_height");
    check_picture_size(settings.width, settings.height, where);
    settings.metres_per_asset_unit = number("settings_units_info_meters_scale");
    for (int i = 0; i < 9; ++i) {
      const std::string column = "M_cam_from_uv_" + std::to_string(i / 3) + std::to_string(i % 3);
      settings.camera_from_uv(i / 3, i % 3) = number(column);
    }
  } else {
    const double half = std::tan(kPi / 6);
    settings.camera_from_uv =
        Eigen::Vector3d(half,
                        half * static_cast<double>(settings.height) / static_cast<double>(settings.width), -1)
            .asDiagonal();
  }
  const double own_scale = scene_scale(scene);
  if (own_scale != 0) settings.metres_per_asset_unit = own_scale;
  if (!(settings.metres_per_asset_unit > 0) || !std::isfinite(settings.metres_per_asset_unit)) {
    fail({scene.string(), "the scene's scale in _detail/metadata_scene.csv or metadata_camera_parameters.csv",
          "none", "download one of these files"});
  }
  return settings;
}

HypersimLens::HypersimLens(const HypersimSettings& settings, const std::string& where) {
  const auto width = static_cast<double>(settings.width);
  const auto height = static_cast<double>(settings.height);
  if (!settings.camera_from_uv.allFinite() || std::abs(settings.camera_from_uv.determinant()) < 1e-9) {
    fail({where, "a camera matrix that can be inverted", "a singular one", "check the camera parameters"});
  }
  Eigen::Matrix3d pixel_from_uv;
  pixel_from_uv << 0.5 * width, 0, 0.5 * width,  //
      0, -0.5 * height, 0.5 * height,            //
      0, 0, 1;
  const Eigen::Matrix3d opengl_from_opencv = Eigen::Vector3d(1, -1, -1).asDiagonal();
  Eigen::Matrix3d projection = pixel_from_uv * settings.camera_from_uv.inverse() * opengl_from_opencv;
  if (projection.determinant() < 0) projection *= -1;

  // With K upper triangular, projection = K R gives projection projection^T = K K^T, a Cholesky factorisation from the
  // bottom right.
  const Eigen::Matrix3d reversed = (projection * projection.transpose()).reverse();
  const Eigen::LLT<Eigen::Matrix3d> factor(reversed);
  const Eigen::Matrix3d lower = factor.matrixL();
  Eigen::Matrix3d k = lower.reverse();
  stored_from_camera_ = (k.inverse() * projection).transpose();
  k /= k(2, 2);
  pixel_from_ray_ = k;
  skew_ = k(0, 1) / k(1, 1) * height;
  camera_.width = settings.width;
  camera_.height = settings.height;
  camera_.intrinsics = k;
  // The skew is taken out about the middle row, so that pixels move least.
  camera_.intrinsics(0, 1) = 0;
  camera_.intrinsics(0, 2) += k(0, 1) / k(1, 1) * (0.5 * height - k(1, 2));
  if (std::abs(skew_) > kVisibleSkew) {
    const Eigen::Matrix3d stored_pixel = pixel_from_ray_ * camera_.intrinsics.inverse();
    undistorter_ =
        std::make_shared<const Undistorter>(Undistorter::Size{settings.width, settings.height},
                                            Undistorter::Size{settings.width, settings.height},
                                            [stored_pixel](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
                                              return (stored_pixel * pixel.homogeneous()).hnormalized();
                                            });
  }
}

Image HypersimLens::image(const Image& stored) const {
  return undistorter_ ? undistorter_->image(stored) : stored;
}

DepthMap HypersimLens::planar_depth(const DepthMap& distance) const {
  if (distance.width != camera_.width || distance.height != camera_.height) {
    fail({"HyperSim depth",
          "a depth map of " + std::to_string(camera_.width) + "x" + std::to_string(camera_.height),
          std::to_string(distance.width) + "x" + std::to_string(distance.height),
          "check that depth and camera parameters belong together"});
  }
  const DepthMap planar = distances_to_depth(distance, pixel_from_ray_.inverse());
  return undistorter_ ? undistorter_->depth(planar) : planar;
}

}  // namespace gld
