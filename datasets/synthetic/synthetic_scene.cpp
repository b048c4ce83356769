#include "datasets/synthetic/synthetic_scene.h"

#include "datasets/synthetic/photographic_look.h"
#include "datasets/synthetic/photographic_world.h"
#include "datasets/synthetic/synthetic_layout.h"
#include "datasets/synthetic/synthetic_renderer.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"

#include <memory>
#include <optional>

#include <fmt/format.h>

namespace gld {

void SyntheticOptions::visit(FieldVisitor& visitor) {
  visit_choice(
      visitor,
      {"rooms",
       "first, varied or photographic: tidy ones, also cluttered, glossy and dark ones and hand-held cameras, "
       "also rough and stained surfaces, yards and the faults of cameras"},
      rooms, {"first", "varied", "photographic"});
  visit_seed(visitor, seed, "the generator (training and held-out scenes use different ones)");
  visitor.integer({"first_scene", "number of the first scene"}, first_scene,
                  {0, 1'000'000'000'000'000});  // no sum with scene_count overflows
  visitor.integer({"scene_count", "number of scenes"}, scene_count, {1, 1'000'000'000});
  visitor.integer({"frames", "frames on each scene's camera path"}, frames, {1, 100'000});
  visitor.integer({"width", "of the images, pixels"}, width, {8, 8192});
  visitor.integer({"height", "of the images, pixels"}, height, {8, 8192});
  visitor.integer({"fewest_objects", "in a room"}, fewest_objects, {0, 30});
  visitor.integer({"most_objects", "in a room"}, most_objects, {0, 30});
  visitor.real({"field_of_view_low", "narrowest lens, degrees across the larger side"}, field_of_view_low,
               {10, 120});
  visitor.real({"field_of_view_high", "widest lens, degrees across the larger side"}, field_of_view_high,
               {10, 120});
}

void SyntheticOptions::check() const {
  if (most_objects < fewest_objects) {
    fail({"most_objects", "at least fewest_objects (" + std::to_string(fewest_objects) + ")",
          std::to_string(most_objects), "raise it"});
  }
  if (field_of_view_high < field_of_view_low) {
    fail({"field_of_view_high", fmt::format("at least field_of_view_low ({})", field_of_view_low),
          fmt::format("{}", field_of_view_high), "raise it"});
  }
}

Scene make_synthetic_scene(const SyntheticOptions& options, int64_t index) {
  const int64_t number = options.first_scene + index;
  SeededRandom world_random({static_cast<uint64_t>(options.seed), static_cast<uint64_t>(number), 1});
  SeededRandom path_random({static_cast<uint64_t>(options.seed), static_cast<uint64_t>(number), 2});
  auto drawn = std::make_shared<SyntheticWorld>(
      draw_world(world_random, {options.fewest_objects, options.most_objects}));
  PathDraw draw;
  if (options.rooms != SyntheticRooms::kFirst) {
    // A stream of its own: the room that is varied is the one of that number in kFirst.
    SeededRandom variety({static_cast<uint64_t>(options.seed), static_cast<uint64_t>(number), 3});
    const double kind = variety.uniform();
    if (kind > 0.5) {
      vary_world(variety, *drawn);
      draw.hand.sway = variety.uniform(0.0, 0.08);
      draw.hand.aim = variety.uniform(0.0, 4.0);
      draw.hand.roll = variety.uniform(0.0, 8.0);
    }
  }
  std::optional<PhotographicLook> look;
  if (options.rooms == SyntheticRooms::kPhotographic) {
    SeededRandom photographic({static_cast<uint64_t>(options.seed), static_cast<uint64_t>(number), 4});
    if (photographic.chance(0.5)) {
      make_photographic(photographic, *drawn);
      look = draw_photographic_look(photographic);
    }
  }
  const std::shared_ptr<const SyntheticWorld> world = drawn;
  draw.frames = options.frames;
  draw.width = options.width;
  draw.height = options.height;
  draw.field_of_view_low = options.field_of_view_low;
  draw.field_of_view_high = options.field_of_view_high;

  Scene scene;
  scene.name = fmt::format("synthetic_{}_{:06}", options.seed, number);
  scene.format = "synthetic";
  scene.metric = true;
  for (const Camera& camera : draw_camera_path(path_random, *world, draw)) {
    Frame frame;
    frame.name = fmt::format("frame_{:05}", scene.frames.size());
    frame.camera = camera;
    const auto number_of_frame = static_cast<int64_t>(scene.frames.size());
    frame.load_image = [world, camera, look, number_of_frame] {
      const Image seen = render_image(*world, camera);
      return look ? photographed(seen, *look, number_of_frame) : seen;
    };
    frame.load_depth = [world, camera] { return render_depth(*world, camera); };
    scene.frames.push_back(std::move(frame));
  }
  return scene;
}

SyntheticDataset::SyntheticDataset(const SyntheticOptions& options) : options_(options) { options_.check(); }

std::string SyntheticDataset::scene_name(int64_t index) const {
  return fmt::format("synthetic_{}_{:06}", options_.seed, options_.first_scene + index);
}

Scene SyntheticDataset::scene(int64_t index) const { return make_synthetic_scene(options_, index); }

}  // namespace gld
