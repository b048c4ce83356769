#include "datasets/synthetic/synthetic_renderer.h"

#include "datasets/scenes/frame_checks.h"
#include "datasets/synthetic/ray_tracer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace gld {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kOffset = 1e-4;  // metres; keeps shadow rays off the surface they start from
constexpr int kLampPoints = 16;
constexpr int kSubPixels = 3;  // a side

// Rays through pixel positions; the direction's z in the camera is 1, so that distances are planar depth.
class PixelRays {
 public:
  explicit PixelRays(const Camera& camera)
      : origin_(camera.world_from_camera.translation()), rotation_(camera.world_from_camera.linear()) {
    const Eigen::Matrix3d& k = camera.intrinsics;
    inverse_focal_ = {1 / k(0, 0), 1 / k(1, 1)};
    centre_ = {k(0, 2), k(1, 2)};
  }
  Ray at(double x, double y) const {
    return {origin_, rotation_ * Vector3d((x - centre_.x()) * inverse_focal_.x(),
                                          (y - centre_.y()) * inverse_focal_.y(), 1)};
  }
  double pixel_size() const { return inverse_focal_.x(); }  // at unit depth

 private:
  Vector3d origin_;
  Eigen::Matrix3d rotation_;
  Vector2d inverse_focal_;
  Vector2d centre_;
};

// Returns evenly spread points of the unit disc (a sunflower).
std::array<Vector2d, kLampPoints> disc_points() {
  std::array<Vector2d, kLampPoints> points;
  for (int i = 0; i < kLampPoints; ++i) {
    const double radius = std::sqrt((i + 0.5) / kLampPoints);
    const double angle = 2.399963229728653 * i;
    points[static_cast<size_t>(i)] = {radius * std::cos(angle), radius * std::sin(angle)};
  }
  return points;
}

const Decal* decal_at(const SyntheticWorld& world, const Hit& hit, int& index) {
  if (hit.solid >= 0) return nullptr;
  for (size_t i = 0; i < world.decals.size(); ++i) {
    const Decal& decal = world.decals[i];
    if (decal.face == hit.room_face && hit.u >= decal.low.x() && hit.u <= decal.high.x() &&
        hit.v >= decal.low.y() && hit.v <= decal.high.y()) {
      index = static_cast<int>(i);
      return &decal;
    }
  }
  return nullptr;
}

class Shader {
 public:
  explicit Shader(const RayTracer& tracer) : tracer_(tracer), world_(tracer.world()), disc_(disc_points()) {}

  // Returns which smooth patch a hit lies on; decals count.
  int patch(const Hit& hit) const {
    int index = 0;
    if (decal_at(world_, hit, index) == nullptr) return hit.surface;
    return 6 + 6 * static_cast<int>(world_.solids.size()) + index;
  }

  // Returns the linear RGB seen along the ray.
  Vector3d colour(const Hit& hit, const Ray& ray, double pixel_size) const {
    int index = 0;
    const Decal* decal = decal_at(world_, hit, index);
    if (decal != nullptr && decal->glow > 0) return decal->material.first * decal->glow;
    const double facing = std::abs(hit.normal.dot(ray.direction)) / ray.direction.norm();
    const double footprint = hit.distance * pixel_size / std::max(facing, 0.2);
    const Vector3d surface =
        decal != nullptr ? decal_colour(*decal, hit, footprint) : surface_colour(hit, footprint);
    Vector3d light = world_.ambient * ((0.8 + 0.2 * hit.normal.z()) * openness(hit));
    for (const Lamp& lamp : world_.lamps) light += from_lamp(lamp, hit);
    Vector3d colour = surface.cwiseProduct(light);
    const double gloss = decal == nullptr ? material_of(hit).gloss : 0;
    if (gloss > 0) {
      for (const Lamp& lamp : world_.lamps) colour += gloss * reflection(lamp, hit, ray);
    }
    return colour;
  }

