#include "infer/run_export/nerfstudio_export.h"

#include "datasets/formats/json_file.h"
#include "datasets/formats/scene_reader.h"
#include "infer/run_export/export_provenance.h"
#include "tests/infer/run_export/drawn_run.h"
#include "tests/support/temporary_folder.h"

#include <gtest/gtest.h>

namespace gld {
namespace {

using test::DrawnRun;
using test::TemporaryFolder;

TEST(NerfstudioExport, IsReadBackWithDepthAndCloud) {
  const TemporaryFolder folder;
  DrawnRun drawn;
  drawn.cut = 4;
  const auto views = test::write_drawn_run(folder.path() / "run", drawn);
  const FinishedRun run = open_finished_run(folder.path() / "run");
  const auto out = folder.path() / "nerfstudio";
  std::filesystem::create_directory(out);
  export_nerfstudio(out, run, export_provenance(run, "{}"));
  const auto json = read_json_file(out / "transforms.json");
  EXPECT_EQ(json.at("ply_file_path"), "points.ply");
  EXPECT_EQ(json.at("gld").at("gld:model"), "0123456789abcdef");
  EXPECT_EQ(json.at("gld").at("gld:seed"), "7");
  EXPECT_EQ(read_file(out / "points.ply"), read_file(folder.path() / "run" / "points.ply"));
  const Scene scene = open_scene(out);
  EXPECT_EQ(scene.format, "nerfstudio");
  ASSERT_EQ(scene.frames.size(), views.size());
  for (size_t i = 0; i < views.size(); ++i) {
    EXPECT_EQ(scene.frames[i].name, view_name(static_cast<int64_t>(i), 4));
    EXPECT_EQ(scene.frames[i].camera.intrinsics, views[i].camera.intrinsics);
    EXPECT_LT((scene.frames[i].camera.world_from_camera.matrix() - views[i].camera.world_from_camera.matrix())
                  .cwiseAbs()
                  .maxCoeff(),
              1e-12);
    EXPECT_EQ(scene.frames[i].image().rgb, views[i].image.rgb);
    const DepthMap depth = scene.frames[i].depth();
    for (size_t k = 0; k < depth.metres.size(); ++k)
      ASSERT_NEAR(depth.metres[k], views[i].depth.metres[k], 0.51 * run.views[i].depth_unit);
  }
}

TEST(NerfstudioExport, GoesWithoutDepthAndCloud) {
  const TemporaryFolder folder;
  DrawnRun drawn;
  drawn.depth = false;
  drawn.points = false;
  test::write_drawn_run(folder.path() / "run", drawn);
  const auto out = folder.path() / "nerfstudio";
  std::filesystem::create_directory(out);
  export_nerfstudio(out, open_finished_run(folder.path() / "run"), {});
  const auto json = read_json_file(out / "transforms.json");
  EXPECT_FALSE(json.contains("ply_file_path"));
  EXPECT_FALSE(std::filesystem::exists(out / "depth"));
  EXPECT_EQ(open_scene(out).frames.size(), 4U);
}

}  // namespace
}  // namespace gld
