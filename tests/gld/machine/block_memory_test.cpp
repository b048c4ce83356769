#include "gld/machine/block_memory.h"

#include "tests/support/resident_memory.h"

#include <cstdint>
#include <cstring>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

constexpr size_t kMegabyte = size_t{1} << 20;

// This keeps up to 64 MiB while a test runs.
class BlockMemory : public testing::Test {
 protected:
  void SetUp() override {
    release_kept_blocks();
    set_most_kept_bytes(int64_t{64} << 20);
  }
  void TearDown() override {
    release_kept_blocks();
    set_most_kept_bytes(0);
  }
};

TEST_F(BlockMemory, KeepsNothingUntilAsked) {
  set_most_kept_bytes(0);
  give_block(take_block(4 * kMegabyte));
  EXPECT_EQ(kept_block_bytes(), 0);
}

TEST_F(BlockMemory, GivesAFreedBlockToTheNextOfAboutThatSize) {
  void* first = take_block(4 * kMegabyte);
  give_block(first);
  EXPECT_GE(kept_block_bytes(), static_cast<int64_t>(4 * kMegabyte));
  void* second = take_block(4 * kMegabyte - 100000);
  EXPECT_EQ(second, first);
  EXPECT_EQ(kept_block_bytes(), 0);
  void* third = take_block(4 * kMegabyte);
  EXPECT_NE(third, first);
  give_block(second);
  give_block(third);
}

// Weights have such sizes; a huge page for the few bytes past the last whole one would cost an eighth of a model.
TEST_F(BlockMemory, TakesNoHugePageForTheHeader) {
  constexpr int64_t kBlocks = 8, kBytes = 16 * kMegabyte;
  const int64_t before = test::resident_bytes();
  std::vector<void*> blocks;
  for (int64_t i = 0; i < kBlocks; ++i) {
    blocks.push_back(take_block(kBytes));
    std::memset(blocks.back(), 1, kBytes);
  }
  const int64_t taken = test::resident_bytes() - before;
  for (void* block : blocks) give_block(block);
  EXPECT_GE(taken, kBlocks * kBytes);
  EXPECT_LT(taken, kBlocks * kBytes + kBlocks * kBytes / 32);
}

TEST_F(BlockMemory, DoesNotSpendALargeBlockOnASmallOne) {
  void* large = take_block(8 * kMegabyte);
  give_block(large);
  void* small = take_block(kMegabyte);
  EXPECT_NE(small, large);
  give_block(small);
}

TEST_F(BlockMemory, AlignsEveryBlock) {
  std::vector<void*> blocks;
  for (size_t bytes = 1; bytes < 8 * kMegabyte; bytes = bytes * 3 + 1) {
    blocks.push_back(take_block(bytes));
    EXPECT_EQ(reinterpret_cast<uintptr_t>(blocks.back()) % 64, 0U) << bytes;
    std::memset(blocks.back(), 1, bytes);
  }
  for (void* block : blocks) give_block(block);
  give_block(nullptr);
}

TEST_F(BlockMemory, KeepsNoMoreThanTheLimit) {
  std::vector<void*> blocks;
  blocks.reserve(12);
  for (int i = 0; i < 12; ++i) blocks.push_back(take_block(8 * kMegabyte));
  for (void* block : blocks) give_block(block);
  EXPECT_LE(kept_block_bytes(), int64_t{64} << 20);
  EXPECT_GT(kept_block_bytes(), int64_t{40} << 20);
  release_kept_blocks();
  EXPECT_EQ(kept_block_bytes(), 0);
}

TEST_F(BlockMemory, MakesRoomForOtherSizes) {
  // Sizes are ever other ones, one at a time: what was kept of the earlier ones goes before the peak rises by half.
  for (size_t size = 4; size < 20; size += 3) {
    void* block = take_block(size * kMegabyte);
    EXPECT_LE(kept_block_bytes(), static_cast<int64_t>(size * kMegabyte / 2)) << size;
    give_block(block);
  }
}

TEST_F(BlockMemory, CountsWhatIsInUse) {
  const int64_t before = used_block_bytes();
  void* first = take_block(4 * kMegabyte);
  void* second = take_block(2 * kMegabyte);
  const int64_t both = used_block_bytes() - before;
  EXPECT_GE(both, static_cast<int64_t>(6 * kMegabyte));
  EXPECT_LE(both, static_cast<int64_t>(7 * kMegabyte));
  give_block(first);
  give_block(second);
  EXPECT_EQ(used_block_bytes(), before);
  EXPECT_EQ(most_used_block_bytes(), before + both);
  release_kept_blocks();
  EXPECT_EQ(most_used_block_bytes(), before);
}

TEST_F(BlockMemory, ServesThreadsAtOnce) {
  std::vector<std::thread> threads;
  threads.reserve(4);
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([t] {
      for (int i = 0; i < 200; ++i) {
        const size_t bytes = (static_cast<size_t>(i % 7) + 1) * 100000;
        auto* data = static_cast<unsigned char*>(take_block(bytes));
        std::memset(data, t, bytes);
        EXPECT_EQ(data[bytes - 1], t);
        EXPECT_EQ(data[bytes / 2], t);
        give_block(data);
      }
    });
  }
  for (auto& thread : threads) thread.join();
  release_kept_blocks();
  EXPECT_EQ(kept_block_bytes(), 0);
}

}  // namespace
}  // namespace gld
