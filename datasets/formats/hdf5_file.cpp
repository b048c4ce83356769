#include "datasets/formats/hdf5_file.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"

#include <mutex>

#include <hdf5.h>

namespace gld {
namespace {

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

}  // namespace

Hdf5Array read_hdf5(const std::filesystem::path& path, const std::string& dataset, int64_t most_elements) {
  constexpr uint64_t kLargestFile = uint64_t{1} << 31;
  const std::string bytes = read_file(path, kLargestFile);
  return parse_hdf5_array({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, dataset,
                          most_elements, path.string());
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
