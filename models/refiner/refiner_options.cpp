#include "models/refiner/refiner_options.h"

#include "gld/base/error.h"
#include "models/refiner/one_step_update.h"
#include "models/refiner/view_grid.h"

#include <string>

#include <fmt/format.h>

namespace gld {

void RefinerOptions::visit(FieldVisitor& visitor) {
  visitor.integers({"channels",
                    "channels of the UNet's stages, each but the last halves the sides; none for a model "
                    "without a refiner"},
                   channels, {1, 1 << 14});
  visitor.integers({"heads", "heads of attention in each stage"}, heads, {1, 1024});
  visitor.integer({"attending_stages", "the first so many stages attend over pixels; the middle always does"},
                  attending_stages, {0, 8});
  visitor.integer(
      {"layers_per_block", "residual blocks of a stage on the way down, one less than on the way up"},
      layers_per_block, {1, 16});
  visitor.integer({"norm_groups", "groups of the group norms"}, norm_groups, {1, 1024});
  visitor.integer({"latent_channels", "channels of a latent pixel"}, latent_channels, {1, 1 << 14});
  visitor.integer({"prompt_tokens", "constant tokens in the place of a text"}, prompt_tokens, {1, 1 << 14});
  visitor.integer({"prompt_channels", "channels of such a token"}, prompt_channels, {1, 1 << 14});
  visitor.integer({"timestep", "tau: how noisy the network is told that the latent is, of 1000"}, timestep,
                  {0, kDiffusionSteps - 1});
  visit_choice(
      visitor,
      {"form", "what an evaluation makes of a latent: identity where the network gives 0, or published"},
      form, {"identity", "published"});
  visit_choice(visitor, {"attention", "how views see each other: grid, self or cross"}, attention,
               {"grid", "self", "cross"});
  visit_choice(visitor,
               {"degraded",
                "what is repaired: splatted latents, the colours of splats, encoded, or what flows of few "
                "evaluations generated"},
               degraded, {"splatted", "colours", "generated"});
  visitor.integer({"references", "views beside the degraded one"}, references, {0, 63});
  visit_choice(visitor,
               {"reference_unit",
                "what distances between cameras are measured in: their mean spacing, or the scene's unit"},
               reference_unit, {"spacing", "scene"});
}

void RefinerOptions::check() const {
  if (!exists()) return;
  if (channels.size() < 2 || channels.size() > 8) {
    fail({"channels", "none, or 2 to 8 stages", std::to_string(channels.size()),
          "write for example channels: [64, 96, 128]"});
  }
  if (heads.size() != channels.size()) {
    fail({"heads", fmt::format("{} numbers, one a stage", channels.size()), std::to_string(heads.size()),
          "write for example heads: [2, 3, 4]"});
  }
  for (size_t stage = 0; stage < channels.size(); ++stage) {
    if (channels[stage] % norm_groups != 0) {
      fail({"channels", fmt::format("multiples of norm_groups {}", norm_groups),
            std::to_string(channels[stage]), "change channels or norm_groups"});
    }
    if (channels[stage] % heads[stage] != 0) {
      fail({"heads", fmt::format("numbers that divide the stage's channels {}", channels[stage]),
            std::to_string(heads[stage]), "change heads or channels"});
    }
  }
  if (channels.front() % 2 != 0) {
    fail({"channels", "an even number first, of which half are sines of the timestep",
          std::to_string(channels.front()), "change it"});
  }
  if (attention == ViewAttention::kGrid) view_grid(1 + references);
}

}  // namespace gld
