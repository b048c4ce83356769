#include "gld/files/safetensors.h"

#include "gld/base/atomic_file.h"
#include "gld/files/weight_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/pickle_text.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/text_view.h"

#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::float_bytes;
using test::safetensors_text;
using test::view_of_text;
using testing::ElementsAre;

std::string safetensors_refusal(const std::string& text) {
  return error_of([&] { parse_safetensors(view_of_text(text), "w.safetensors"); });
}

const std::string kOneTensor = R"({"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})";

TEST(Safetensors, ReadsTensorsMetadataAndPadding) {
  const std::string header =
      R"({"__metadata__":{"format":"pt"},"b":{"dtype":"I64","shape":[],"data_offsets":[8,16]},)"
      R"("a":{"shape":[1,2],"data_offsets":[0,8],"dtype":"F32"},"none":{"dtype":"BF16","shape":[0,3],)"
      R"("data_offsets":[16,16]}}   )";
  const std::string text =
      safetensors_text(header, float_bytes({1.5F, -2.0F}) + std::string("\x07\0\0\0\0\0\0\0", 8));
  const auto parsed = parse_safetensors(view_of_text(text), "w.safetensors");
  ASSERT_EQ(parsed.entries.size(), 3U);
  EXPECT_EQ(parsed.entries[0].name, "a");
  EXPECT_EQ(parsed.entries[0].dtype, DType::kFloat32);
  EXPECT_THAT(parsed.entries[0].shape, ElementsAre(1, 2));
  float second = 0;
  std::memcpy(&second, parsed.entries[0].data + 4, 4);
  EXPECT_EQ(second, -2.0F);
  EXPECT_EQ(parsed.entries[1].name, "b");
  EXPECT_EQ(parsed.entries[1].element_count(), 1);
  EXPECT_EQ(*parsed.entries[1].data, 7);
  EXPECT_EQ(parsed.entries[2].element_count(), 0);
  EXPECT_EQ(parsed.metadata.at("format"), "pt");
}

TEST(Safetensors, EveryDtypeHasItsSize) {
  const std::vector<std::pair<std::string, int64_t>> sizes = {
      {"F64", 8}, {"F32", 4}, {"F16", 2}, {"BF16", 2}, {"I64", 8}, {"I32", 4}, {"I16", 2},
      {"I8", 1},  {"U64", 8}, {"U32", 4}, {"U16", 2},  {"U8", 1},  {"BOOL", 1}};
  for (const auto& [code, size] : sizes) {
    const std::string text =
        safetensors_text(R"({"a":{"dtype":")" + code + R"(","shape":[3],"data_offsets":[0,)" +
                             std::to_string(3 * size) + "]}}",
                         std::string(static_cast<size_t>(3 * size), '\0'));
    EXPECT_EQ(parse_safetensors(view_of_text(text), "w").entries[0].byte_count(), 3 * size) << code;
  }
}

TEST(Safetensors, HeaderThatIsWrittenIsRead) {
  TensorEntry wide, narrow;
  wide.name = "w\"ide";
  wide.dtype = DType::kFloat32;
  wide.shape = {2, 1};
  narrow.name = "narrow";
  narrow.dtype = DType::kInt8;
  narrow.shape = {3};
  const std::string text = safetensors_header({wide, narrow}, {{"key", "value"}}) + float_bytes({1, 2}) +
                           std::string("\x01\x02\x03");
  EXPECT_EQ((text.size() - 11) % 64, 0U) << "the data starts at a multiple of 64 bytes";
  const auto parsed = parse_safetensors(view_of_text(text), "w");
  EXPECT_EQ(parsed.entries[0].name, "narrow");
  EXPECT_EQ(parsed.entries[0].data[2], 3);
  EXPECT_EQ(parsed.entries[1].name, "w\"ide");
  EXPECT_EQ(parsed.metadata.at("key"), "value");
  EXPECT_EQ(error_of([&] {
              safetensors_header({wide, wide}, {});
            }),
            "safetensors file: tensor w\"ide: expected a name of its own, found a name already taken; "
            "rename the tensor.");
}

TEST(Safetensors, RefusesBrokenLengths) {
  EXPECT_EQ(safetensors_refusal(""),
            "w.safetensors: expected a safetensors file, found only 0 bytes; get the file again.");
  EXPECT_EQ(safetensors_refusal("1234567"),
            "w.safetensors: expected a safetensors file, found only 7 bytes; get the file again.");
  EXPECT_EQ(safetensors_refusal(std::string(7, '\xff') + '\x7f' + "{}"),
            "w.safetensors: expected a header within the file's 10 bytes, "
            "found a header length of 9223372036854775807; get the file again, it may be cut short.");
  EXPECT_EQ(safetensors_refusal(safetensors_text(kOneTensor, "").substr(0, 20)),
            "w.safetensors: expected a header within the file's 20 bytes, found a header length of 54; "
            "get the file again, it may be cut short.");
}

