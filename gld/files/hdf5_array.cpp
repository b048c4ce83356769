#include "gld/files/hdf5_array.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/printable_text.h"
#include "gld/files/dtype.h"
#include "gld/files/hdf5_elements.h"
#include "gld/files/hdf5_filters.h"

#include <algorithm>
#include <cstring>
#include <limits>
#include <optional>

namespace gld {
namespace {

constexpr uint64_t kUndefined = ~uint64_t{0};  // "no address"
constexpr size_t kMostHeaderBlocks = 64;
constexpr size_t kMostMessages = 4096;
constexpr size_t kMostTreeNodes = 1 << 20;
constexpr size_t kMostFilters = 8;
constexpr size_t kMostDimensions = 32;  // H5S_MAX_RANK

enum MessageType : uint16_t {
  kDataspaceMessage = 0x01,
  kDatatypeMessage = 0x03,
  kExternalFilesMessage = 0x07,
  kLayoutMessage = 0x08,
  kFilterMessage = 0x0B,
  kContinuationMessage = 0x10,
  kSymbolTableMessage = 0x11,
};

struct Message {
  uint16_t type = 0;
  uint8_t flags = 0;
  ByteView data;
};

enum class Placement { kCompact, kContiguous, kChunked };

struct Layout {
  Placement placement = Placement::kContiguous;
  ByteView compact;
  uint64_t address = 0;         // of the data or of the tree of chunks
  uint64_t size = 0;            // of contiguous data
  std::vector<uint64_t> chunk;  // elements of a chunk along every dimension
};

class Hdf5Parser {
 public:
  Hdf5Parser(ByteView file, std::string dataset, int64_t most_elements, std::string where)
      : file_(file),
        dataset_(std::move(dataset)),
        most_(static_cast<uint64_t>(most_elements)),
        where_(std::move(where)) {}

  Hdf5Array parse() {
    const uint64_t root = root_header();
    read_dataset(find_dataset(root));
    return std::move(array_);
  }

 private:
  [[noreturn]] void damaged() const {
    fail({where_, "an HDF5 file", "a damaged or truncated one, or another kind of file",
          "copy or download it again"});
  }

  [[noreturn]] void damaged_data() const {
    fail({where_, "to read \"" + printable_text(dataset_) + "\"", "damaged data",
          "copy or download it again"});
  }

  [[noreturn]] void refuse(const std::string& found) const {
    fail({where_, "the plain form of HDF5 that h5py writes by default", found,
          "write the array again with h5py's create_dataset and without special options"});
  }

  const uint8_t* at(uint64_t address, uint64_t size) const {
    if (address > file_.size || size > file_.size - address) damaged();
    return file_.data + address;
  }

  template <class T>
  static T load(const uint8_t* from) {
    T value;
    std::memcpy(&value, from, sizeof value);
    return value;
  }

  template <class T>
  T number(uint64_t address) const {
    return load<T>(at(address, sizeof(T)));
  }

  // Reads the same inside a message.
  template <class T>
  T number(ByteView bytes, size_t offset) const {
    if (offset > bytes.size || sizeof(T) > bytes.size - offset) damaged();
    return load<T>(bytes.data + offset);
  }

  bool has_signature(uint64_t address, const char* text) const {
    return std::memcmp(at(address, 4), text, 4) == 0;
  }

  uint64_t root_header() const {
    static const uint8_t magic[8] = {0x89, 'H', 'D', 'F', '\r', '\n', 0x1a, '\n'};
    if (std::memcmp(at(0, sizeof magic), magic, sizeof magic) != 0) damaged();
    const auto version = number<uint8_t>(8);
    if (version == 2 || version == 3) refuse("a file of the layout of libver \"latest\"");
    if (version > 1) damaged();
    if (number<uint8_t>(13) != 8 || number<uint8_t>(14) != 8) refuse("addresses that have not 8 bytes");
    const uint64_t base = version == 0 ? 24 : 28;  // version 1 has one more pair of numbers
    if (number<uint64_t>(base) != 0) refuse("a file with a user block");
    if (number<uint64_t>(base + 16) > file_.size) damaged();  // its end of file: this one is cut short
    return number<uint64_t>(base + 32 + 8);
  }

