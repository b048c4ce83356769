// Replays the fuzzers' corpus, and every file of it cut short and with single bytes changed.

#include "gld/base/atomic_file.h"
#include "tests/fuzz/readers.h"
#include "tests/support/data_folders.h"

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

using Reader = void (*)(const uint8_t*, size_t);

size_t replay(const std::string& kind, Reader read) {
  std::vector<std::filesystem::path> files;
  for (const auto& item :
       std::filesystem::directory_iterator(test::source_root() / "tests/fuzz/corpus" / kind)) {
    files.push_back(item.path());
  }
  std::sort(files.begin(), files.end());
  for (const auto& file : files) {
    const std::string original = read_file(file);
    const auto run = [&](const std::string& text) {
      // A copy of exactly that size on the heap, so that a sanitizer sees any byte beyond it.
      const std::vector<uint8_t> bytes(text.begin(), text.end());
      read(bytes.data(), bytes.size());
    };
    run(original);
    for (size_t size = 0; size < original.size(); size += 1 + original.size() / 200)
      run(original.substr(0, size));
    for (size_t position = 0; position < original.size(); position += 1 + original.size() / 400) {
      for (const char value : {'\0', '\x01', '\x7f', '\xff'}) {
        std::string changed = original;
        changed[position] = value;
        run(changed);
      }
    }
  }
  return files.size();
}

TEST(FuzzCorpus, Safetensors) { EXPECT_GE(replay("safetensors", test::read_as_safetensors), 4U); }

TEST(FuzzCorpus, TorchArchive) { EXPECT_GE(replay("torch_archive", test::read_as_torch_archive), 4U); }

TEST(FuzzCorpus, Hdf5) { EXPECT_GE(replay("hdf5", test::read_as_hdf5), 5U); }

TEST(FuzzCorpus, Json) { EXPECT_GE(replay("json", test::read_as_json), 3U); }

TEST(FuzzCorpus, Yaml) { EXPECT_GE(replay("yaml", test::read_as_yaml), 3U); }

TEST(FuzzCorpus, Image) { EXPECT_GE(replay("image", test::read_as_image), 5U); }

TEST(FuzzCorpus, Colmap) { EXPECT_GE(replay("colmap", test::read_as_colmap), 5U); }

TEST(FuzzCorpus, Re10k) { EXPECT_GE(replay("re10k", test::read_as_re10k), 1U); }

TEST(FuzzCorpus, Ffprobe) { EXPECT_GE(replay("ffprobe", test::read_as_ffprobe), 4U); }

TEST(FuzzCorpus, Npy) { EXPECT_GE(replay("npy", test::read_as_npy), 4U); }

}  // namespace
}  // namespace gld
