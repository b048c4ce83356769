#include "datasets/loading/scene_image_loader.h"

#include "datasets/synthetic/synthetic_scene.h"
#include "gld/base/error.h"
#include "tests/support/error_of.h"

#include <memory>
#include <thread>

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;

std::shared_ptr<SyntheticDataset> small_scenes() {
  SyntheticOptions options;
  options.scene_count = 5;
  options.frames = 10;
  options.width = 40;
  options.height = 30;
  return std::make_shared<SyntheticDataset>(options);
}

MixturePart part_of(std::shared_ptr<const Dataset> dataset, const std::string& name) {
  MixturePart part;
  part.name = name;
  part.dataset = std::move(dataset);
  part.views.views = 3;
  part.views.most_sources = 2;
  part.views.longest_interval = 3;
  return part;
}

// Every second scene fails in its own way.
class PartlyBroken : public Dataset {
 public:
  enum class Fault { kUnreadable, kBrokenImage, kFarAway, kFarApart, kShort };
  explicit PartlyBroken(Fault fault, int64_t period = 2)
      : fault_(fault), period_(period), good_(small_scenes()) {}
  int64_t size() const override { return good_->size(); }
  std::string scene_name(int64_t index) const override { return good_->scene_name(index); }
  Scene scene(int64_t index) const override {
    Scene scene = good_->scene(index);
    if (index % period_ != 0) return scene;
    switch (fault_) {
      case Fault::kUnreadable:
        fail({scene.name, "a readable scene", "a scratched disk", {}});
      case Fault::kBrokenImage:
        for (Frame& frame : scene.frames) {
          frame.load_image = [] { return Image(3, 3); };
        }
        break;
      case Fault::kFarAway:
        scene.frames[4].camera.world_from_camera.translation().x() = 1000;
        break;
      case Fault::kFarApart:  // each within 100 of the origin
        for (size_t i = 0; i < scene.frames.size(); ++i) {
          scene.frames[i].camera.world_from_camera.translation().x() = i % 2 == 0 ? 90 : -90;
        }
        break;
      case Fault::kShort:
        scene.frames.resize(2);
        break;
    }
    return scene;
  }

 private:
  Fault fault_;
  int64_t period_;
  std::shared_ptr<SyntheticDataset> good_;
};

SceneImageLoader loader_of(const std::shared_ptr<const Dataset>& dataset, int64_t seed = 1) {
  BatchLoading options;
  options.batch_size = 3;
  options.seed = seed;
  options.parts = FrameParts::kImageAndDepth;
  std::vector<MixturePart> parts{part_of(dataset, "part")};
  return SceneImageLoader(Mixture(parts), {{{28, 28}, 1}, {{28, 14}, 1}}, options);
}

TEST(SceneImageLoader, BatchesHaveOneSizeAndFollowTheirNumber) {
  const auto dataset = small_scenes();
  const SceneImageLoader loader = loader_of(dataset);
  const SceneImageLoader again = loader_of(dataset);
  const SceneImageLoader other = loader_of(dataset, 2);
  bool sizes_differ = false;
  bool seeds_differ = false;
  for (uint64_t number = 0; number < 6; ++number) {
    const SceneImageBatch batch = loader.load(number);
    const SceneImageBatch same = again.load(number);
    ASSERT_EQ(batch.scenes.size(), 3U);
    EXPECT_EQ(batch.number, number);
    sizes_differ = sizes_differ || batch.size.height != loader.load(0).size.height;
    for (size_t i = 0; i < 3; ++i) {
      const SceneImages& scene = batch.scenes[i];
      ASSERT_EQ(scene.views.size(), 3U);
      EXPECT_GE(scene.num_sources, 1);
      EXPECT_LE(scene.num_sources, 2);
      EXPECT_TRUE(scene.metric);
      EXPECT_EQ(scene.frame_names, same.scenes[i].frame_names);
      EXPECT_EQ(scene.views[1].image.rgb, same.scenes[i].views[1].image.rgb);
      for (const SizedFrame& view : scene.views) {
        EXPECT_EQ(view.image.width, batch.size.width);
        EXPECT_EQ(view.image.height, batch.size.height);
        EXPECT_EQ(view.depth.height, batch.size.height);
        EXPECT_EQ(view.camera.height, batch.size.height);
      }
    }
    seeds_differ = seeds_differ || other.load(number).scenes[0].scene != batch.scenes[0].scene;
  }
  EXPECT_TRUE(sizes_differ);
  EXPECT_TRUE(seeds_differ);
}

