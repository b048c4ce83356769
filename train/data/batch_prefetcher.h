#pragma once

#include "train/data/training_scene.h"

#include <condition_variable>
#include <cstdint>
#include <exception>
#include <map>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace gld {

// The batches of a training run come from this (of datasets: DatasetBatches). Batch number `index` is always the same
// batch, so a run that resumes only needs the number.
class TrainingBatchSource {
 public:
  virtual ~TrainingBatchSource() = default;
  // Called from several threads.
  virtual TrainingBatch batch(int64_t index) const = 0;
};

struct PrefetchOptions {
  int64_t first = 0;    // index of the first batch
  int64_t threads = 1;  // 0: batches are made when asked for
  int64_t ahead = 4;    // batches kept ready
};

// Takes a source's batches ahead of the step in threads of its own and hands them out in order.
class BatchPrefetcher {
 public:
  BatchPrefetcher(std::shared_ptr<const TrainingBatchSource> source, const PrefetchOptions& options);
  ~BatchPrefetcher();
  BatchPrefetcher(const BatchPrefetcher&) = delete;
  BatchPrefetcher& operator=(const BatchPrefetcher&) = delete;

  // Returns the next batch. Throws what making it threw.
  TrainingBatch next();
  // Returns the seconds that next() has waited since the last call of this function.
  double take_waited_seconds();

 private:
  struct Made {
    TrainingBatch batch;
    std::exception_ptr error;
  };
  void work();

  std::shared_ptr<const TrainingBatchSource> source_;
  PrefetchOptions options_;
  int64_t next_index_;    // handed out next
  int64_t next_to_make_;  // taken by the next idle thread
  double waited_ = 0.0;
  bool stopping_ = false;
  std::map<int64_t, Made> ready_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::vector<std::thread> threads_;
};

}  // namespace gld
