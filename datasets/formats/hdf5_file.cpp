#include "datasets/formats/hdf5_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <mutex>

#include <hdf5.h>

namespace gld {
namespace {

constexpr int64_t kLargestArray = int64_t{1} << 30;

std::mutex& library_mutex() {
  static std::mutex mutex;
  return mutex;
}

// Closes an HDF5 object with the function of its kind.
class Handle {
 public:
  using Close = herr_t (*)(hid_t);
  Handle(hid_t id, Close close) : id_(id), close_(close) {}
  ~Handle() {
    if (id_ >= 0) close_(id_);
  }
  Handle(const Handle&) = delete;
  Handle& operator=(const Handle&) = delete;
  bool good() const { return id_ >= 0; }
  hid_t id() const { return id_; }

 private:
  hid_t id_;
  Close close_;
};

std::vector<hsize_t> extents_of(const Handle& space) {
  const int rank = H5Sget_simple_extent_ndims(space.id());
  if (rank < 0 || rank > H5S_MAX_RANK) return {0};
  std::vector<hsize_t> extents(static_cast<size_t>(rank));
  if (rank > 0) H5Sget_simple_extent_dims(space.id(), extents.data(), nullptr);
  return extents;
}

}  // namespace

Hdf5Array read_hdf5(const std::filesystem::path& path, const std::string& dataset) {
  const std::string where = path.string();
  if (!std::filesystem::is_regular_file(path)) fail({where, "a file", "nothing", "check the path"});
  const std::lock_guard<std::mutex> lock(library_mutex());
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);  // our own sentence instead of the library's stack of lines
  const Handle file(H5Fopen(path.c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
  if (!file.good()) {
    fail({where, "an HDF5 file", "a damaged or truncated one, or another kind of file",
          "copy or download it again"});
  }
  const Handle data(H5Dopen2(file.id(), dataset.c_str(), H5P_DEFAULT), H5Dclose);
  if (!data.good())
    fail({where, "the dataset \"" + dataset + "\"", "none", "check that it is a file of this kind"});
  const Handle space(H5Dget_space(data.id()), H5Sclose);
  const Handle type(H5Dget_type(data.id()), H5Tclose);
  const H5T_class_t kind = type.good() ? H5Tget_class(type.id()) : H5T_NO_CLASS;
  if (kind != H5T_FLOAT && kind != H5T_INTEGER) {
    fail({where, "numbers in \"" + dataset + "\"", "another type", "check that it is a file of this kind"});
  }
  Hdf5Array array;
  int64_t count = 1;
  for (hsize_t extent : extents_of(space)) {
    if (extent == 0 || extent > static_cast<hsize_t>(kLargestArray / count)) {
      fail(
          {where, "a dataset of 1 to 2^30 elements", "another size", "check that it is a file of this kind"});
    }
    count *= static_cast<int64_t>(extent);
    array.shape.push_back(static_cast<int64_t>(extent));
  }
  array.values.resize(static_cast<size_t>(count));
  if (H5Dread(data.id(), H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, array.values.data()) < 0) {
    fail({where, "to read \"" + dataset + "\"", "damaged data", "copy or download it again"});
  }
  return array;
}

void write_hdf5(const std::filesystem::path& path, const std::string& dataset, const Hdf5Array& array) {
  AtomicFile target(path);
  {
    const std::lock_guard<std::mutex> lock(library_mutex());
    H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
    const Handle file(H5Fcreate(target.temporary().c_str(), H5F_ACC_TRUNC, H5P_DEFAULT, H5P_DEFAULT),
                      H5Fclose);
    const std::vector<hsize_t> extents(array.shape.begin(), array.shape.end());
    const Handle space(H5Screate_simple(static_cast<int>(extents.size()), extents.data(), nullptr), H5Sclose);
    const Handle data(H5Dcreate2(file.id(), dataset.c_str(), H5T_IEEE_F32LE, space.id(), H5P_DEFAULT,
                                 H5P_DEFAULT, H5P_DEFAULT),
                      H5Dclose);
    if (!file.good() || !space.good() || !data.good() ||
        H5Dwrite(data.id(), H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, array.values.data()) < 0) {
      fail({path.string(), "to write an HDF5 file", "an error of the library",
            "check the folder and the disk"});
    }
  }
  target.commit();
}

}  // namespace gld
