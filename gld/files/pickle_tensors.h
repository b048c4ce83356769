#pragma once

#include "gld/files/pickle.h"

#include <cstddef>
#include <string>
#include <vector>

namespace gld {

// What PyTorch means by the names, references and calls in a pickle; used by the unpickler alone.

// Where the unpickler stands, for errors.
struct PickleSite {
  std::string where;
  size_t position = 0;

  [[noreturn]] void broken(const std::string& found) const;  // the pickle makes no sense
  [[noreturn]] void refuse(const std::string& name) const;   // it wants something that could run code
};

// The only names a pickle may refer to. Storage types are numbered from kFirstStorage on.
enum class PickleGlobal : int64_t { kOrderedDict, kRebuildTensor, kRebuildParameter, kFirstStorage };

// Throws Error naming module and name unless it is one of them.
PickleGlobal pickle_global(const std::string& module, const std::string& name, const PickleSite& site);

// Reads a reference ("storage", type, key, location, elements[, view]). The location, such as "cuda:0", is ignored.
PickleStorage pickle_storage(const PickleObjects& objects, PickleId reference, const PickleSite& site);

// Reads the arguments (storage, offset, shape, strides, ...) of a call that makes a tensor. They are refused when an
// element would lie outside the storage, or when it has more elements than the storage (an expanded view would need
// memory that the file does not justify).
PickleTensor pickle_tensor(const PickleObjects& objects, const std::vector<PickleId>& arguments,
                           const PickleSite& site);

}  // namespace gld