 private:
  Vector3d surface_colour(const Hit& hit, double footprint) const {
    return albedo(material_of(hit), hit.u, hit.v, footprint);
  }

  const Material& material_of(const Hit& hit) const {
    return hit.solid >= 0 ? world_.solids[static_cast<size_t>(hit.solid)].material
                          : world_.room.faces[hit.room_face];
  }

  // Returns a lamp in the polish of a surface (Blinn's half vector): the one thing here that moves with the camera.
  Vector3d reflection(const Lamp& lamp, const Hit& hit, const Ray& ray) const {
    constexpr double kSharpness = 50;
    const Vector3d towards = (lamp.centre - hit.point).normalized();
    if (hit.normal.dot(towards) <= 0) return Vector3d::Zero();
    const double aligned = hit.normal.dot((towards - ray.direction.normalized()).normalized());
    if (aligned < 0.8) return Vector3d::Zero();  // below 2e-5 there
    return lamp.power * (std::pow(aligned, kSharpness) * visible_part(lamp, hit, towards));
  }

  static Vector3d decal_colour(const Decal& decal, const Hit& hit, double footprint) {
    const Vector2d size = decal.high - decal.low;
    return albedo(decal.material, (hit.u - decal.low.x()) / size.x(), (hit.v - decal.low.y()) / size.y(),
                  footprint / size.minCoeff());
  }

  // Returns how much of the surroundings a point sees, roughly: less in corners and next to solids.
  double openness(const Hit& hit) const {
    const Room& room = world_.room;
    const double distances[] = {room.half_x - hit.point.x(),
                                room.half_x + hit.point.x(),
                                room.half_y - hit.point.y(),
                                room.half_y + hit.point.y(),
                                hit.point.z(),
                                room.height - hit.point.z()};
    double open = 1;
    for (int i = 0; i < 6; ++i) {
      if (std::abs(hit.normal[i / 2]) < 0.5) open *= 1 - 0.3 * std::exp(-std::max(distances[i], 0.0) / 0.3);
    }
    for (size_t i = 0; i < world_.solids.size(); ++i) {
      if (static_cast<int>(i) == hit.solid) continue;
      const Vector3d offset = world_.solids[i].centre - hit.point;
      const double distance2 = offset.squaredNorm();
      const double radius = tracer_.solids()[i].radius;
      const double facing = hit.normal.dot(offset);
      if (facing <= 0 || distance2 > 9 * radius * radius) continue;
      const double covered = facing / std::sqrt(distance2) * std::min(radius * radius / distance2, 1.0);
      open *= 1 - 0.5 * covered * (1 - distance2 / (9 * radius * radius));
    }
    return open;
  }

  Vector3d from_lamp(const Lamp& lamp, const Hit& hit) const {
    const Vector3d offset = lamp.centre - hit.point;
    const double distance = offset.norm();
    const double facing = hit.normal.dot(offset) / distance;
    if (facing <= 0) return Vector3d::Zero();
    const double strength = facing / light_loss(distance);
    return lamp.power * (strength * visible_part(lamp, hit, offset / distance));
  }

  double visible_part(const Lamp& lamp, const Hit& hit, const Vector3d& towards) const {
    const Vector3d start = hit.point + kOffset * hit.normal;
    const Vector3d segment = lamp.centre - start;
    ShadowRays shadows(tracer_, start, hit.solid, segment, lamp.radius);
    if (shadows.empty()) return 1;
    const Vector3d side =
        (std::abs(towards.z()) < 0.9 ? Vector3d::UnitZ() : Vector3d::UnitX()).cross(towards).normalized();
    const Vector3d up = towards.cross(side);
    int open = 0;
    for (const Vector2d& point : disc_) {
      const bool blocked = shadows.blocked(segment + lamp.radius * (point.x() * side + point.y() * up));
      open += blocked ? 0 : 1;
    }
    return static_cast<double>(open) / kLampPoints;
  }

