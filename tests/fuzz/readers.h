#pragma once

#include <cstddef>
#include <cstdint>

namespace gld::test {

// Each reads the bytes as a file of that kind and then touches every element. gld::Error is the only way to refuse.
void read_as_safetensors(const uint8_t* data, size_t size);
void read_as_torch_archive(const uint8_t* data, size_t size);  // zip or legacy, by the first byte
void read_as_npy(const uint8_t* data, size_t size);            // npy or npz, by the first byte
void read_as_hdf5(const uint8_t* data, size_t size);           // a dataset "dataset" of any rank
void read_as_json(const uint8_t* data, size_t size);           // JSON, then cameras.json, then options
void read_as_yaml(const uint8_t* data, size_t size);           // options of every kind
void read_as_image(const uint8_t* data, size_t size);          // of every format, with its EXIF metadata
void read_as_colmap(const uint8_t* data,
                    size_t size);  // by the first byte: cameras, images or points, binary or text
void read_as_re10k(const uint8_t* data, size_t size);    // the rows of a camera file
void read_as_ffprobe(const uint8_t* data, size_t size);  // what the program ffprobe says of a video

}  // namespace gld::test