  std::vector<Message> messages(uint64_t header) const {
    if (std::memcmp(at(header, 4), "OHDR", 4) == 0) refuse("an object of the layout of libver \"latest\"");
    if (number<uint8_t>(header) != 1) damaged();
    const uint32_t size = number<uint32_t>(header + 8);
    std::vector<ByteView> blocks{{at(header + 16, size), size}};
    std::vector<Message> found;
    for (size_t block = 0; block < blocks.size(); ++block) {
      const ByteView bytes = blocks[block];
      for (size_t position = 0; bytes.size - position >= 8;) {
        Message message;
        message.type = load<uint16_t>(bytes.data + position);
        const size_t length = load<uint16_t>(bytes.data + position + 2);
        message.flags = bytes.data[position + 4];
        position += 8;
        if (length > bytes.size - position || found.size() == kMostMessages) damaged();
        message.data = {bytes.data + position, length};
        position += length;
        if (message.type == kContinuationMessage) {
          const auto address = number<uint64_t>(message.data, 0), count = number<uint64_t>(message.data, 8);
          if (blocks.size() == kMostHeaderBlocks) damaged();
          blocks.push_back({at(address, count), static_cast<size_t>(count)});
        }
        found.push_back(message);
      }
    }
    return found;
  }

  static const Message* find(const std::vector<Message>& messages, MessageType type) {
    for (const Message& message : messages) {
      if (message.type == type) return &message;
    }
    return nullptr;
  }

  ByteView required(const std::vector<Message>& messages, MessageType type) const {
    const Message* message = find(messages, type);
    if (message == nullptr) damaged();
    constexpr uint8_t kShared = 2;
    if ((message->flags & kShared) != 0) refuse("a message that is shared between objects");
    return message->data;
  }

  // Visits the leaves of a B-tree of version 1; keys have key_size bytes. It calls visit(key, address of the child).
  template <class Visit>
  void walk_tree(uint64_t root, uint8_t kind, size_t key_size, const Visit& visit) {
    walk_node(root, kind, key_size, std::nullopt, visit);
  }

  template <class Visit>
  void walk_node(uint64_t node, uint8_t kind, size_t key_size, std::optional<uint8_t> level,
                 const Visit& visit) {
    constexpr size_t kNodeHeader = 24;
    if (++nodes_seen_ > kMostTreeNodes) damaged();
    const uint8_t* header = at(node, kNodeHeader);
    if (std::memcmp(header, "TREE", 4) != 0 || header[4] != kind) damaged();
    // Levels fall from node to child, so that a tree that contains itself ends.
    if (level && header[5] != *level) damaged();
    const size_t entries = load<uint16_t>(header + 6);
    const uint8_t* body = at(node + kNodeHeader, entries * (key_size + 8) + key_size);
    for (size_t i = 0; i < entries; ++i) {
      const uint8_t* key = body + i * (key_size + 8);
      const auto child = load<uint64_t>(key + key_size);
      if (header[5] == 0) {
        if (++nodes_seen_ > kMostTreeNodes) damaged();  // a leaf may be the child of many
        visit(key, child);
      } else {
        walk_node(child, kind, key_size, static_cast<uint8_t>(header[5] - 1), visit);
      }
    }
  }

  uint64_t find_dataset(uint64_t root) {
    const ByteView table = required(messages(root), kSymbolTableMessage);
    const uint64_t tree = number<uint64_t>(table, 0), heap = number<uint64_t>(table, 8);
    if (!has_signature(heap, "HEAP") || number<uint8_t>(heap + 4) != 0) damaged();
    const auto names_size = number<uint64_t>(heap + 8), names = number<uint64_t>(heap + 24);
    at(names, names_size);
    std::optional<uint64_t> found;
    walk_tree(tree, 0, 8, [&](const uint8_t*, uint64_t leaf) {
      if (!has_signature(leaf, "SNOD") || number<uint8_t>(leaf + 4) != 1) damaged();
      constexpr uint64_t kEntry = 40;
      const uint64_t count = number<uint16_t>(leaf + 6);
      const uint8_t* entries = at(leaf + 8, count * kEntry);
      nodes_seen_ += count;
      for (uint64_t i = 0; i < count; ++i) {
        const uint8_t* entry = entries + i * kEntry;
        const auto name = load<uint64_t>(entry);
        const size_t length = dataset_.size() + 1;  // with the zero behind it
        if (name > names_size || length > names_size - name) continue;
        if (std::memcmp(at(names + name, length), dataset_.c_str(), length) != 0) continue;
        constexpr uint32_t kSymbolicLink = 2;
        if (load<uint32_t>(entry + 16) == kSymbolicLink)
          refuse("a link in place of \"" + printable_text(dataset_) + "\"");
        found = load<uint64_t>(entry + 8);
      }
    });
    if (!found) {
      fail({where_, "the dataset \"" + printable_text(dataset_) + "\"", "none",
            "check that it is a file of this kind"});
    }
    return *found;
  }

