#include "gld/tensors/out_of_memory.h"

#include <cstdint>
#include <functional>

#include <torch/types.h>

#include <gtest/gtest.h>

namespace gld {
namespace {

bool thrown_for_memory(const std::function<void()>& work) {
  try {
    work();
  } catch (const c10::Error& error) {
    return is_out_of_memory(error);
  }
  ADD_FAILURE() << "nothing was thrown";
  return false;
}

TEST(OutOfMemory, IsToldFromOtherFaults) {
  EXPECT_TRUE(thrown_for_memory([] { torch::empty({int64_t{1} << 46}); }));
  EXPECT_FALSE(thrown_for_memory([] { torch::ones({2, 3}) + torch::ones({4}); }));
}

}  // namespace
}  // namespace gld
