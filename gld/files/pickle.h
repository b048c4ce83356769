#pragma once

#include "gld/base/mapped_file.h"
#include "gld/files/dtype.h"

#include <cstdint>
#include <string>
#include <vector>

namespace gld {

// A restricted reader of Python pickles as PyTorch writes them. It knows tensors, numbers, strings, lists,
// tuples, dictionaries and OrderedDict, and calls nothing: any other class or function is refused by name.

enum class PickleKind : uint8_t {
  kNone,
  kBoolean,
  kInteger,
  kReal,
  kText,        // strings, bytes, and integers beyond 64 bits as "0x..."
  kList,        // lists and tuples
  kDictionary,  // items are key, value, key, value, ...
  kStorage,
  kTensor,
  kGlobal,  // one of the few allowed names; meaningless as a value
};

// A storage that lies elsewhere in the file.
struct PickleStorage {
  std::string key;
  DType dtype = DType::kFloat32;
  int64_t elements = 0;  // of the whole storage
  int64_t offset = 0;    // a legacy view into it: first element and count
  int64_t view_elements = 0;
};

// A strided view of a storage, already checked to stay inside `view_elements`.
struct PickleTensor {
  PickleStorage storage;
  int64_t offset = 0;  // in elements, from the start of the whole storage
  std::vector<int64_t> shape;
  std::vector<int64_t> strides;
};

using PickleId = uint32_t;

// The objects of one pickle. They may refer to each other in circles; whoever walks them limits the depth.
class PickleObjects {
 public:
  PickleId root() const { return root_; }
  PickleKind kind(PickleId id) const { return nodes_[id].kind; }
  int64_t integer(PickleId id) const { return nodes_[id].integer; }  // booleans are 0 and 1
  double real(PickleId id) const { return nodes_[id].real; }
  const std::string& text(PickleId id) const { return texts_[nodes_[id].index]; }
  const std::vector<PickleId>& items(PickleId id) const { return lists_[nodes_[id].index]; }
  const PickleStorage& storage(PickleId id) const { return storages_[nodes_[id].index]; }
  const PickleTensor& tensor(PickleId id) const { return tensors_[nodes_[id].index]; }
  const std::vector<PickleStorage>& storages() const { return storages_; }

 private:
  friend class Unpickler;
  struct Node {
    PickleKind kind = PickleKind::kNone;
    union {
      int64_t integer;
      double real;
      size_t index;
    };
  };
  std::vector<Node> nodes_;
  std::vector<std::string> texts_;
  std::vector<std::vector<PickleId>> lists_;
  std::vector<PickleStorage> storages_;
  std::vector<PickleTensor> tensors_;
  PickleId root_ = 0;
};

// Reads one pickle of `bytes` from `position` on and moves `position` behind it. Throws Error naming `where`.
PickleObjects unpickle(ByteView bytes, size_t& position, const std::string& where);

// Returns "an integer", "a list", ... for messages.
std::string describe(PickleKind kind);

}  // namespace gld