  void read_dataset(uint64_t header) {
    const auto all = messages(header);
    if (find(all, kExternalFilesMessage) != nullptr) refuse("data that lie in other files");
    elements_ = elements_of(required(all, kDatatypeMessage));
    const std::vector<uint64_t> extents = extents_of(required(all, kDataspaceMessage));
    uint64_t count = 1;
    for (const uint64_t extent : extents) {
      if (extent == 0 || extent > most_ / count) {
        fail({where_, "a dataset of 1 to " + std::to_string(most_) + " elements", "another size",
              "check that it is a file of this kind"});
      }
      count *= extent;
      array_.shape.push_back(static_cast<int64_t>(extent));
    }
    const Layout layout = layout_of(required(all, kLayoutMessage), extents.size());
    if (layout.placement == Placement::kChunked) {
      const Message* filters = find(all, kFilterMessage);
      if (filters != nullptr) required(all, kFilterMessage);
      read_chunks(layout, filters == nullptr ? std::vector<Hdf5Filter>() : filters_of(filters->data), extents,
                  count);
      return;
    }
    const uint64_t bytes = count * elements_.size();
    const uint8_t* data = nullptr;
    if (layout.placement == Placement::kCompact) {
      if (layout.compact.size < bytes) damaged_data();
      data = layout.compact.data;
    } else {
      if (layout.address == kUndefined || layout.size < bytes) damaged_data();
      data = at(layout.address, bytes);
    }
    array_.values.resize(static_cast<size_t>(count));
    floats_from(elements_, data, count, array_.values.data());
  }

  Hdf5Elements elements_of(ByteView type) const {
    const auto first = number<uint8_t>(type, 0);
    const int version = first >> 4, kind = first & 15;
    const uint8_t bits0 = number<uint8_t>(type, 1), bits1 = number<uint8_t>(type, 2);
    const auto size = number<uint32_t>(type, 4);
    if (version < 1 || version > 3) damaged();
    Hdf5Elements elements;
    elements.swapped = (bits0 & 1) != 0;
    if (kind == 0) {
      if (number<uint16_t>(type, 8) != 0 || number<uint16_t>(type, 10) != 8 * size)
        refuse("integers of odd bits");
      const bool is_signed = (bits0 & 8) != 0;
      switch (size) {
        case 1:
          elements.dtype = is_signed ? DType::kInt8 : DType::kUInt8;
          return elements;
        case 2:
          elements.dtype = is_signed ? DType::kInt16 : DType::kUInt16;
          return elements;
        case 4:
          elements.dtype = is_signed ? DType::kInt32 : DType::kUInt32;
          return elements;
        case 8:
          elements.dtype = is_signed ? DType::kInt64 : DType::kUInt64;
          return elements;
        default:
          refuse("integers of " + std::to_string(size) + " bytes");
      }
    }
    if (kind == 1) {
      // Sign bit, bytes in all, and where exponent and fraction lie: only IEEE 754's own are read.
      struct Ieee {
        uint8_t sign;
        uint32_t bytes;
        uint8_t exponent_at, exponent, fraction;
        uint32_t bias;
        DType dtype;
      };
      for (const Ieee& ieee :
           {Ieee{15, 2, 10, 5, 10, 15, DType::kFloat16}, Ieee{31, 4, 23, 8, 23, 127, DType::kFloat32},
            Ieee{63, 8, 52, 11, 52, 1023, DType::kFloat64}}) {
        if (size != ieee.bytes || bits1 != ieee.sign || number<uint16_t>(type, 8) != 0 ||
            number<uint16_t>(type, 10) != 8 * size || number<uint8_t>(type, 12) != ieee.exponent_at ||
            number<uint8_t>(type, 13) != ieee.exponent || number<uint8_t>(type, 14) != 0 ||
            number<uint8_t>(type, 15) != ieee.fraction || number<uint32_t>(type, 16) != ieee.bias) {
          continue;
        }
        elements.dtype = ieee.dtype;
        return elements;
      }
      refuse("floating-point numbers that are not IEEE 754's");
    }
    fail({where_, "numbers in \"" + printable_text(dataset_) + "\"", "another type",
          "check that it is a file of this kind"});
  }

