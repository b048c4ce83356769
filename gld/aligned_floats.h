#pragma once

#include <cstdint>
#include <memory>
#include <new>

namespace gld {

// An uninitialised array of floats that starts on a cache line.
class AlignedFloats {
 public:
  explicit AlignedFloats(int64_t count)
      : data_(static_cast<float*>(::operator new (static_cast<std::size_t>(count) * sizeof(float),
                                                  std::align_val_t{kAlignment}))) {}
  float* data() const { return data_.get(); }

 private:
  static constexpr std::size_t kAlignment = 64;
  struct Release {
    void operator()(float* p) const { ::operator delete (p, std::align_val_t{kAlignment}); }
  };
  std::unique_ptr<float, Release> data_;
};

}  // namespace gld
