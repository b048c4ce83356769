#include "datasets/images/heif_file.h"

#include "gld/base/error.h"

#include <cstddef>
#include <memory>
#include <vector>

#include <libheif/heif.h>

namespace gld {
namespace {

using Context = std::unique_ptr<heif_context, void (*)(heif_context*)>;
using Handle = std::unique_ptr<heif_image_handle, void (*)(heif_image_handle*)>;
using DecodedPicture = std::unique_ptr<heif_image, void (*)(heif_image*)>;
using DecodingOptions = std::unique_ptr<heif_decoding_options, void (*)(heif_decoding_options*)>;

// libheif takes the side of a square.
constexpr int kSideOfMostPixels = 16384;
static_assert(int64_t{kSideOfMostPixels} * kSideOfMostPixels == kMostPixels);

void release_handle(heif_image_handle* handle) { heif_image_handle_release(handle); }
void release_picture(heif_image* picture) { heif_image_release(picture); }

void require(const heif_error& error, const std::string& where) {
  if (error.code == heif_error_Ok) return;
  if (error.subcode == heif_suberror_End_of_data) fail_short_image(where);
  fail({where, "an image that can be decoded", std::string("damaged data (libheif: ") + error.message + ")",
        "copy or download it again"});
}

struct OpenedHeif {
  Context context{nullptr, heif_context_free};
  Handle handle{nullptr, release_handle};
};

OpenedHeif open_heif(std::string_view bytes, const std::string& where) {
  OpenedHeif opened;
  opened.context.reset(heif_context_alloc());
  // So that no tile of a damaged file asks for more; the whole is compared below.
  heif_context_set_maximum_image_size_limit(opened.context.get(), kSideOfMostPixels);
  require(
      heif_context_read_from_memory_without_copy(opened.context.get(), bytes.data(), bytes.size(), nullptr),
      where);
  heif_image_handle* handle = nullptr;
  require(heif_context_get_primary_image_handle(opened.context.get(), &handle), where);
  opened.handle.reset(handle);
  check_compressed_picture_size(heif_image_handle_get_width(handle), heif_image_handle_get_height(handle),
                                bytes.size(), where);
  return opened;
}

// A block of metadata begins with where, behind these four bytes, its TIFF structure is. A block that is damaged counts
// as none.
std::string exif_of(const heif_image_handle& handle) {
  heif_item_id id = 0;
  if (heif_image_handle_get_list_of_metadata_block_IDs(&handle, "Exif", &id, 1) != 1) return {};
  std::vector<uint8_t> block(heif_image_handle_get_metadata_size(&handle, id));
  if (block.size() < 4 || heif_image_handle_get_metadata(&handle, id, block.data()).code != heif_error_Ok)
    return {};
  size_t start = 0;
  for (size_t i = 0; i < 4; ++i) start = start << 8 | block[i];
  if (start > block.size() - 4) return {};
  return std::string(kExifStart) +
         std::string(block.begin() + 4 + static_cast<std::ptrdiff_t>(start), block.end());
}

}  // namespace

HeifHeader read_heif_header(std::string_view bytes, const std::string& where) {
  const OpenedHeif opened = open_heif(bytes, where);
  HeifHeader header;
  header.width = heif_image_handle_get_width(opened.handle.get());
  header.height = heif_image_handle_get_height(opened.handle.get());
  header.exif = exif_of(*opened.handle);
  return header;
}

DecodedPixels decode_heif(std::string_view bytes, const std::string& where) {
  const OpenedHeif opened = open_heif(bytes, where);
  const DecodingOptions options(heif_decoding_options_alloc(), heif_decoding_options_free);
  options->convert_hdr_to_8bit = 1;
  DecodedPixels pixels;
  pixels.channels = heif_image_handle_has_alpha_channel(opened.handle.get()) != 0 ? 4 : 3;
  heif_image* decoded = nullptr;
  require(heif_decode_image(opened.handle.get(), &decoded, heif_colorspace_RGB,
                            pixels.channels == 4 ? heif_chroma_interleaved_RGBA : heif_chroma_interleaved_RGB,
                            options.get()),
          where);
  const DecodedPicture picture(decoded, release_picture);
  int stride = 0;
  const uint8_t* rows = heif_image_get_plane_readonly(decoded, heif_channel_interleaved, &stride);
  pixels.width = heif_image_get_width(decoded, heif_channel_interleaved);
  pixels.height = heif_image_get_height(decoded, heif_channel_interleaved);
  check_picture_size(pixels.width, pixels.height, where);
  if (rows == nullptr || stride < pixels.width * pixels.channels) {
    fail({where, "an image that can be decoded", "pixels of another kind", "convert it"});
  }
  const auto row_bytes = static_cast<size_t>(pixels.width * pixels.channels);
  pixels.bytes.resize(row_bytes * static_cast<size_t>(pixels.height));
  for (int64_t y = 0; y < pixels.height; ++y) {
    const uint8_t* from = rows + y * stride;
    uint8_t* to = pixels.bytes.data() + static_cast<size_t>(y) * row_bytes;
    for (size_t i = 0; i < row_bytes; i += static_cast<size_t>(pixels.channels)) {
      to[i] = from[i + 2];  // red, green, blue there
      to[i + 1] = from[i + 1];
      to[i + 2] = from[i];
      if (pixels.channels == 4) to[i + 3] = from[i + 3];
    }
  }
  return pixels;
}

}  // namespace gld
