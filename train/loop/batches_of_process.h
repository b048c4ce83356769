#pragma once

#include "gld/distributed/process_team.h"
#include "train/data/training_data.h"

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

namespace gld {

// Those of a run's batches that one process computes, in order.
class BatchesOfProcess final : public TrainingBatchSource {
 public:
  BatchesOfProcess(std::shared_ptr<const TrainingBatchSource> all, const ProcessTeam& team, int64_t first,
                   int64_t micro_batches)
      : all_(std::move(all)), first_(first), micro_batches_(micro_batches) {
    for (int64_t micro = 0; micro < micro_batches; ++micro) {
      if (process_of_micro_batch(micro, team.count()) == team.rank()) own_.push_back(micro);
    }
  }
  TrainingBatch batch(int64_t index) const override {
    const auto own = static_cast<int64_t>(own_.size());
    return all_->batch(first_ + index / own * micro_batches_ + own_[static_cast<size_t>(index % own)]);
  }

 private:
  std::shared_ptr<const TrainingBatchSource> all_;
  int64_t first_;
  int64_t micro_batches_;
  std::vector<int64_t> own_;  // micro-batches of a step
};

}  // namespace gld