  std::vector<uint64_t> extents_of(ByteView space) const {
    const auto version = number<uint8_t>(space, 0);
    const size_t rank = number<uint8_t>(space, 1);
    if (version < 1 || version > 2 || rank > kMostDimensions) damaged();
    constexpr uint8_t kNull = 2;
    if (version == 2 && number<uint8_t>(space, 3) == kNull) return {0};
    std::vector<uint64_t> extents(rank);
    for (size_t i = 0; i < rank; ++i) extents[i] = number<uint64_t>(space, (version == 1 ? 8 : 4) + 8 * i);
    return extents;
  }

  Layout layout_of(ByteView bytes, size_t rank) const {
    const auto version = number<uint8_t>(bytes, 0);
    if (version != 3) refuse("a data layout of version " + std::to_string(version));
    Layout layout;
    switch (number<uint8_t>(bytes, 1)) {
      case 0: {
        const size_t size = number<uint16_t>(bytes, 2);
        if (size > bytes.size - 4) damaged();
        layout.placement = Placement::kCompact;
        layout.compact = {bytes.data + 4, size};
        return layout;
      }
      case 1:
        layout.address = number<uint64_t>(bytes, 2);
        layout.size = number<uint64_t>(bytes, 10);
        return layout;
      case 2: {
        layout.placement = Placement::kChunked;
        if (number<uint8_t>(bytes, 2) != rank + 1 || rank == 0) damaged();
        layout.address = number<uint64_t>(bytes, 3);
        for (size_t i = 0; i < rank; ++i) layout.chunk.push_back(number<uint32_t>(bytes, 11 + 4 * i));
        if (number<uint32_t>(bytes, 11 + 4 * rank) != elements_.size()) damaged();
        return layout;
      }
      default:
        damaged();
    }
  }

  std::vector<Hdf5Filter> filters_of(ByteView bytes) const {
    const auto version = number<uint8_t>(bytes, 0);
    const size_t count = number<uint8_t>(bytes, 1);
    if (version < 1 || version > 2 || count > kMostFilters) damaged();
    size_t position = version == 1 ? 8 : 2;
    std::vector<Hdf5Filter> filters;
    for (size_t i = 0; i < count; ++i) {
      const auto filter = number<uint16_t>(bytes, position);
      if (!is_known_hdf5_filter(filter)) refuse("filter number " + std::to_string(filter));
      position += 2;
      size_t name = 0;
      if (version == 1) {
        name = number<uint16_t>(bytes, position);
        position += 2;
      }
      const size_t values = number<uint16_t>(bytes, position + 2);
      position += 4 + name + 4 * values;
      if (version == 1 && values % 2 == 1) position += 4;
      filters.push_back(static_cast<Hdf5Filter>(filter));
    }
    return filters;
  }

