#include "gld/tensors/compute_threads.h"

#include "gld/base/command_options.h"
#include "gld/tensors/torch_version.h"

#include <cstdlib>
#include <string>

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

TEST(Blas, TheReportNamesTheKernelAndWhatTheEnvironmentSays) {
  ::setenv("OPENBLAS_L2_SIZE", "4711", 1);
  const std::string text = blas_text();
  ::unsetenv("OPENBLAS_L2_SIZE");
  EXPECT_EQ(text.rfind(blas_name(), 0), 0U);
  if (blas_name() != "openblas") {
    EXPECT_EQ(text, blas_name());
    return;
  }
  // Otherwise scripts/test_openblas_kernels.sh would run one kernel under many names.
  const char* asked = std::getenv("OPENBLAS_CORETYPE");
  EXPECT_NE(text.find(", kernel " + std::string(asked == nullptr ? "" : asked)), std::string::npos) << text;
  EXPECT_NE(text.find(", OPENBLAS_L2_SIZE=4711 in the environment"), std::string::npos) << text;
}

}  // namespace
}  // namespace gld
