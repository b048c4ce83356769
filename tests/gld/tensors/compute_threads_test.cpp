#include "gld/tensors/compute_threads.h"

#include "gld/base/command_options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(ComputeThreads, MoreThanTheCoresAreAWarning) {
  const int64_t cores = threads_to_use(0);
  EXPECT_THAT(thread_warnings(0), testing::IsEmpty());
  EXPECT_THAT(thread_warnings(cores), testing::IsEmpty());
  EXPECT_THAT(
      thread_warnings(4096),
      testing::ElementsAre(testing::HasSubstr("4096 threads share " + std::to_string(cores) + " core")));
}

}  // namespace
}  // namespace gld
