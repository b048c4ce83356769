#pragma once

#include "datasets/scenes/seeded_random.h"
#include "datasets/synthetic/synthetic_world.h"

namespace gld {

// Makes a world of draw_world look as places do that people photograph: rough, stained and printed surfaces, posters,
// heaps and bushes of small things, and one in three a yard under the sky with facades around it.
void make_photographic(SeededRandom& random, SyntheticWorld& world);

}  // namespace gld
