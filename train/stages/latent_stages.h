#pragma once

#include "train/objectives/cascade_objective.h"
#include "train/objectives/flow_objective.h"
#include "train/stages/training_stage.h"

#include <cstdint>
#include <string>

namespace gld {

struct TrainLevelOptions : TrainOptions {
  int64_t level = 1;
  FlowObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
};

struct TrainCascadeOptions : TrainOptions {
  CascadeObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
};

struct StatsOptions : OptionsGroup {
  std::string model;
  std::string out;
  std::string device = "cpu";
  int64_t threads = 0;
  int64_t scene_count = 512;
  TrainingDataOptions data;

  StatsOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// gld train level and gld train cascade; see run_training_stage.
std::string train_level(const TrainLevelOptions& options, const DrawValidation& draw);
std::string train_cascade(const TrainCascadeOptions& options, const DrawValidation& draw);

// gld stats: latent statistics of level 0 and of the boundary level over training scenes, all views of a scene encoded
// together. model/ in the run folder is a copy of the bundle with them. Returns the closing box as text.
std::string compute_statistics(const StatsOptions& options);

}  // namespace gld
