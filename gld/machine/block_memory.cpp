#include "gld/machine/block_memory.h"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <iterator>
#include <map>
#include <mutex>
#include <new>
#include <utility>

#include <malloc.h>
#include <sys/mman.h>

namespace gld {
namespace {

constexpr size_t kAlignment = 64;  // of LibTorch's own CPU allocator: a cache line, an AVX-512 vector
constexpr size_t kSmallestKept = size_t{64} << 10;  // below it malloc is fast
constexpr size_t kHugePage = size_t{2} << 20;
constexpr size_t kWorthTrimming = size_t{64} << 20;

// A header stands before every block, so that the deleter knows what it gives back.
struct alignas(kAlignment) BlockHeader {
  size_t capacity = 0;  // of the whole allocation, header included
};

// Returns sizes in steps of an eighth of a power of two: at most 12.5 % is wasted, and tensors of nearly one size share
// blocks.
size_t rounded_capacity(size_t bytes) {
  if (bytes < kSmallestKept) return bytes;
  size_t step = kSmallestKept / 8;
  while (step * 16 < bytes) step *= 2;
  return (bytes + step - 1) / step * step;
}

// Maps memory of its own for a large block, so that all of it goes back when the block does: malloc's heap kept a tenth
// of a model in the gaps between its weights. capacity is whole pages, of which `used` bytes will be written. Returns
// null when refused.
void* map_block(size_t used, size_t capacity) {
  void* mapped =
      mmap(nullptr, capacity + kHugePage, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (mapped == MAP_FAILED) return nullptr;
  auto* begin = static_cast<char*>(mapped);
  const size_t in_front = (kHugePage - reinterpret_cast<uintptr_t>(begin) % kHugePage) % kHugePage;
  char* memory = begin + in_front;
  if (in_front > 0) munmap(begin, in_front);
  munmap(memory + capacity, kHugePage - in_front);
  // The last piece gets a huge page only where it fills half of one: 16 MiB of numbers behind their header would take
  // 18, and all weights of a model an eighth more than they are.
  const size_t huge = std::min((used + kHugePage / 2) / kHugePage * kHugePage, capacity);
  madvise(memory, huge, MADV_HUGEPAGE);
  if (huge < capacity) madvise(memory + huge, capacity - huge, MADV_NOHUGEPAGE);
  return memory;
}

void* new_memory(size_t used, size_t capacity) {
  if (capacity >= kHugePage) return map_block(used, capacity);
  void* memory = nullptr;
  return posix_memalign(&memory, kAlignment, capacity) == 0 ? memory : nullptr;
}

void free_memory(BlockHeader* block) {
  if (block->capacity >= kHugePage) {
    munmap(block, block->capacity);
  } else {
    std::free(block);
  }
}

class KeptBlocks {
 public:
  void set_limit(size_t bytes) {
    const std::lock_guard<std::mutex> lock(mutex_);
    limit_ = bytes;
  }

  BlockHeader* take(size_t bytes) {
    const size_t capacity = rounded_capacity(bytes + sizeof(BlockHeader));
    if (capacity >= kSmallestKept) {
      const std::lock_guard<std::mutex> lock(mutex_);
      // One of the next two sizes will do as well.
      const auto found = blocks_.lower_bound(capacity);
      if (found != blocks_.end() && found->first <= capacity + capacity / 4) {
        BlockHeader* block = remove(found);
        count_in_use(block->capacity);
        return block;
      }
      count_in_use(capacity);
      make_room();
    }
    void* memory = new_memory(bytes + sizeof(BlockHeader), capacity);
    if (!memory) {
      release();  // what is kept may be what is missing
      memory = new_memory(bytes + sizeof(BlockHeader), capacity);
      if (!memory) {
        if (capacity >= kSmallestKept) {
          const std::lock_guard<std::mutex> lock(mutex_);
          in_use_ -= capacity;
        }
        throw std::bad_alloc();
      }
    }
    return new (memory) BlockHeader{capacity};
  }

  void give(BlockHeader* block) {
    if (block->capacity >= kSmallestKept) {
      const std::lock_guard<std::mutex> lock(mutex_);
      in_use_ -= block->capacity;
      if (kept_ + block->capacity <= limit_) {
        kept_ += block->capacity;
        blocks_.emplace(block->capacity, block);
        return;
      }
    }
    free_memory(block);
  }

  void release() {
    Blocks blocks;
    size_t freed = 0;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      blocks.swap(blocks_);
      kept_ = 0;
      freed = std::exchange(most_in_use_, in_use_) - in_use_;
    }
    for (const auto& [capacity, block] : blocks) free_memory(block);
    if (freed >= kWorthTrimming) trim_heap();
  }

  struct Sizes {
    size_t kept, in_use, most_in_use;
  };
  Sizes sizes() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return {kept_, in_use_, most_in_use_};
  }

 private:
  using Blocks = std::multimap<size_t, BlockHeader*>;

  BlockHeader* remove(Blocks::iterator place) {
    BlockHeader* block = place->second;
    kept_ -= place->first;
    blocks_.erase(place);
    return block;
  }

  void count_in_use(size_t capacity) {
    in_use_ += capacity;
    most_in_use_ = std::max(most_in_use_, in_use_);
  }

  // Keeping blocks of sizes that are not asked for any more must not raise the process's peak by more than a quarter.
  void make_room() {
    while (!blocks_.empty() && in_use_ + kept_ > most_in_use_ + most_in_use_ / 4) {
      free_memory(remove(std::prev(blocks_.end())));
    }
  }

  std::mutex mutex_;
  Blocks blocks_;           // by capacity
  size_t in_use_ = 0;       // of blocks that are large enough to be kept
  size_t most_in_use_ = 0;  // since the last release
  size_t kept_ = 0;
  size_t limit_ = 0;
};

// The blocks are never destroyed: what has static storage gives its blocks back after main.
KeptBlocks& kept_blocks() {
  static auto* blocks = new KeptBlocks;
  return *blocks;
}

}  // namespace

// glibc keeps freed memory for itself: 1.8 of M1's 2.1 GB stayed with the process.
void trim_heap() {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}

void set_most_kept_bytes(int64_t bytes) {
  kept_blocks().set_limit(static_cast<size_t>(std::max<int64_t>(bytes, 0)));
}

void* take_block(size_t bytes) { return kept_blocks().take(bytes) + 1; }

void give_block(void* data) {
  if (data != nullptr) kept_blocks().give(static_cast<BlockHeader*>(data) - 1);
}

void release_kept_blocks() { kept_blocks().release(); }

int64_t kept_block_bytes() { return static_cast<int64_t>(kept_blocks().sizes().kept); }

int64_t used_block_bytes() { return static_cast<int64_t>(kept_blocks().sizes().in_use); }

int64_t most_used_block_bytes() { return static_cast<int64_t>(kept_blocks().sizes().most_in_use); }

}  // namespace gld
