#pragma once

#include "gld/kernels/kernel_table.h"
#include "gld/splatting/splat_view.h"

#include <cstdint>
#include <vector>

namespace gld {

// Which Gaussians of a view reach which strips (KernelTable::splat_strip pixels of a row) of a tile. Records are those
// of one Gaussian after another; lists by strip are front to back, since the Gaussians are.
struct TileRecords {
  std::vector<SplatRow> rows;          // (records)
  std::vector<int64_t> pixel;          // (records) offset of the strip in a plane
  std::vector<int32_t> first_record;   // (Gaussians + 1)
  std::vector<int32_t> strip_first;    // (strips + 1)
  std::vector<int32_t> strip_records;  // (records) numbers of rows
  std::vector<int32_t> strip_rows;     // (records) rows of features of their Gaussians

  size_t size() const { return rows.size(); }
};

// What a thread needs to list; its arrays are as long as any tile before needed.
struct RecordScratch {
  std::vector<SplatRow> rows;
  std::vector<int16_t> strip_of;
  std::vector<int64_t> pixel;
  std::vector<int32_t> feature_row;
};

struct ListedTile {
  int64_t number;  // of the view's tiles
  int64_t strip;   // pixels, a divisor of kSplatTile
  int64_t stride;  // of a plane's rows, in pixels
  bool by_index;   // rows of features are the set's Gaussians; else the view's splats
};
void list_records(const SplatView& view, const ListedTile& tile, RecordScratch& scratch,
                  TileRecords& records);

}  // namespace gld
