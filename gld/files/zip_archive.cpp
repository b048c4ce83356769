#include "gld/files/zip_archive.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/files/weight_file.h"

#include <algorithm>
#include <cstring>
#include <limits>

#include <zlib.h>

namespace gld {
namespace {

constexpr uint32_t kLocalSignature = 0x04034b50;
constexpr uint32_t kDirectorySignature = 0x02014b50;
constexpr uint32_t kEndSignature = 0x06054b50;
constexpr uint32_t kEnd64Signature = 0x06064b50;
constexpr uint32_t kLocator64Signature = 0x07064b50;
constexpr size_t kLocalSize = 30;
constexpr size_t kDirectorySize = 46;
constexpr size_t kEndSize = 22;
constexpr size_t kEnd64Size = 56;
constexpr size_t kLocator64Size = 20;
constexpr size_t kLongestComment = 65535;
constexpr uint16_t kStoredMethod = 0;
constexpr uint16_t kDeflatedMethod = 8;
constexpr uint16_t kEncryptedFlag = 1;
constexpr uint16_t kUtf8Flag = 0x800;
constexpr uint32_t kIn64 = 0xffffffff;  // "the value is in the zip64 field"
constexpr uint16_t kVersionNeeded = 20;
constexpr uint16_t kFixedDate = 0x21;  // 1980-01-01
// Deflate cannot shrink data more than this (RFC 1951: 258 bytes in 2 bits).
constexpr uint64_t kLargestDeflateRatio = 1032;
constexpr size_t kFirstChunk = 1 << 16;

template <class T>
T load(const uint8_t* at) {
  T value;
  std::memcpy(&value, at, sizeof value);
  return value;
}

[[noreturn]] void fail_broken_zip(const std::string& where, const std::string& found) {
  fail({where, "a whole zip file", found, "download or write the file again"});
}

// Returns a position inside the file from which `size` bytes can be read.
const uint8_t* at(ByteView file, uint64_t offset, uint64_t size, const std::string& where, const char* what) {
  if (offset > file.size || size > file.size - offset) {
    fail_broken_zip(where, std::string(what) + " beyond the end of the file");
  }
  return file.data + offset;
}

struct Directory {
  uint64_t offset = 0;
  uint64_t size = 0;
  uint64_t entries = 0;
};

Directory find_directory(ByteView file, const std::string& where) {
  if (file.size < kEndSize) fail_broken_zip(where, "only " + std::to_string(file.size) + " bytes");
  const size_t last = file.size - kEndSize;
  const size_t first = last > kLongestComment ? last - kLongestComment : 0;
  size_t end = last;
  while (load<uint32_t>(file.data + end) != kEndSignature) {
    if (end == first) fail_broken_zip(where, "no directory at its end");
    --end;
  }
  Directory directory;
  directory.entries = load<uint16_t>(file.data + end + 10);
  directory.size = load<uint32_t>(file.data + end + 12);
  directory.offset = load<uint32_t>(file.data + end + 16);
  if (end >= kLocator64Size && load<uint32_t>(file.data + end - kLocator64Size) == kLocator64Signature) {
    const auto position = load<uint64_t>(file.data + end - kLocator64Size + 8);
    const uint8_t* end64 = at(file, position, kEnd64Size, where, "a zip64 directory end");
    if (load<uint32_t>(end64) != kEnd64Signature) fail_broken_zip(where, "a broken zip64 directory end");
    directory.entries = load<uint64_t>(end64 + 32);
    directory.size = load<uint64_t>(end64 + 40);
    directory.offset = load<uint64_t>(end64 + 48);
  }
  at(file, directory.offset, directory.size, where, "a directory");
  if (directory.entries > directory.size / kDirectorySize)
    fail_broken_zip(where, "more entries than its directory holds");
  return directory;
}

struct Record {
  ZipEntry entry;
  uint64_t local_offset = 0;
  uint64_t packed_size = 0;
  uint64_t end = 0;  // of the packed bytes
};

// The zip64 extra field holds, in this order, those of the values that did not fit 32 bits.
void apply_zip64(Record& record, const uint8_t* extra, size_t size, const std::string& where) {
  size_t position = 0;
  while (size - position >= 4) {
    const auto tag = load<uint16_t>(extra + position);
    const size_t length = load<uint16_t>(extra + position + 2);
    position += 4;
    if (length > size - position) fail_broken_zip(where, "a broken extra field");
    if (tag == 1) {
      size_t used = 0;
      for (uint64_t* value : {&record.entry.size, &record.packed_size, &record.local_offset}) {
        if (*value != kIn64) continue;
        if (length - used < 8) fail_broken_zip(where, "a broken zip64 field");
        *value = load<uint64_t>(extra + position + used);
        used += 8;
      }
      return;
    }
    position += length;
  }
}

Record read_record(ByteView file, const uint8_t* header, size_t available, size_t& length,
                   const std::string& where) {
  if (available < kDirectorySize || load<uint32_t>(header) != kDirectorySignature) {
    fail_broken_zip(where, "a broken directory");
  }
  const size_t name_size = load<uint16_t>(header + 28), extra_size = load<uint16_t>(header + 30);
  length = kDirectorySize + name_size + extra_size + load<uint16_t>(header + 32);
  if (length > available) fail_broken_zip(where, "a broken directory");
  Record record;
  record.entry.name.assign(reinterpret_cast<const char*>(header + kDirectorySize), name_size);
  const std::string entry_where = where + ": entry " + printable_name(record.entry.name);
  const auto flags = load<uint16_t>(header + 8), method = load<uint16_t>(header + 10);
  if ((flags & kEncryptedFlag) != 0)
    fail({entry_where, "no encryption", "an encrypted entry", "decrypt the file"});
  if (method != kStoredMethod && method != kDeflatedMethod) {
    fail({entry_where, "a stored or deflated entry", "compression method " + std::to_string(method),
          "write the file again without it"});
  }
  record.entry.method = method == kStoredMethod ? ZipMethod::kStored : ZipMethod::kDeflated;
  record.entry.checksum = load<uint32_t>(header + 16);
  record.packed_size = load<uint32_t>(header + 20);
  record.entry.size = load<uint32_t>(header + 24);
  record.local_offset = load<uint32_t>(header + 42);
  apply_zip64(record, header + kDirectorySize + name_size, extra_size, entry_where);

  const uint8_t* local = at(file, record.local_offset, kLocalSize, entry_where, "a header");
  if (load<uint32_t>(local) != kLocalSignature)
    fail_broken_zip(entry_where, "no entry header where the directory points");
  const uint64_t data =
      record.local_offset + kLocalSize + load<uint16_t>(local + 26) + load<uint16_t>(local + 28);
  record.entry.packed = {at(file, data, record.packed_size, entry_where, "data"),
                         static_cast<size_t>(record.packed_size)};
  record.end = data + record.packed_size;
  if (record.entry.method == ZipMethod::kStored && record.entry.size != record.packed_size) {
    fail_broken_zip(entry_where, "a stored entry of two sizes");
  }
  if (record.entry.method == ZipMethod::kDeflated &&
      record.entry.size / kLargestDeflateRatio > record.packed_size) {
    fail_broken_zip(entry_where,
                    "a size that its " + std::to_string(record.packed_size) + " packed bytes cannot give");
  }
  return record;
}

std::vector<uint8_t> inflate_entry(const ZipEntry& entry, const std::string& where) {
  struct Stream : z_stream {
    Stream() : z_stream() {
      if (inflateInit2(this, -MAX_WBITS) != Z_OK) throw std::bad_alloc();
    }
    ~Stream() { inflateEnd(this); }
    Stream(const Stream&) = delete;
    Stream& operator=(const Stream&) = delete;
  } stream;
  std::vector<uint8_t> bytes;
  size_t consumed = 0, produced = 0;
  int status = Z_OK;
  while (status == Z_OK) {
    if (produced == bytes.size()) {
      if (produced > entry.size) fail_broken_zip(where, "more data than the entry's size");
      // One byte more than announced, so that an entry that is longer than it says is noticed.
      const uint64_t grown = std::max<uint64_t>(kFirstChunk, 2 * static_cast<uint64_t>(bytes.size()));
      bytes.resize(static_cast<size_t>(std::min(grown, entry.size + 1)));
    }
    constexpr size_t kMost = std::numeric_limits<uInt>::max();
    stream.next_in = const_cast<Bytef*>(entry.packed.data + consumed);
    stream.avail_in = static_cast<uInt>(std::min(kMost, entry.packed.size - consumed));
    stream.next_out = bytes.data() + produced;
    stream.avail_out = static_cast<uInt>(std::min(kMost, bytes.size() - produced));
    const size_t before_in = stream.avail_in, before_out = stream.avail_out;
    status = inflate(&stream, Z_NO_FLUSH);
    consumed += before_in - stream.avail_in;
    produced += before_out - stream.avail_out;
  }
  if (status != Z_STREAM_END || produced != entry.size) fail_broken_zip(where, "broken compressed data");
  bytes.resize(produced);
  return bytes;
}

uint32_t checksum_of(const uint8_t* data, size_t size) {
  return static_cast<uint32_t>(crc32_z(crc32_z(0, nullptr, 0), data, size));
}

std::string deflated(const std::string& bytes) {
  z_stream stream{};
  if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, -MAX_WBITS, MAX_MEM_LEVEL,
                   Z_DEFAULT_STRATEGY) != Z_OK) {
    throw std::bad_alloc();
  }
  std::string packed(deflateBound(&stream, bytes.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(packed.data());
  stream.avail_out = static_cast<uInt>(packed.size());
  deflate(&stream, Z_FINISH);
  packed.resize(stream.total_out);
  deflateEnd(&stream);
  return packed;
}

template <class T>
void put(std::string& text, T value) {
  text.append(reinterpret_cast<const char*>(&value), sizeof value);
}

}  // namespace

std::shared_ptr<const ZipArchive> ZipArchive::open(const std::filesystem::path& file) {
  auto mapping = MappedFile::open(file);
  auto archive = std::const_pointer_cast<ZipArchive>(parse(mapping->bytes(), file.string()));
  archive->mapping_ = std::move(mapping);
  return archive;
}

std::shared_ptr<const ZipArchive> ZipArchive::parse(ByteView file, const std::string& where) {
  const Directory directory = find_directory(file, where);
  std::vector<Record> records;
  uint64_t position = 0;
  for (uint64_t index = 0; index < directory.entries; ++index) {
    size_t length = 0;
    records.push_back(read_record(file, file.data + directory.offset + position,
                                  static_cast<size_t>(directory.size - position), length, where));
    position += length;
  }
  std::sort(records.begin(), records.end(),
            [](const Record& a, const Record& b) { return a.local_offset < b.local_offset; });
  for (size_t index = 1; index < records.size(); ++index) {
    if (records[index].local_offset < records[index - 1].end) {
      fail_broken_zip(where + ": entry " + printable_name(records[index].entry.name),
                      "an overlap with another entry");
    }
  }
  std::shared_ptr<ZipArchive> archive(new ZipArchive);
  archive->where_ = where;
  for (auto& record : records) archive->entries_.push_back(std::move(record.entry));
  std::sort(archive->entries_.begin(), archive->entries_.end(),
            [](const ZipEntry& a, const ZipEntry& b) { return a.name < b.name; });
  for (size_t index = 1; index < archive->entries_.size(); ++index) {
    if (archive->entries_[index].name == archive->entries_[index - 1].name) {
      fail_broken_zip(where + ": entry " + printable_name(archive->entries_[index].name), "the name twice");
    }
  }
  return archive;
}

const ZipEntry* ZipArchive::find(const std::string& name) const {
  const auto found =
      std::lower_bound(entries_.begin(), entries_.end(), name,
                       [](const ZipEntry& entry, const std::string& key) { return entry.name < key; });
  return found != entries_.end() && found->name == name ? &*found : nullptr;
}

void ZipArchive::check(const ZipEntry& entry) const {
  if (checksum_of(entry.packed.data, entry.packed.size) == entry.checksum) return;
  fail_broken_zip(where_ + ": entry " + printable_name(entry.name), "a wrong checksum");
}

std::vector<uint8_t> ZipArchive::read(const ZipEntry& entry) const {
  const std::string where = where_ + ": entry " + printable_name(entry.name);
  std::vector<uint8_t> bytes;
  if (entry.method == ZipMethod::kStored) {
    bytes.assign(entry.packed.data, entry.packed.data + entry.packed.size);
  } else {
    bytes = inflate_entry(entry, where);
  }
  if (checksum_of(bytes.data(), bytes.size()) != entry.checksum) fail_broken_zip(where, "a wrong checksum");
  return bytes;
}

std::string zip_text(const std::map<std::string, std::string>& entries, ZipMethod method,
                     const std::string& where) {
  std::string text, directory;
  for (const auto& [name, bytes] : entries) {
    const std::string packed = method == ZipMethod::kDeflated ? deflated(bytes) : bytes;
    if (text.size() + packed.size() + bytes.size() >= kIn64 || entries.size() >= 65535) {
      fail({where, "less than 4 GiB in a zip file", "more", "write the arrays into several files"});
    }
    const auto offset = static_cast<uint32_t>(text.size());
    std::string common;  // what local header and directory share
    put<uint16_t>(common, kVersionNeeded);
    put<uint16_t>(common, kUtf8Flag);
    put<uint16_t>(common, method == ZipMethod::kDeflated ? kDeflatedMethod : kStoredMethod);
    put<uint16_t>(common, 0);  // time
    put<uint16_t>(common, kFixedDate);
    put<uint32_t>(common, checksum_of(reinterpret_cast<const uint8_t*>(bytes.data()), bytes.size()));
    put<uint32_t>(common, static_cast<uint32_t>(packed.size()));
    put<uint32_t>(common, static_cast<uint32_t>(bytes.size()));
    put<uint16_t>(common, static_cast<uint16_t>(name.size()));
    put<uint16_t>(common, 0);  // extra field
    put<uint32_t>(text, kLocalSignature);
    text += common;
    text += name;
    text += packed;
    put<uint32_t>(directory, kDirectorySignature);
    put<uint16_t>(directory, kVersionNeeded);
    directory += common;
    put<uint16_t>(directory, 0);  // comment
    put<uint16_t>(directory, 0);  // disk
    put<uint16_t>(directory, 0);  // internal attributes
    put<uint32_t>(directory, 0);  // external attributes
    put<uint32_t>(directory, offset);
    directory += name;
  }
  const auto offset = static_cast<uint32_t>(text.size());
  text += directory;
  put<uint32_t>(text, kEndSignature);
  put<uint16_t>(text, 0);  // this disk
  put<uint16_t>(text, 0);  // the directory's disk
  put<uint16_t>(text, static_cast<uint16_t>(entries.size()));
  put<uint16_t>(text, static_cast<uint16_t>(entries.size()));
  put<uint32_t>(text, static_cast<uint32_t>(directory.size()));
  put<uint32_t>(text, offset);
  put<uint16_t>(text, 0);  // comment
  return text;
}

void write_zip(const std::filesystem::path& file, const std::map<std::string, std::string>& entries,
               ZipMethod method) {
  write_file_atomically(file, zip_text(entries, method, file.string()));
}

}  // namespace gld
