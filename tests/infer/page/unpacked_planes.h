#pragma once

#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <zlib.h>

namespace gld::test {

// The planes of a cloud or of Gaussians in a page, taken apart as docs/PAGE.md says, without the writer's code.
class UnpackedPlanes {
 public:
  // bytes_each is all that one of them has.
  UnpackedPlanes(const nlohmann::ordered_json& json, size_t bytes_each)
      : json_(json), count_(json.at("count").get<size_t>()), bytes_(bytes_each * count_) {
    const auto text = json.at("bytes").get<std::string>();
    std::string packed;
    for (size_t i = 0; i < text.size(); i += 4) {
      uint32_t four = 0;
      for (size_t k = 0; k < 4; ++k) four = four << 6 | (text[i + k] == '=' ? 0 : value_of(text[i + k]));
      for (int shift = 16; shift >= 0; shift -= 8) packed.push_back(static_cast<char>(four >> shift & 255));
    }
    uLongf size = bytes_.size();
    EXPECT_EQ(uncompress(bytes_.data(), &size, reinterpret_cast<const Bytef*>(packed.data()), packed.size()),
              Z_OK);
    EXPECT_EQ(size, bytes_.size());
  }

  // Returns the next three planes of 16 bits.
  std::vector<Eigen::Vector3d> points() {
    std::vector<Eigen::Vector3d> points(count_);
    for (int axis = 0; axis < 3; ++axis, at_ += 2 * count_) {
      int value = 0;
      for (size_t i = 0; i < count_; ++i) {
        const int folded = bytes_[at_ + i] + 256 * bytes_[at_ + count_ + i];
        value = (value + (folded % 2 == 1 ? -(folded + 1) / 2 : folded / 2) + 65536) % 65536;
        points[i][axis] = json_.at("low")[axis].get<double>() + json_.at("step")[axis].get<double>() * value;
      }
    }
    return points;
  }

  // Returns the next plane of 8 bits.
  std::vector<uint8_t> plane() {
    std::vector<uint8_t> values(count_);
    uint8_t value = 0;
    for (size_t i = 0; i < count_; ++i) values[i] = value = static_cast<uint8_t>(value + bytes_[at_ + i]);
    at_ += count_;
    return values;
  }

 private:
  static uint8_t value_of(char digit) {
    const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    return static_cast<uint8_t>(digits.find(digit));
  }

  nlohmann::ordered_json json_;
  size_t count_, at_ = 0;
  std::vector<uint8_t> bytes_;
};

}  // namespace gld::test
