#pragma once

#include "gld/machine/block_memory.h"

#include <cstdint>
#include <memory>

namespace gld {

// An uninitialised array of floats that starts on a cache line.
class AlignedFloats {
 public:
  explicit AlignedFloats(int64_t count)
      : data_(static_cast<float*>(take_block(static_cast<std::size_t>(count) * sizeof(float)))) {}
  float* data() const { return data_.get(); }

 private:
  struct Release {
    void operator()(float* p) const { give_block(p); }
  };
  std::unique_ptr<float, Release> data_;
};

}  // namespace gld