  const RayTracer& tracer_;
  const SyntheticWorld& world_;
  std::array<Vector2d, kLampPoints> disc_;
};

// Returns screen values of linear light in steps of 1/4095; light above 0.8 is compressed so that lamps do not clip
// hard.
std::vector<uint8_t> screen_table() {
  std::vector<uint8_t> table(4096 * 2);
  for (size_t i = 0; i < table.size(); ++i) {
    const double light = static_cast<double>(i) / 4095;
    const double compressed = light < 0.8 ? light : 1 - 0.2 * std::exp(-(light - 0.8) / 0.2);
    table[i] = static_cast<uint8_t>(std::lround(255 * std::pow(compressed, 1 / 2.2)));
  }
  return table;
}

void store(const Vector3d& light, uint8_t* pixel) {
  static const std::vector<uint8_t> table = screen_table();
  for (int c = 0; c < 3; ++c) {
    const double index = std::clamp(light[c], 0.0, 1.999) * 4095;
    pixel[c] = table[static_cast<size_t>(std::lround(index))];
  }
}

}  // namespace

Image render_image(const SyntheticWorld& world, const Camera& camera) {
  check_frame_camera(camera, "synthetic camera");
  const PixelRays rays(camera);
  const RayTracer tracer(world);
  const Shader shader(tracer);
  const int64_t width = camera.width;
  const int64_t height = camera.height;
  std::vector<Hit> hits(static_cast<size_t>(width * height));
  std::vector<int> patches(hits.size());
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      const auto i = static_cast<size_t>(y * width + x);
      hits[i] = tracer.first_hit(rays.at(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5));
      patches[i] = shader.patch(hits[i]);
    }
  }
  const auto at_edge = [&](int64_t x, int64_t y) {
    const int patch = patches[static_cast<size_t>(y * width + x)];
    for (int64_t v = std::max<int64_t>(y - 1, 0); v <= std::min(y + 1, height - 1); ++v) {
      for (int64_t u = std::max<int64_t>(x - 1, 0); u <= std::min(x + 1, width - 1); ++u) {
        if (patches[static_cast<size_t>(v * width + u)] != patch) return true;
      }
    }
    return false;
  };
  Image image(width, height);
  for (int64_t y = 0; y < height; ++y) {
    for (int64_t x = 0; x < width; ++x) {
      Vector3d light = Vector3d::Zero();
      if (!at_edge(x, y)) {
        const Ray ray = rays.at(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
        light = shader.colour(hits[static_cast<size_t>(y * width + x)], ray, rays.pixel_size());
      } else {
        for (int sub = 0; sub < kSubPixels * kSubPixels; ++sub) {
          const int row = sub / kSubPixels, column = sub % kSubPixels;
          const double dx = (column + 0.5) / kSubPixels, dy = (row + 0.5) / kSubPixels;
          const Ray ray = rays.at(static_cast<double>(x) + dx, static_cast<double>(y) + dy);
          light += shader.colour(tracer.first_hit(ray), ray, rays.pixel_size() / kSubPixels).cwiseMin(1.2);
        }
        light /= kSubPixels * kSubPixels;
      }
      store(light, image.pixel(x, y));
    }
  }
  return image;
}

DepthMap render_depth(const SyntheticWorld& world, const Camera& camera) {
  check_frame_camera(camera, "synthetic camera");
  const PixelRays rays(camera);
  const RayTracer tracer(world);
  DepthMap depth(camera.width, camera.height);
  for (int64_t y = 0; y < camera.height; ++y) {
    for (int64_t x = 0; x < camera.width; ++x) {
      const Ray ray = rays.at(static_cast<double>(x) + 0.5, static_cast<double>(y) + 0.5);
      depth.at(x, y) = static_cast<float>(tracer.first_hit(ray).distance);
    }
  }
  return depth;
}

}  // namespace gld
