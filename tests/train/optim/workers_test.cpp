#include "train/optim/workers.h"

#include <atomic>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(Workers, DoEachPieceOnce) {
  for (const int64_t workers : {0, 1, 3, 20}) {
    std::vector<std::atomic<int>> done(10);
    in_workers(workers, 10, [&](int64_t piece) { ++done[static_cast<size_t>(piece)]; });
    for (const auto& times : done) EXPECT_EQ(times, 1) << workers;
  }
  in_workers(3, 0, [](int64_t) { ADD_FAILURE(); });
}

TEST(Workers, OneWorksInTheCallersThread) {
  std::thread::id one, several;
  in_workers(1, 1, [&](int64_t) { one = std::this_thread::get_id(); });
  in_workers(2, 1, [&](int64_t) { several = std::this_thread::get_id(); });
  EXPECT_EQ(one, std::this_thread::get_id());
  EXPECT_NE(several, std::this_thread::get_id());
}

TEST(Workers, TheFirstErrorIsThrownWhenAllHaveEnded) {
  for (const int64_t workers : {1, 3}) {
    std::atomic<int> done{0};
    try {
      in_workers(workers, 6, [&](int64_t piece) {
        ++done;
        if (piece == 4) throw std::runtime_error("four");
        if (piece == 2) throw std::runtime_error("two");
      });
      ADD_FAILURE();
    } catch (const std::runtime_error& error) {
      EXPECT_STREQ(error.what(), "two");
    }
    EXPECT_EQ(done, 6);
  }
}

}  // namespace
}  // namespace gld
