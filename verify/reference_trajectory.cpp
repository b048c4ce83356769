#include "gld/base/error.h"
#include "gld/metrics/trajectory_metrics.h"
#include "verify/reference_runners.h"

#include <vector>

#include <Eigen/Geometry>

namespace gld {
namespace {

struct TrajectoryCaseOptions : OptionsGroup {
  std::string align = "sim3";
  int64_t delta_frames = 1;

  void visit(FieldVisitor& visitor) override {
    visitor.text({"align", "what the estimate is aligned by; sim3 is all there is"}, align);
    visitor.integer({"delta_frames", "frames from one pose of a relative motion to the other"}, delta_frames,
                    {1, 1});
  }
  void check() const override {
    if (align != "sim3") fail({"align", "sim3", align, "leave it as it is"});
  }
};

// Poses are read in double, as evo computes: ReferenceCase::input rounds to float32.
std::vector<Eigen::Isometry3d> poses_of(const ReferenceCase& reference, const std::string& name) {
  const int64_t count = reference.input(name, {-1, 4, 4}).size(0);
  const auto matrices = reference.inputs.at(name).to(torch::kFloat64).contiguous();
  std::vector<Eigen::Isometry3d> poses;
  for (int64_t i = 0; i < count; ++i) {
    Eigen::Isometry3d pose;
    pose.matrix() =
        Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(matrices.data_ptr<double>() + 16 * i);
    poses.push_back(pose);
  }
  return poses;
}

}  // namespace

NamedTensors run_trajectory_case(const ReferenceCase& reference) {
  TrajectoryCaseOptions options;
  reference.read_config(options);
  const TrajectoryErrors errors =
      trajectory_errors(poses_of(reference, "truth"), poses_of(reference, "estimate"));
  if (!errors.degenerate.empty()) {
    fail({reference.folder.string(), "trajectories that a similarity fits", errors.degenerate,
          "write other poses"});
  }
  const auto number = [](double value) { return torch::full({1}, value, torch::kFloat64); };
  return {{"ate_rmse", number(errors.ate)},
          {"rpe_translation_rmse", number(errors.rpe_translation)},
          {"rpe_translation_mean", number(errors.rpe_translation_mean)},
          {"rpe_rotation_deg_rmse", number(errors.rpe_rotation)},
          {"rpe_rotation_deg_mean", number(errors.rpe_rotation_mean)}};
}

}  // namespace gld
