#include "gld/files/hdf5_array.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"

#include <algorithm>
#include <limits>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <hdf5.h>

namespace gld {
namespace {

using test::error_of;
using test::TemporaryFolder;
using testing::HasSubstr;

constexpr int64_t kMost = 1 << 20;

Hdf5Array parsed(const std::string& bytes, int64_t most = kMost) {
  // A copy of exactly that size on the heap, so that a sanitizer sees any byte beyond it.
  const std::vector<uint8_t> copy(bytes.begin(), bytes.end());
  return parse_hdf5_array({copy.data(), copy.size()}, "dataset", most, "a.hdf5");
}

std::string hdf5_refusal(const std::string& bytes, int64_t most = kMost) {
  return error_of([&] { parsed(bytes, most); });
}

// What is written; everything else by the library's defaults.
struct Written {
  hid_t type = H5T_IEEE_F32LE;
  std::vector<hsize_t> shape = {13, 9};
  std::vector<hsize_t> chunk;
  bool shuffle = false, fletcher32 = false, deflate = false;
  bool compact = false;
};

// These files hold 0, 1, 2, ... written by libhdf5 itself.
class Hdf5Files : public ::testing::Test {
 protected:
  Hdf5Files() { H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr); }

  std::string file() const { return (folder_.path() / "a.hdf5").string(); }

