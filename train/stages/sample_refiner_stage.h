#pragma once

#include "train/objectives/sample_refiner_objective.h"
#include "train/stages/training_stage.h"

#include <string>

namespace gld {

struct TrainSampleRefinerOptions : TrainOptions {
  SampleRefinerObjectiveOptions objective;
  void visit(FieldVisitor& visitor) override;
  void check() const override;
};

// gld train sample-refiner; see run_training_stage.
std::string train_sample_refiner(const TrainSampleRefinerOptions& options, const DrawValidation& draw);

}  // namespace gld
