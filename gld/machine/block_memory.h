#pragma once

#include <cstddef>
#include <cstdint>

// Memory that keeps what is freed for the next block of about that size (torch_version.h makes LibTorch take its CPU
// tensors from here). glibc maps every block over 32 MiB anew and gives it back when it is freed, and the kernel
// clears its pages each time: a full M1 forward spent 110 of 275 CPU seconds there.
namespace gld {

// Returns a block of at least that many bytes, aligned to 64; blocks of 2 MiB and more ask for huge pages. Its contents
// are whatever they were. Throws std::bad_alloc. It is safe to call from several threads at once, as all of these are.
void* take_block(size_t bytes);

// Takes back a block of take_block; null is nothing.
void give_block(void* data);

// Freed blocks are kept up to this many bytes together, past it they go back to the system. 0, the default, keeps
// nothing. Blocks in use and kept together take at most a quarter more than the most that was in use at one time.
void set_most_kept_bytes(int64_t bytes);

// Gives the kept blocks back to the system, between stages whose tensors differ in size.
void release_kept_blocks();

// Does the same with what malloc keeps for itself, after the work of libraries that take theirs there, as OpenCV does.
void trim_heap();

// Returns the bytes of freed blocks that are kept at this moment.
int64_t kept_block_bytes();

// Returns the bytes of blocks in use (those of 64 KiB and more), now and the most since the last release_kept_blocks().
int64_t used_block_bytes();
int64_t most_used_block_bytes();

}  // namespace gld
