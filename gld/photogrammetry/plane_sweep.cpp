#include "gld/photogrammetry/plane_sweep.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace gld {
namespace {

// (columns, lines, 1) of the reference, counted from pixel middles, on a plane of inverse depth w before it lie at
// (turned + w moved e_z^T) of it in the photograph's texels.
struct PlaneWarp {
  Eigen::Matrix3d turned;
  Eigen::Vector3d moved;

  PlaneWarp(const Camera& reference, const Camera& photograph) {
    const Eigen::Isometry3d relative = photograph.camera_from_world() * reference.world_from_camera;
    // The middle of pixel 0 is at 0.5 of the camera's pixels, and texel 0 is the border before pixel 0.
    Eigen::Matrix3d to_texels = Eigen::Matrix3d::Identity();
    to_texels(0, 2) = to_texels(1, 2) = 0.5;
    Eigen::Matrix3d from_middles = Eigen::Matrix3d::Identity();
    from_middles(0, 2) = from_middles(1, 2) = 0.5;
    turned =
        to_texels * photograph.intrinsics * relative.linear() * reference.intrinsics.inverse() * from_middles;
    moved = to_texels * photograph.intrinsics * relative.translation();
  }
};

// What is kept of one photograph while windows move down the rows of one plane.
struct MovingWindows {
  int64_t width;
  int64_t rows;  // kept: those of a window and the one that leaves it
  std::vector<float> brightness, seen, sums;

  MovingWindows(int64_t row_width, int64_t radius)
      : width(row_width),
        rows(2 * radius + 2),
        brightness(static_cast<size_t>(rows * width)),
        seen(brightness.size()),
        sums(static_cast<size_t>(3 * (width + 2 * kWindowPadding))) {}

  size_t slot(int64_t row) const { return static_cast<size_t>((row % rows) * width); }
};

// Turns (planes, width) into (width, stride), with 255 behind the planes.
void put_planes_behind_each_other(CostVolume& volume, int64_t row, std::vector<uint8_t>& scratch) {
  constexpr int64_t kBlock = 16;
  uint8_t* const to = volume.at(0, row);
  const auto width = volume.width, stride = volume.stride;
  std::memcpy(scratch.data(), to, static_cast<size_t>(volume.planes * width));
  std::memset(scratch.data() + volume.planes * width, 255,
              static_cast<size_t>((stride - volume.planes) * width));
  for (int64_t first = 0; first < width; first += kBlock) {
    const int64_t end = std::min(first + kBlock, width);
    for (int64_t plane = 0; plane < stride; plane += kBlock) {
      for (int64_t x = first; x < end; ++x) {
        const uint8_t* from = scratch.data() + plane * width + x;
        uint8_t* cell = to + x * stride + plane;
        for (int64_t i = 0; i < kBlock; ++i) cell[i] = from[i * width];
      }
    }
  }
}

}  // namespace

CostVolume::CostVolume(int64_t volume_width, int64_t volume_height, int64_t volume_planes)
    : width(volume_width),
      height(volume_height),
      planes(volume_planes),
      stride((volume_planes + kPlaneGroup - 1) / kPlaneGroup * kPlaneGroup),
      costs(new uint8_t[static_cast<size_t>(width * height * stride)]) {}

ReferenceWindows::ReferenceWindows(const StereoPicture& picture, int64_t window_radius)
    : radius(window_radius) {
  const int64_t width = picture.width, height = picture.height;
  const auto shares = [&](int64_t side) {
    std::vector<float> result;
    for (int64_t i = 0; i < side; ++i) {
      result.push_back(
          1 / static_cast<float>(std::min(i + radius, side - 1) - std::max<int64_t>(i - radius, 0) + 1));
    }
    return result;
  };
  share_of_columns = shares(width);
  share_of_rows = shares(height);
  const auto pixels = static_cast<size_t>(width * height);
  mean.resize(pixels);
  inverse_deviation.resize(pixels);
  std::vector<double> sums(static_cast<size_t>(width)), squares(static_cast<size_t>(width));
  for (int64_t y = 0; y < height; ++y) {
    std::fill(sums.begin(), sums.end(), 0.0);
    std::fill(squares.begin(), squares.end(), 0.0);
    for (int64_t row = std::max<int64_t>(y - radius, 0); row <= std::min(y + radius, height - 1); ++row) {
      for (int64_t x = 0; x < width; ++x) {
        const double value = picture.brightness[static_cast<size_t>(row * width + x)];
        sums[static_cast<size_t>(x)] += value;
        squares[static_cast<size_t>(x)] += value * value;
      }
    }
    for (int64_t x = 0; x < width; ++x) {
      double sum = 0, square = 0;
      for (int64_t at = std::max<int64_t>(x - radius, 0); at <= std::min(x + radius, width - 1); ++at) {
        sum += sums[static_cast<size_t>(at)];
        square += squares[static_cast<size_t>(at)];
      }
      const auto pixel = static_cast<size_t>(y * width + x);
      const double pixels_in = 1 / (static_cast<double>(share_of_columns[static_cast<size_t>(x)]) *
                                    share_of_rows[static_cast<size_t>(y)]);
      mean[pixel] = static_cast<float>(sum / pixels_in);
      const double noise = pixels_in * kBrightnessNoise * kBrightnessNoise;
      const double deviation = std::max(0.0, square - sum * sum / pixels_in) + noise;
      inverse_deviation[pixel] =
          picture.valid[pixel] != 0 ? static_cast<float>(1 / std::sqrt(deviation)) : 0.0F;
    }
  }
}