TEST(Safetensors, RefusesAHugeHeader) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "w.safetensors";
  std::ofstream(file, std::ios::binary) << safetensors_text(kOneTensor, "").substr(0, 40);
  // A sparse file of 200 MB whose header claims all of it.
  const uint64_t length = 199'999'992;
  std::fstream(file, std::ios::binary | std::ios::in | std::ios::out)
      .write(reinterpret_cast<const char*>(&length), sizeof length);
  std::filesystem::resize_file(file, 200'000'000);
  EXPECT_EQ(error_of([&] { WeightFile::open(file); }),
            file.string() +
                ": expected a header of at most 100000000 bytes, found 199999992 bytes; "
                "download or write the file again.");
}

struct HostileHeader {
  const char* title;
  std::string header;
  std::string data;
  std::string sentence;
};

TEST(Safetensors, RefusesHostileHeaders) {
  const std::string again = "; download or write the file again.";
  const std::string tensor = "w.safetensors: tensor a: ";
  const std::string fields =
      tensor + "expected dtype, shape and data_offsets (non-negative integers), found ";
  const auto one = [](const std::string& inner) { return R"({"a":{)" + inner + "}}"; };
  const std::vector<HostileHeader> corpus = {
      {"empty header", "", "",
       "w.safetensors: expected a JSON header, found broken JSON at byte 1 of the header" + again},
      {"not an object", "[]", "",
       "w.safetensors: expected a JSON object as the header, found a list" + again},
      {"cut JSON", R"({"a":{"dtype":)", "",
       "w.safetensors: expected a JSON header, found broken JSON at byte 15 of the header" + again},
      {"something behind the header", kOneTensor + "{}", "12345678",
       "w.safetensors: expected a JSON header, found broken JSON at byte 55 of the header" + again},
      {"deep nesting", R"({"a":)" + std::string(100000, '['), "",
       tensor + "expected an object with dtype, shape and data_offsets, found a list" + again},
      {"deep objects", R"({"a":{"dtype":{"x":{"x":{"x":1}}}}})", "", fields + "an object" + again},
      {"list in a list", one(R"("dtype":"F32","shape":[[2]],"data_offsets":[0,8])"), "12345678",
       fields + "a list" + again},
      {"unknown key", one(R"("dtype":"F32","shape":[2],"data_offsets":[0,8],"code":1)"), "12345678",
       fields + "the key code" + again},
      {"missing key", one(R"("dtype":"F32","shape":[2])"), "12345678",
       fields + "one of them missing" + again},
      {"key twice", one(R"("dtype":"F32","shape":[2],"shape":[2],"data_offsets":[0,8])"), "12345678",
       fields + "the key shape twice" + again},
      {"negative size", one(R"("dtype":"F32","shape":[-2],"data_offsets":[0,8])"), "12345678",
       fields + "a negative number" + again},
      {"fractional size", one(R"("dtype":"F32","shape":[2.0],"data_offsets":[0,8])"), "12345678",
       fields + "a fractional number" + again},
      {"null", one(R"("dtype":null)"), "", fields + "null" + again},
      {"boolean", one(R"("dtype":"F32","shape":[true])"), "", fields + "a boolean" + again},
      {"number as dtype", one(R"("dtype":3)"), "", fields + "a number" + again},
      {"65 dimensions",
       one(R"("dtype":"F32","shape":[1)" +
           [] {
             std::string ones;
             for (int i = 0; i < 64; ++i) ones += ",1";
             return ones;
           }() +
           R"(],"data_offsets":[0,4])"),
       "1234", fields + "more than 64 numbers" + again},
      {"unknown dtype", one(R"("dtype":"F8_E4M3","shape":[2],"data_offsets":[0,2])"), "12",
       tensor + "expected a dtype among F64, F32, F16, BF16, I64, I32, I16, I8, U64, U32, U16, U8, BOOL, "
                "found F8_E4M3; convert the tensor to one of these."},
      {"overflow", one(R"("dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,0])"), "",
       tensor + "expected a shape whose size fits 63 bits, found sizes that overflow" + again},
      {"size beyond int64", one(R"("dtype":"F32","shape":[18446744073709551615],"data_offsets":[0,0])"), "",
       tensor + "expected a shape whose size fits 63 bits, found sizes that overflow" + again},
      {"overflow hidden by zero",
       one(R"("dtype":"F32","shape":[4294967296,4294967296,0],"data_offsets":[0,0])"), "",
       tensor + "expected a shape whose size fits 63 bits, found sizes that overflow" + again},
      {"beyond the file", one(R"("dtype":"F32","shape":[2],"data_offsets":[4,12])"), "12345678",
       tensor + "expected data_offsets within the 8 data bytes of the file, found [4, 12]; "
                "get the file again, it may be cut short."},
      {"one byte beyond the file", one(R"("dtype":"U8","shape":[8],"data_offsets":[1,9])"), "12345678",
       tensor + "expected data_offsets within the 8 data bytes of the file, found [1, 9]; "
                "get the file again, it may be cut short."},
      {"reversed", one(R"("dtype":"F32","shape":[2],"data_offsets":[8,0])"), "12345678",
       tensor + "expected data_offsets within the 8 data bytes of the file, found [8, 0]; "
                "get the file again, it may be cut short."},
      {"one offset", one(R"("dtype":"F32","shape":[2],"data_offsets":[0])"), "12345678",
       tensor + "expected data_offsets within the 8 data bytes of the file, found [0]; "
                "get the file again, it may be cut short."},
      {"bytes and shape disagree", one(R"("dtype":"F32","shape":[3],"data_offsets":[0,8])"), "12345678",
       tensor + "expected 12 bytes for shape (3) in float32, found 8 bytes between its data_offsets" + again},
      {"bytes and dtype disagree", one(R"("dtype":"F16","shape":[2],"data_offsets":[0,8])"), "12345678",
       tensor + "expected 4 bytes for shape (2) in float16, found 8 bytes between its data_offsets" + again},
      {"overlap",
       R"({"a":{"dtype":"U8","shape":[6],"data_offsets":[0,6]},"b":{"dtype":"U8","shape":[4],"data_offsets":[4,8]}})",
       "12345678",
       "w.safetensors: tensor b: expected data of its own, found an overlap with tensor a" + again},
      {"hole",
       R"({"a":{"dtype":"U8","shape":[2],"data_offsets":[0,2]},"b":{"dtype":"U8","shape":[4],"data_offsets":[4,8]}})",
       "12345678",
       "w.safetensors: tensor b: expected data right after the tensor before it, found a hole of 2 bytes" +
           again},
      {"bytes left over", kOneTensor, "123456789",
       "w.safetensors: expected the tensors to fill the file, found 1 bytes after the last tensor" + again},
      {"name twice",
       R"({"a":{"dtype":"U8","shape":[4],"data_offsets":[0,4]},"a":{"dtype":"U8","shape":[4],"data_offsets":[4,8]}})",
       "12345678",
       tensor + "expected each name once, found the name twice; write the file again with distinct names."},
      {"metadata that is no string", R"({"__metadata__":{"k":1}})", "",
       "w.safetensors: __metadata__: expected only strings, found a number; "
       "write the file again with string metadata."},
      {"nested metadata", R"({"__metadata__":{"k":{}}})", "",
       "w.safetensors: __metadata__: expected only strings, found an object; "
       "write the file again with string metadata."},
      {"control characters in a name", "{\"x\\u0007\\n\":1}", "",
       "w.safetensors: tensor x\\x07\\n: expected an object with dtype, shape and data_offsets, found a number" +
           again},
  };
  for (const auto& hostile : corpus) {
    EXPECT_EQ(safetensors_refusal(safetensors_text(hostile.header, hostile.data)), hostile.sentence)
        << hostile.title;
  }
}

