#include "gld/splatting/splat_ply.h"

#include "gld/base/atomic_file.h"
#include "tests/gld/splatting/random_gaussians.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <array>
#include <cstring>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;

GaussianSet some_gaussians(int64_t degree) {
  RandomGaussians wanted;
  wanted.count = 5;
  wanted.degree = degree;
  return random_gaussians(wanted);
}

void expect_equal(const GaussianSet& a, const GaussianSet& b) {
  EXPECT_EQ(a.degree, b.degree);
  for (const GaussianArray& array : gaussian_arrays(a))
    EXPECT_EQ(a.*array.values, b.*array.values) << array.name;
}

TEST(SplatPly, ComesBackAsItWas) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "splats.ply";
  for (int64_t degree = 0; degree <= 3; ++degree) {
    const GaussianSet set = some_gaussians(degree);
    write_splat_ply(file, set, {{"Software", "gld\nof a test"}});
    expect_equal(read_splat_ply(file), set);
  }
  write_splat_ply(file, zero_gaussians(0, 2), {});
  EXPECT_EQ(read_splat_ply(file).size(), 0);
}

// The layout that viewers of 3DGS read, byte by byte.
TEST(SplatPly, HasTheLayoutOfViewers) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "splats.ply";
  GaussianSet set = zero_gaussians(1, 1);
  set.means = {1, 2, 3};
  set.colours = {4, 5, 6};
  set.harmonics = {11, 12, 13, 21, 22, 23, 31, 32, 33};  // coefficient by coefficient
  set.logit_opacities = {7};
  set.log_scales = {-1, -2, -3};
  set.rotations = {0.5F, 0.25F, 0.125F, 1};
  write_splat_ply(file, set, {});
  const std::string bytes = read_file(file);
  std::string header = "ply\nformat binary_little_endian 1.0\nelement vertex 1\n";
  for (const char* name : {"x",        "y",        "z",        "nx",       "ny",       "nz",       "f_dc_0",
                           "f_dc_1",   "f_dc_2",   "f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3", "f_rest_4",
                           "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8", "opacity",  "scale_0",  "scale_1",
                           "scale_2",  "rot_0",    "rot_1",    "rot_2",    "rot_3"}) {
    header += "property float " + std::string(name) + "\n";
  }
  header += "end_header\n";
  ASSERT_EQ(bytes.substr(0, header.size()), header);
  // f_rest has all of red, then green, then blue.
  const float expected[26] = {1,  2,  3,  0,  0,  0, 4,  5,  6,  11,   21,    31,     12,
                              22, 32, 13, 23, 33, 7, -1, -2, -3, 0.5F, 0.25F, 0.125F, 1};
  ASSERT_EQ(bytes.size(), header.size() + sizeof(expected));
  std::array<float, 26> read{};
  std::memcpy(read.data(), bytes.data() + header.size(), sizeof(expected));
  EXPECT_THAT(read, testing::ElementsAreArray(expected));
}

TEST(SplatPly, FarScenesKeepTheirOrigin) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "splats.ply";
  GaussianSet set = some_gaussians(0);
  set.origin = {1234567.25, -1e6, 0.1};
  write_splat_ply(file, set, {});
  const GaussianSet far = read_splat_ply(file);
  EXPECT_EQ(far.origin, set.origin);
  expect_equal(far, set);
  set.origin = {0.5, -2, 1};
  write_splat_ply(file, set, {});
  const GaussianSet near = read_splat_ply(file);
  EXPECT_EQ(near.origin, Eigen::Vector3d::Zero());
  for (size_t i = 0; i < set.means.size(); ++i)
    EXPECT_EQ(near.means[i], static_cast<float>(set.means[i] + set.origin[static_cast<Eigen::Index>(i % 3)]));
}

TEST(SplatPly, HostileFilesAreOneSentence) {
  const TemporaryFolder folder;
  const auto file = folder.path() / "bad.ply";
  const std::string where = file.string();
  const auto refusal = [&](const std::string& bytes) {
    write_file_atomically(file, bytes);
    return error_of([&] { read_splat_ply(file); });
  };
  EXPECT_EQ(refusal("plyx"), where + ": expected a PLY file, found another one; check the path.");
  EXPECT_EQ(refusal(""), where + ": expected a PLY file, found another one; check the path.");
  const std::string start = "ply\nformat binary_little_endian 1.0\n";
  EXPECT_EQ(
      refusal("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"),
      where +
          ": expected \"format binary_little_endian 1.0\", found \"format ascii 1.0\"; convert it to binary PLY.");
  EXPECT_EQ(
      refusal(start + "element vertex 9223372036854775807\nproperty float x\nend_header\nabcd"),
      where +
          ": expected 9223372036854775807 vertices of 4 bytes, found 4 bytes; write or download it again.");
  EXPECT_EQ(
      refusal(start + "element vertex -1\nproperty float x\nend_header\n"),
      where +
          ": expected \"element vertex\" with a number first, found \"element vertex -1\"; write it again with "
          "vertices first.");
  EXPECT_EQ(
      refusal(start + "element vertex 0\nproperty list uchar int x\nend_header\n"),
      where +
          ": expected properties of vertices that are numbers, found \"property list uchar int x\"; write it "
          "again without that property.");
  EXPECT_EQ(refusal(start + "element vertex 0\nend_header\n"),
            where + ": expected vertices with properties, found none; check the file.");
  EXPECT_EQ(
      refusal(start + "element vertex 0\nproperty float x\nend_header\n"),
      where + ": expected Gaussians of 3DGS, found vertices without \"y\"; choose a file of Gaussians.");
  EXPECT_EQ(
      refusal(start + "element vertex 0\nproperty float x\nproperty float f_rest_0\nend_header\n"),
      where +
          ": expected 0, 9, 24 or 45 properties f_rest_*, found 1; write it with spherical harmonics of a whole "
          "degree.");
  // With every byte changed or cut there is an Error or a set, never anything else.
  write_splat_ply(file, some_gaussians(1), {{"gld", "x"}});
  const std::string whole = read_file(file);
  int64_t refused = 0;
  for (size_t i = 0; i < whole.size(); i += 3) {
    for (const std::string& bytes : {whole.substr(0, i), whole.substr(0, i) + '\xff' + whole.substr(i + 1)}) {
      write_file_atomically(file, bytes);
      try {
        check_gaussians(read_splat_ply(file), "read");
      } catch (const std::exception&) {
        ++refused;
      }
    }
  }
  EXPECT_GT(refused, static_cast<int64_t>(whole.size() / 3));
}

}  // namespace
}  // namespace gld