TEST(SceneImageLoader, ThreadsDoNotChangeWhatIsLoaded) {
  const SceneImageLoader loader =
      loader_of(std::make_shared<PartlyBroken>(PartlyBroken::Fault::kBrokenImage));
  std::vector<SceneImageBatch> alone;
  for (uint64_t number = 0; number < 6; ++number) alone.push_back(loader.load(number));
  std::vector<SceneImageBatch> together(6);
  std::vector<std::thread> threads;
  for (uint64_t thread = 0; thread < 3; ++thread) {
    threads.emplace_back([&, thread] {
      for (uint64_t number = 5 - thread; number < 6; number -= 3) together[number] = loader.load(number);
    });
  }
  for (std::thread& thread : threads) thread.join();
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(alone[i].scenes[2].frame_names, together[i].scenes[2].frame_names);
    EXPECT_EQ(alone[i].scenes[2].views[0].image.rgb, together[i].scenes[2].views[0].image.rgb);
  }
}

TEST(SceneImageLoader, ReplacesAndCountsWhatCannotBeUsed) {
  const auto report_for = [](PartlyBroken::Fault fault) {
    const SceneImageLoader loader = loader_of(std::make_shared<PartlyBroken>(fault));
    for (uint64_t number = 0; number < 8; ++number) EXPECT_EQ(loader.load(number).scenes.size(), 3U);
    return loader.report();
  };
  const LoadingReport unreadable = report_for(PartlyBroken::Fault::kUnreadable);
  EXPECT_GT(unreadable.broken_samples, 5);
  EXPECT_EQ(unreadable.pose_outliers + unreadable.short_scenes, 0);
  EXPECT_NE(unreadable.last_problem.find("expected a readable scene, found a scratched disk."),
            std::string::npos);

  const LoadingReport image = report_for(PartlyBroken::Fault::kBrokenImage);
  EXPECT_GT(image.broken_samples, 5);
  EXPECT_NE(image.last_problem.find("expected an image of the camera's size 40x30, found 3x3; "
                                    "check that the files belong together."),
            std::string::npos);

  const LoadingReport far = report_for(PartlyBroken::Fault::kFarAway);
  EXPECT_GT(far.pose_outliers, 2);
  EXPECT_EQ(far.broken_samples, 0);
  EXPECT_NE(
      far.last_problem.find("frame_00004: expected a camera within 100 of the origin (max_translation_norm), "
                            "found one at 1000"),
      std::string::npos);

  const LoadingReport apart = report_for(PartlyBroken::Fault::kFarApart);
  EXPECT_GT(apart.pose_outliers, 2);
  EXPECT_NE(apart.last_problem.find(
                ": expected a camera within 100 of the last view (max_translation_norm), found one at 180"),
            std::string::npos)
      << apart.last_problem;

  const LoadingReport few = report_for(PartlyBroken::Fault::kShort);
  EXPECT_GT(few.short_scenes, 5);
  EXPECT_NE(few.last_problem.find("expected at least 3 frames, found 2."), std::string::npos);
}

TEST(SceneImageLoader, GivesUpInWordsWhenNothingCanBeUsed) {
  const SceneImageLoader loader = loader_of(std::make_shared<PartlyBroken>(PartlyBroken::Fault::kShort, 1));
  const std::string sentence = error_of([&] { loader.load(0); });
  EXPECT_EQ(sentence.substr(0, 88),
            "data loading: expected a usable sample within 20 attempts, found none, the last because ");
  EXPECT_EQ(error_of([] {
              std::vector<MixturePart> parts{part_of(small_scenes(), "part")};
              SceneImageLoader bad(Mixture(parts), {}, BatchLoading());
            }),
            "sizes: expected at least one size, found none; list the sizes to train at.");
}

}  // namespace
}  // namespace gld