  void read_chunks(const Layout& layout, const std::vector<Hdf5Filter>& filters,
                   const std::vector<uint64_t>& extents, uint64_t count) {
    const size_t rank = extents.size();
    uint64_t chunk_elements = 1, chunks = 1;
    std::vector<uint64_t> chunks_along(rank);
    for (size_t i = 0; i < rank; ++i) {
      const uint64_t side = layout.chunk[i];
      if (side == 0) damaged();
      // A chunk may reach beyond the array, but not be of another order of size than a file like this has.
      constexpr uint64_t kSmallChunk = uint64_t{1} << 22;
      if (side > std::max(most_, kSmallChunk) / chunk_elements) {
        fail({where_, "chunks of at most " + std::to_string(std::max(most_, kSmallChunk)) + " elements",
              "larger ones", "check that it is a file of this kind"});
      }
      chunk_elements *= side;
      chunks_along[i] = (extents[i] + side - 1) / side;
      chunks *= chunks_along[i];  // at most count
    }
    const size_t key_size = 8 + 8 * (rank + 1);
    // Few chunks reach far beyond the array; many that do would be hours of work.
    constexpr uint64_t kSmallExcess = uint64_t{1} << 24;
    if (chunks > (8 * count + kSmallExcess) / chunk_elements) damaged_data();
    // Every chunk must be there: each takes a key and an address in the file, which bounds what is allocated here.
    if (chunks > file_.size / (key_size + 8) || layout.address == kUndefined) damaged_data();
    check_expansion(filters, count);
    array_.values.resize(static_cast<size_t>(count));
    std::vector<bool> seen(static_cast<size_t>(chunks), false);
    uint64_t left = chunks;
    std::vector<uint8_t> unpacked;
    walk_tree(layout.address, 1, key_size, [&](const uint8_t* key, uint64_t address) {
      const auto size = load<uint32_t>(key), mask = load<uint32_t>(key + 4);
      std::vector<uint64_t> first(rank);
      uint64_t index = 0;
      for (size_t i = 0; i < rank; ++i) {
        first[i] = load<uint64_t>(key + 8 + 8 * i);
        if (first[i] >= extents[i] || first[i] % layout.chunk[i] != 0) damaged_data();
        index = index * chunks_along[i] + first[i] / layout.chunk[i];
      }
      if (seen[static_cast<size_t>(index)]) damaged_data();
      seen[static_cast<size_t>(index)] = true;
      --left;
      if (!undo_hdf5_filters({at(address, size), size}, mask, filters, elements_.size(),
                             chunk_elements * elements_.size(), unpacked)) {
        damaged_data();
      }
      place(unpacked, first, layout.chunk, extents);
    });
    if (left != 0) damaged_data();
  }

  // More elements than all bytes of the file could give are refused before memory is taken.
  void check_expansion(const std::vector<Hdf5Filter>& filters, uint64_t count) const {
    if (count * elements_.size() / largest_expansion(filters) > file_.size) damaged_data();
  }

  // Copies the part of a chunk that lies inside the array.
  void place(const std::vector<uint8_t>& chunk, const std::vector<uint64_t>& first,
             const std::vector<uint64_t>& chunk_sides, const std::vector<uint64_t>& extents) {
    const size_t rank = extents.size();
    std::vector<uint64_t> inside(rank), index(rank, 0);
    for (size_t i = 0; i < rank; ++i) inside[i] = std::min(chunk_sides[i], extents[i] - first[i]);
    while (true) {
      uint64_t from = 0, to = 0;
      for (size_t i = 0; i < rank; ++i) {
        from = from * chunk_sides[i] + index[i];
        to = to * extents[i] + first[i] + index[i];
      }
      floats_from(elements_, chunk.data() + from * elements_.size(), inside[rank - 1],
                  array_.values.data() + to);
      size_t axis = rank - 1;
      while (axis-- > 0) {
        if (++index[axis] < inside[axis]) break;
        index[axis] = 0;
      }
      if (axis == std::numeric_limits<size_t>::max()) return;
    }
  }

  ByteView file_;
  std::string dataset_;
  uint64_t most_;
  std::string where_;
  Hdf5Elements elements_;
  Hdf5Array array_;
  size_t nodes_seen_ = 0;
};

}  // namespace

Hdf5Array parse_hdf5_array(ByteView file, const std::string& dataset, int64_t most_elements,
                           const std::string& where) {
  return Hdf5Parser(file, dataset, most_elements, where).parse();
}

Hdf5Array read_hdf5_array(const std::filesystem::path& file, const std::string& dataset,
                          int64_t most_elements) {
  constexpr uint64_t kLargestFile = uint64_t{1} << 31;
  const std::string bytes = read_file(file, kLargestFile);
  return parse_hdf5_array({reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()}, dataset,
                          most_elements, file.string());
}

}  // namespace gld
