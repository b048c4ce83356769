#pragma once

#include "train/objectives/refiner_objective.h"
#include "train/objectives/splat_pairs.h"
#include "train/stages/training_stage.h"

#include <string>

namespace gld {

struct TrainRefinerOptions : StageOptions {
  SplatPairOptions data;
  RefinerObjectiveOptions objective;

  TrainRefinerOptions();
  void visit(FieldVisitor& visitor) override;
  void check() const override;

 protected:
  void visit_data(FieldVisitor& visitor) override;
};

// gld train refiner; see run_training_stage.
std::string train_refiner(const TrainRefinerOptions& options, const DrawValidation& draw);

}  // namespace gld
