#include "train/optim/workers.h"

#include <algorithm>
#include <atomic>
#include <exception>
#include <thread>
#include <vector>

namespace gld {

void in_workers(int64_t workers, int64_t count, const std::function<void(int64_t)>& piece) {
  std::vector<std::exception_ptr> errors(static_cast<size_t>(std::max<int64_t>(0, count)));
  std::atomic<int64_t> next{0};
  const auto work = [&] {
    for (int64_t index = next++; index < count; index = next++) {
      try {
        piece(index);
      } catch (...) {
        errors[static_cast<size_t>(index)] = std::current_exception();
      }
    }
  };
  if (workers <= 1) {
    work();
  } else {
    std::vector<std::thread> threads;
    for (int64_t worker = 0; worker < std::min(workers, count); ++worker) threads.emplace_back(work);
    for (std::thread& thread : threads) thread.join();
  }
  for (const std::exception_ptr& error : errors) {
    if (error) std::rethrow_exception(error);
  }
}

}  // namespace gld