TEST(Safetensors, EveryTruncationOfARealFileIsRefused) {
  const std::string whole = read_file(test::test_data() / "reference_cases/dit_level1/inputs.safetensors");
  ASSERT_GT(parse_safetensors(view_of_text(whole), "w").entries.size(), 3U);
  for (size_t size = 0; size < whole.size(); size += 1 + size / 7) {
    EXPECT_FALSE(safetensors_refusal(whole.substr(0, size)).empty()) << size;
  }
  EXPECT_FALSE(safetensors_refusal(whole.substr(0, whole.size() - 1)).empty());
}

TEST(WeightFile, NamesASimilarTensor) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "w.safetensors";
  write_file_atomically(
      file,
      safetensors_text(R"({"block.weight":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}})", "12345678"));
  const auto weights = WeightFile::open(file);
  EXPECT_EQ(weights->format(), "safetensors");
  EXPECT_EQ(weights->find("block.bias"), nullptr);
  EXPECT_EQ(error_of([&] { weights->entry("block.wieght"); }),
            file.string() + ": expected a tensor named block.wieght, found none; did you mean block.weight?");
}

TEST(WeightFile, RefusesOtherFiles) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "w.bin";
  EXPECT_EQ(error_of([&] { WeightFile::open(file); }),
            file.string() + ": expected a readable file, found No such file or directory; check the path.");
  EXPECT_EQ(error_of([&] { WeightFile::open(folder.path()); }),
            folder.path().string() + ": expected a readable file, found a folder; check the path.");
  for (const char* content : {"", "version https://git-lfs.github.com/spec/v1\n", "<!DOCTYPE html><html>"}) {
    write_file_atomically(file, content);
    EXPECT_EQ(error_of([&] { WeightFile::open(file); }),
              file.string() +
                  ": expected a safetensors or PyTorch file, found neither by its first bytes; "
                  "check that the download is complete and is not a web page or a Git LFS pointer.");
  }
}

}  // namespace
}  // namespace gld
