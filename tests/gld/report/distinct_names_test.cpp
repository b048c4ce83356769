#include "gld/report/distinct_names.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

TEST(DistinctNames, ASecondOneOfTheSameNameIsNumbered) {
  DistinctNames names;
  EXPECT_EQ(names.of("room"), "room");
  EXPECT_EQ(names.of("hall"), "hall");
  EXPECT_EQ(names.of("room"), "room_2");
  EXPECT_EQ(names.of("room"), "room_3");
}

TEST(DistinctNames, AFolderInANameIsNoFolder) {
  DistinctNames names;
  EXPECT_EQ(names.of("left/001"), "left_001");
  EXPECT_EQ(names.of("../left_001"), ".._left_001");
  EXPECT_EQ(names.of("left_001"), "left_001_2");
}

TEST(DistinctNames, ANumberThatIsTakenIsPassedOver) {
  DistinctNames names;
  EXPECT_EQ(names.of("room_2"), "room_2");
  EXPECT_EQ(names.of("room"), "room");
  EXPECT_EQ(names.of("room"), "room_3");
  EXPECT_EQ(names.of("room_2"), "room_2_2");
}

}  // namespace
}  // namespace gld
