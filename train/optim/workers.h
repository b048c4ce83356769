#pragma once

#include <cstdint>
#include <functional>

namespace gld {

// Calls piece(0) to piece(count - 1), each once, in as many threads of their own as there are workers, or in the
// caller's for one worker: who is done takes the next. Unlike those of OpenMP they end with it, and do not wait busily
// for the next call while others compute. It throws the error of the first piece that had one, when all have ended.
void in_workers(int64_t workers, int64_t count, const std::function<void(int64_t)>& piece);

}  // namespace gld
