#include "gld/tensors/torch_version.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

// Of all that the program links, as this test does: a library that brings a BLAS of its own, as Debian's Ceres names
// ATLAS, would have LibTorch multiply by that one.
TEST(LinkedBlas, IsTheOneThatWasInstalledForLibTorch) {
  EXPECT_THAT(blas_name(), testing::AnyOf("openblas", "mkl", "blis")) << blas_text();
}

}  // namespace
}  // namespace gld
