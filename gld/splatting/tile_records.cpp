#include "gld/splatting/tile_records.h"

#include <algorithm>
#include <cmath>

namespace gld {
namespace {

// Holds a value within the columns of a tile and one to either side; it is -1 of what is no number.
double held_in_tile(double value) {
  return value > -1 ? std::min(value, static_cast<double>(kSplatTile)) : -1;
}

// std::ceil and std::floor of it, without a call.
int ceiling_in_tile(double value) {
  const double held = held_in_tile(value);
  const int whole = static_cast<int>(held);
  return whole + static_cast<int>(static_cast<double>(whole) < held);
}
int floor_in_tile(double value) {
  const double held = held_in_tile(value);
  const int whole = static_cast<int>(held);
  return whole - static_cast<int>(static_cast<double>(whole) > held);
}

}  // namespace

void list_records(const SplatView& view, const ListedTile& tile, RecordScratch& scratch,
                  TileRecords& records) {
  const int64_t left = view.tile_left(tile.number), top = view.tile_top(tile.number);
  const int64_t strips_a_row = kSplatTile / tile.strip, strips = kSplatTile * strips_a_row;
  const int32_t* const begin = view.tile_splats.data() + view.tile_first[static_cast<size_t>(tile.number)];
  const int64_t splats = view.tile_first[static_cast<size_t>(tile.number) + 1] -
                         view.tile_first[static_cast<size_t>(tile.number)];
  const auto most = static_cast<size_t>(splats * strips);
  if (scratch.rows.size() < most) {
    scratch.rows.resize(most);
    scratch.strip_of.resize(most);
    scratch.pixel.resize(most);
    scratch.feature_row.resize(most);
  }
  size_t count = 0;
  records.first_record.resize(static_cast<size_t>(splats) + 1);
  records.first_record[0] = 0;
  records.strip_first.assign(static_cast<size_t>(strips) + 1, 0);
  for (int64_t j = 0; j < splats; ++j) {
    if (j + kFetchedAhead < splats) fetch(view.splats[static_cast<size_t>(begin[j + kFetchedAhead])]);
    const int32_t number = begin[j];
    const VisibleSplat& splat = view.splats[static_cast<size_t>(number)];
    const int64_t first_row = std::max<int64_t>(splat.first_row, top),
                  end_row = std::min<int64_t>(splat.end_row, top + kSplatTile);
    const auto first_column = static_cast<int>(std::max<int64_t>(splat.first_column, left) - left),
               last_column =
                   static_cast<int>(std::min<int64_t>(splat.end_column, left + kSplatTile) - 1 - left);
    const int32_t feature_row = tile.by_index ? splat.index : number;
    const double begin_x = static_cast<double>(left) + 0.5 - splat.mean[0], inverse = 1 / splat.along_x;
    for (int64_t y = first_row; y < end_row; ++y) {
      const double dy = static_cast<double>(y) + 0.5 - splat.mean[1], across = splat.across_y * dy;
      const double height = splat.height - across * across;
      const double room = height - static_cast<double>(view.camera.least_alpha_power);
      if (room < 0) continue;
      // u of the tile's first pixel, and the pixels from it for which u^2 <= room.
      const double shift = splat.along_x * begin_x + splat.along_y * dy;
      // A pixel that the kernel's rounding lets in is listed: it decides.
      const double reach = std::sqrt(room) * (1 + 1e-5) + 1e-5;
      const int first = std::max(first_column, ceiling_in_tile((-reach - shift) * inverse)),
                last = std::min(last_column, floor_in_tile((reach - shift) * inverse));
      if (first > last) continue;
      const int side = static_cast<int>(tile.strip);
      for (int strip = first / side; strip <= last / side; ++strip) {
        scratch.rows[count] = {static_cast<float>(splat.along_x),
                               static_cast<float>(shift + splat.along_x * static_cast<double>(strip * side)),
                               static_cast<float>(height), static_cast<float>(across)};
        const int64_t which = (y - top) * strips_a_row + strip;
        scratch.strip_of[count] = static_cast<int16_t>(which);
        ++records.strip_first[static_cast<size_t>(which) + 1];
        scratch.pixel[count] = y * tile.stride + left + strip * side;
        scratch.feature_row[count] = feature_row;
        ++count;
      }
    }
    records.first_record[static_cast<size_t>(j) + 1] = static_cast<int32_t>(count);
  }
  for (size_t strip = 0; strip + 1 < records.strip_first.size(); ++strip)
    records.strip_first[strip + 1] += records.strip_first[strip];
  const auto end = static_cast<int64_t>(count);
  records.rows.assign(scratch.rows.begin(), scratch.rows.begin() + end);
  records.pixel.assign(scratch.pixel.begin(), scratch.pixel.begin() + end);
  records.strip_records.resize(count);
  records.strip_rows.resize(count);
  int32_t next[kSplatTile * kSplatTile];
  std::copy(records.strip_first.begin(), records.strip_first.end() - 1, next);
  for (size_t r = 0; r < count; ++r) {
    const auto place = static_cast<size_t>(next[scratch.strip_of[r]]++);
    records.strip_records[place] = static_cast<int32_t>(r);
    records.strip_rows[place] = scratch.feature_row[r];
  }
}

}  // namespace gld
