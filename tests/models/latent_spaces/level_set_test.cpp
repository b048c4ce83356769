#include "models/latent_spaces/level_set.h"

#include "tests/support/error_of.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

TEST(LevelGenerator, IsReadAsItIsWritten) {
  for (const auto& generator : {level_model(0), level_model(3), cascade(1, 0), cascade(3, 1)}) {
    EXPECT_EQ(generator_from_text(generator_text(generator), "generated"), generator);
  }
  EXPECT_EQ(generator_text(cascade(2, 0)), "2->0");
  EXPECT_EQ(generator_name(level_model(1)), "level1");
  EXPECT_EQ(generator_name(cascade(1, 0)), "cascade");
  EXPECT_EQ(generator_name(cascade(2, 1)), "cascade_2_to_1");
  EXPECT_EQ(generator_stage(level_model(1)), "M1");
  EXPECT_EQ(generator_stage(cascade(2, 1)), "cascade 2->1");
  for (const char* text : {"", "x", "1-0", "1->", "->0", "-1", "1->0x"}) {
    EXPECT_EQ(error_of([&] { generator_from_text(text, "generated"); }),
              std::string("generated: expected a level such as 1, or a cascade such as 1->0, found '") +
                  text + "'; write generated: [1, 1->0].");
  }
  EXPECT_EQ(
      error_of([] { generator_from_text("0->1", "generated"); }),
      "generated: expected a cascade from a deeper level to a shallower one, found '0->1'; turn it round.");
}

LevelSet set_of(const std::vector<LevelGenerator>& generators, int64_t boundary) {
  LevelSet set;
  set.generators = generators;
  set.boundary = boundary;
  return set;
}

TEST(LevelSet, TheSetsOfThePaperCanBeSampled) {
  EXPECT_NO_THROW(check_level_set(set_of({level_model(1), cascade(1, 0)}, 1)));
  EXPECT_NO_THROW(check_level_set(set_of({level_model(0)}, 0)));
  EXPECT_NO_THROW(check_level_set(set_of({level_model(0), level_model(1)}, 1)));
  EXPECT_NO_THROW(check_level_set(set_of({level_model(0), level_model(1), level_model(2)}, 2)));
  EXPECT_NO_THROW(check_level_set(set_of({level_model(3), cascade(3, 2), cascade(2, 1), cascade(1, 0)}, 3)));
  LevelSet last = set_of({level_model(3)}, 3);
  last.decoded = {3};
  EXPECT_NO_THROW(check_level_set(last));
}

TEST(LevelSet, WhatCannotBeSampledIsRefusedWithTheReason) {
  struct Case {
    LevelSet set;
    const char* sentence;
  };
  LevelSet unknown = set_of({level_model(1), cascade(1, 0)}, 1);
  unknown.decoded = {0, 4};
  LevelSet twice = set_of({level_model(1), cascade(1, 0)}, 1);
  twice.decoded = {1, 1};
  const std::vector<Case> cases = {
      {set_of({level_model(1), cascade(1, 0)}, 2),
       "generated: expected a part that generates boundary_level 2, which propagation starts from, found "
       "none in generated; add 2 to generated or change boundary_level."},
      {set_of({level_model(1)}, 1),
       "generated: expected a part that generates level 0, which the RGB decoder takes, found none, and "
       "propagation from level 1 only makes deeper ones; add 0 or a cascade to it to generated, "
       "or leave it out of decoded_levels."},
      {set_of({level_model(1), level_model(0), cascade(1, 0)}, 1),
       "generated: expected one part that generates level 0, found two, the second is 1->0; leave one of "
       "them out of generated."},
      {set_of({level_model(2), level_model(0), level_model(1)}, 1),
       "generated: expected levels behind boundary_level 1 to come by propagation, found level 2 generated "
       "by 2; raise boundary_level or leave the part out of generated."},
      {set_of({cascade(1, 0), level_model(1)}, 1),
       "generated: expected level 1 generated before the cascade 1->0, found no part that does; put 1 in "
       "front of it in generated."},
      {set_of({level_model(4)}, 4),
       "boundary_level: expected a level below 4, found 4; choose one of the backbone's levels."},
      {unknown, "decoded_levels: expected levels below 4, found 4; choose the backbone's levels."},
      {twice,
       "decoded_levels: expected levels in ascending order, each once, found another order; sort them."},
  };
  for (const auto& entry : cases) {
    EXPECT_EQ(error_of([&] { check_level_set(entry.set); }), entry.sentence);
  }
}

}  // namespace
}  // namespace gld
