#pragma once

#include "gld/base/mapped_file.h"

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace gld {

enum class ZipMethod { kStored, kDeflated };

struct ZipEntry {
  std::string name;
  ZipMethod method = ZipMethod::kStored;
  uint32_t checksum = 0;  // CRC-32 of the uncompressed bytes
  uint64_t size = 0;      // uncompressed
  ByteView packed;        // the bytes in the file
};

// A zip or zip64 file seen in memory. Entries may be stored or deflated; anything that does not fit the file,
// overlaps another entry, appears twice, is encrypted or uses another method is refused when the file is
// opened.
class ZipArchive {
 public:
  static std::shared_ptr<const ZipArchive> open(const std::filesystem::path& file);
  // `where` names the file in errors; `file` must outlive the archive.
  static std::shared_ptr<const ZipArchive> parse(ByteView file, const std::string& where);

  const std::vector<ZipEntry>& entries() const { return entries_; }  // sorted by name
  const ZipEntry* find(const std::string& name) const;               // null when absent

  // Returns the uncompressed bytes, checked against size and CRC-32. Memory grows only with what was really
  // decompressed.
  std::vector<uint8_t> read(const ZipEntry& entry) const;

  // Compares the bytes of a stored entry with their CRC-32; throws Error where they differ. It is for who uses `packed`
  // as it is.
  void check(const ZipEntry& entry) const;

 private:
  ZipArchive() = default;
  std::string where_;
  std::vector<ZipEntry> entries_;
  std::shared_ptr<const MappedFile> mapping_;  // null when the caller owns the bytes
};

// Writes the entries in name order with fixed times, so that equal contents give equal bytes; the file is at most
// 4 GiB. Writing is atomic.
void write_zip(const std::filesystem::path& file, const std::map<std::string, std::string>& entries,
               ZipMethod method);
std::string zip_text(const std::map<std::string, std::string>& entries, ZipMethod method,
                     const std::string& where);

}  // namespace gld
