#include "tests/fuzz/readers.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  gld::test::read_as_npy(data, size);
  return 0;
}