void sweep_rows(const PlaneSweep& sweep, const KernelTable& kernels, int64_t first_row, int64_t end_row,
                CostVolume& volume) {
  const StereoPicture& reference = *sweep.reference;
  const ReferenceWindows& windows = *sweep.windows;
  const int64_t radius = windows.radius, width = reference.width, height = reference.height;
  const size_t count = sweep.photographs.size();
  std::vector<PlaneWarp> warps;
  std::vector<MovingWindows> moving;
  for (const StereoPicture* photograph : sweep.photographs) {
    warps.emplace_back(reference.camera, photograph->camera);
    moving.emplace_back(width, radius);
  }
  const std::vector<float> zeros(static_cast<size_t>(width), 0.0F);
  std::vector<float> share(static_cast<size_t>(width)), correlations(count * static_cast<size_t>(width));
  const float noise =
      static_cast<float>((2 * radius + 1) * (2 * radius + 1)) * kBrightnessNoise * kBrightnessNoise;
  for (int64_t plane = 0; plane < sweep.planes.count; ++plane) {
    const double inverse_depth = sweep.planes.inverse_depth(static_cast<double>(plane));
    for (MovingWindows& one : moving) std::fill(one.sums.begin(), one.sums.end(), 0.0F);
    for (int64_t entering = std::max<int64_t>(first_row - radius, 0); entering < end_row + radius;
         ++entering) {
      const int64_t leaving = entering - 2 * radius - 1, middle = entering - radius;
      const bool leaves = leaving >= std::max<int64_t>(first_row - radius, 0);
      const bool complete = middle >= first_row;
      if (complete) {
        const float of_rows = windows.share_of_rows[static_cast<size_t>(middle)];
        for (size_t x = 0; x < share.size(); ++x) share[x] = windows.share_of_columns[x] * of_rows;
      }
      PlaneCostRow costs{};
      for (size_t i = 0; i < count; ++i) {
        MovingWindows& one = moving[i];
        const bool enters = entering < height;
        if (enters) {
          const Eigen::Vector3d start =
              warps[i].turned * Eigen::Vector3d(0, static_cast<double>(entering), 1) +
              inverse_depth * warps[i].moved;
          const Eigen::Vector3f first = start.cast<float>(), step = warps[i].turned.col(0).cast<float>();
          WarpedRow warped{};
          warped.from = sweep.photographs[i]->texel_picture();
          warped.first = first.data();
          warped.step = step.data();
          warped.count = width;
          warped.brightness = one.brightness.data() + one.slot(entering);
          warped.seen = one.seen.data() + one.slot(entering);
          kernels.warp_row(warped);
        }
        const auto reference_row = [&](int64_t row) { return reference.brightness.data() + row * width; };
        CorrelatedRow row{};
        row.count = width;
        row.radius = radius;
        row.entering = enters ? one.brightness.data() + one.slot(entering) : zeros.data();
        row.entering_reference = enters ? reference_row(entering) : zeros.data();
        row.leaving = leaves ? one.brightness.data() + one.slot(leaving) : zeros.data();
        row.leaving_reference = leaves ? reference_row(leaving) : zeros.data();
        row.sums = one.sums.data();
        row.noise = noise;
        if (complete) {
          row.share = share.data();
          row.mean = windows.mean.data() + middle * width;
          row.inverse_deviation = windows.inverse_deviation.data() + middle * width;
          row.seen = one.seen.data() + one.slot(middle);
          row.correlation = correlations.data() + i * static_cast<size_t>(width);
          costs.correlations[i] = row.correlation;
        }
        kernels.correlate_row(row);
      }
      if (!complete) continue;
      costs.count = width;
      costs.photographs = static_cast<int64_t>(count);
      costs.cost = volume.at(0, middle) + plane * width;
      kernels.plane_cost_row(costs);
    }
  }
  std::vector<uint8_t> scratch(static_cast<size_t>(width * volume.stride));
  for (int64_t row = first_row; row < end_row; ++row) put_planes_behind_each_other(volume, row, scratch);
}

double sweep_operations(int64_t window_radius) {
  // The terms are the homogeneous place 6, division and two products 3, bilinear 9; moving three sums 9; three sums of
  // a window; correlation 10; ordering and cost 8.
  return 6 + 3 + 9 + 9 + 3 * 2 * static_cast<double>(window_radius) + 10 + 8;
}

double sweep_bytes() {
  // A texel is read, brightness written and read twice, its mask written and read, three sums read and written, the
  // reference read twice with mean and deviation, and the correlation written and read.
  return 8 + 3 * 4 + 2 * 4 + 6 * 4 + 4 * 4 + 2 * 4;
}

}  // namespace gld