  std::string write(const Written& written) const {
    size_t count = 1;
    for (const hsize_t side : written.shape) count *= side;
    std::vector<float> values(count);
    for (size_t i = 0; i < count; ++i) values[i] = static_cast<float>(i % 120);
    const hid_t handle = H5Fcreate(file().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    const hid_t space =
        H5Screate_simple(static_cast<int>(written.shape.size()), written.shape.data(), nullptr);
    const hid_t creation = H5Pcreate(H5P_DATASET_CREATE);
    if (!written.chunk.empty())
      H5Pset_chunk(creation, static_cast<int>(written.chunk.size()), written.chunk.data());
    if (written.shuffle) H5Pset_shuffle(creation);
    if (written.deflate) H5Pset_deflate(creation, 9);
    if (written.fletcher32) H5Pset_fletcher32(creation);
    if (written.compact) H5Pset_layout(creation, H5D_COMPACT);
    const hid_t data = H5Dcreate2(handle, "dataset", written.type, space, H5P_DEFAULT, creation, H5P_DEFAULT);
    EXPECT_GE(data, 0);
    EXPECT_GE(H5Dwrite(data, H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), 0);
    H5Dclose(data);
    H5Pclose(creation);
    H5Sclose(space);
    H5Fclose(handle);
    return read_file(file());
  }

  TemporaryFolder folder_;
};

hid_t half_type() {
  const hid_t type = H5Tcopy(H5T_IEEE_F32LE);
  H5Tset_fields(type, 15, 10, 5, 0, 10);
  H5Tset_size(type, 2);
  H5Tset_ebias(type, 15);
  return type;
}

void expect_counting(const Hdf5Array& array, const std::vector<hsize_t>& shape) {
  ASSERT_EQ(std::vector<hsize_t>(array.shape.begin(), array.shape.end()), shape);
  for (size_t i = 0; i < array.values.size(); ++i)
    ASSERT_EQ(array.values[i], static_cast<float>(i % 120)) << i;
}

TEST_F(Hdf5Files, ReadsEveryLayoutTypeAndFilter) {
  const std::vector<hid_t> types = {H5T_IEEE_F32LE, H5T_IEEE_F32BE, H5T_IEEE_F64LE, H5T_IEEE_F64BE,
                                    half_type(),    H5T_STD_I8LE,   H5T_STD_U8LE,   H5T_STD_I16BE,
                                    H5T_STD_U16LE,  H5T_STD_I32LE,  H5T_STD_U32BE,  H5T_STD_I64BE,
                                    H5T_STD_U64LE};
  for (const hid_t type : types) {
    Written written;
    written.type = type;
    expect_counting(parsed(write(written)), written.shape);
    written.compact = true;
    expect_counting(parsed(write(written)), written.shape);
    written.compact = false;
    written.chunk = {4, 5};
    for (int filters = 0; filters < 8; ++filters) {
      written.shuffle = (filters & 1) != 0;
      written.deflate = (filters & 2) != 0;
      written.fletcher32 = (filters & 4) != 0;
      expect_counting(parsed(write(written)), written.shape);
    }
  }
  Written deep;
  deep.shape = {3, 5, 7, 2};
  deep.chunk = {2, 2, 7, 1};
  expect_counting(parsed(write(deep)), deep.shape);
  Written many;  // a tree of several levels
  many.shape = {400, 30};
  many.chunk = {1, 10};
  expect_counting(parsed(write(many)), many.shape);
}

TEST_F(Hdf5Files, ReadsWhatHypersimPublishes) {
  const auto path = test::test_data() / "scenes" / "hypersim_pieces" / "ai_037_002";
  const auto depth =
      parsed(read_file(path / "images" / "scene_cam_00_geometry_hdf5" / "frame.0000.depth_meters.hdf5"));
  EXPECT_EQ(depth.shape, (std::vector<int64_t>{768, 1024}));
  const auto orientations =
      parsed(read_file(path / "_detail" / "cam_00" / "camera_keyframe_orientations.hdf5"));
  EXPECT_EQ(orientations.shape, (std::vector<int64_t>{100, 3, 3}));
}

TEST_F(Hdf5Files, DoublesBeyondTheFloatsAreInfinite) {
  const hid_t handle = H5Fcreate(file().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  const hsize_t three = 3;
  const hid_t space = H5Screate_simple(1, &three, nullptr);
  const hid_t data =
      H5Dcreate2(handle, "dataset", H5T_IEEE_F64LE, space, H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
  const double values[] = {1e300, -1e300, 1};
  H5Dwrite(data, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values);
  H5Dclose(data);
  H5Sclose(space);
  H5Fclose(handle);
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  EXPECT_EQ(parsed(read_file(file())).values, (std::vector<float>{kInfinity, -kInfinity, 1}));
}

// libhdf5 1.10.8 crashes on the first of these files.
TEST_F(Hdf5Files, DamageAnywhereIsAnErrorOrOtherNumbers) {
  const auto positions = read_file(test::test_data() / "scenes" / "hypersim_pieces" / "ai_037_002" /
                                   "_detail" / "cam_00" / "camera_keyframe_positions.hdf5");
  std::string damaged = positions;
  damaged.replace(123, 16, 16, '\xFF');
  EXPECT_THAT(hdf5_refusal(damaged),
              HasSubstr("a.hdf5: expected an HDF5 file, found a damaged or truncated one"));
  Written written;
  written.chunk = {4, 5};
  written.deflate = written.shuffle = true;
  for (const std::string& whole : {positions, write(written), write(Written())}) {
    for (size_t at = 0; at < whole.size(); ++at) {
      for (const size_t run : {size_t{1}, size_t{16}}) {
        std::string bytes = whole;
        bytes.replace(at, std::min(run, whole.size() - at), std::min(run, whole.size() - at), '\xFF');
        try {
          parsed(bytes);
        } catch (const Error&) {
          continue;
        }
      }
    }
    for (size_t size = 0; size < whole.size(); size += 7)
      EXPECT_FALSE(hdf5_refusal(whole.substr(0, size)).empty());
  }
}

TEST_F(Hdf5Files, SizesAreComparedBeforeMemoryIsTaken) {
  Written written;
  EXPECT_EQ(
      hdf5_refusal(write(written), 100),
      "a.hdf5: expected a dataset of 1 to 100 elements, found another size; check that it is a file of this kind.");
  // 32768 squared, chunked, of which nothing was ever written: 8 GB from 1.4 kB.
  const hid_t handle = H5Fcreate(file().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  const hsize_t shape[] = {32768, 32768}, chunk[] = {512, 512};
  const hid_t space = H5Screate_simple(2, shape, nullptr), creation = H5Pcreate(H5P_DATASET_CREATE);
  H5Pset_chunk(creation, 2, chunk);
  H5Pset_deflate(creation, 9);
  H5Dclose(H5Dcreate2(handle, "dataset", H5T_IEEE_F64LE, space, H5P_DEFAULT, creation, H5P_DEFAULT));
  H5Pclose(creation);
  H5Sclose(space);
  H5Fclose(handle);
  EXPECT_EQ(hdf5_refusal(read_file(file()), int64_t{1} << 40),
            "a.hdf5: expected to read \"dataset\", found damaged data; copy or download it again.");
}

TEST_F(Hdf5Files, ReadsNothingThatLiesElsewhere) {
  const auto secret = folder_.path() / "secret";
  write_file_atomically(secret, std::string(64, 'x'));
  hid_t handle = H5Fcreate(file().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
  const hsize_t sixteen = 16;
  const hid_t space = H5Screate_simple(1, &sixteen, nullptr), creation = H5Pcreate(H5P_DATASET_CREATE);
  H5Pset_external(creation, secret.c_str(), 0, 64);
  H5Dclose(H5Dcreate2(handle, "dataset", H5T_IEEE_F32LE, space, H5P_DEFAULT, creation, H5P_DEFAULT));
  H5Pclose(creation);
  H5Sclose(space);
  H5Fclose(handle);
  EXPECT_THAT(hdf5_refusal(read_file(file())), HasSubstr("found data that lie in other files"));

  const std::string other = (folder_.path() / "other.hdf5").string();
  for (const bool external : {true, false}) {
    handle = H5Fcreate(file().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT);
    if (external) {
      H5Lcreate_external(other.c_str(), "/dataset", handle, "dataset", H5P_DEFAULT, H5P_DEFAULT);
    } else {
      H5Lcreate_soft("/other", handle, "dataset", H5P_DEFAULT, H5P_DEFAULT);
    }
    H5Fclose(handle);
    EXPECT_FALSE(hdf5_refusal(read_file(file())).empty());
  }
}

TEST_F(Hdf5Files, NamesWhatItDoesNotRead) {
  const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
  H5Pset_libver_bounds(access, H5F_LIBVER_LATEST, H5F_LIBVER_LATEST);
  H5Fclose(H5Fcreate(file().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, access));
  H5Pclose(access);
  EXPECT_EQ(
      hdf5_refusal(read_file(file())),
      "a.hdf5: expected the plain form of HDF5 that h5py writes by default, found a file of the layout of libver "
      "\"latest\"; write the array again with h5py's create_dataset and without special options.");
  Written written;
  const std::string bytes = write(written);
  EXPECT_EQ(error_of([&] {
              parse_hdf5_array({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, "other", kMost,
                               "a.hdf5");
            }),
            "a.hdf5: expected the dataset \"other\", found none; check that it is a file of this kind.");
}

}  // namespace
}  // namespace gld
