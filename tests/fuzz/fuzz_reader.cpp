// One fuzzer for each reader: GLD_FUZZ_READER is its name.

#include "tests/fuzz/readers.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  gld::test::GLD_FUZZ_READER(data, size);
  return 0;
}
