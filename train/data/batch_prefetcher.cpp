#include "train/data/batch_prefetcher.h"

#include <algorithm>
#include <chrono>

namespace gld {

BatchPrefetcher::BatchPrefetcher(std::shared_ptr<const TrainingBatchSource> source,
                                 const PrefetchOptions& options)
    : source_(std::move(source)),
      options_(options),
      next_index_(options.first),
      next_to_make_(options.first) {
  options_.ahead = std::max<int64_t>(options_.ahead, 1);
  for (int64_t i = 0; i < options_.threads; ++i) threads_.emplace_back([this] { work(); });
}

BatchPrefetcher::~BatchPrefetcher() {
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    stopping_ = true;
  }
  changed_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void BatchPrefetcher::work() {
  for (;;) {
    int64_t index = 0;
    {
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait(lock, [this] { return stopping_ || next_to_make_ < next_index_ + options_.ahead; });
      if (stopping_) return;
      index = next_to_make_++;
    }
    Made made;
    try {
      made.batch = source_->batch(index);
    } catch (...) {
      made.error = std::current_exception();
    }
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      ready_.emplace(index, std::move(made));
    }
    changed_.notify_all();
  }
}

TrainingBatch BatchPrefetcher::next() {
  const auto start = std::chrono::steady_clock::now();
  Made made;
  if (threads_.empty()) {
    made.batch = source_->batch(next_index_++);
  } else {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return ready_.count(next_index_) != 0; });
    const auto found = ready_.find(next_index_);
    made = std::move(found->second);
    ready_.erase(found);
    ++next_index_;
    lock.unlock();
    changed_.notify_all();
  }
  waited_ += std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (made.error) std::rethrow_exception(made.error);
  return std::move(made.batch);
}

double BatchPrefetcher::take_waited_seconds() {
  const double waited = waited_;
  waited_ = 0.0;
  return waited;
}

}  // namespace gld
