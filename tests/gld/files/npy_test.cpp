#include "gld/files/npy.h"

#include "gld/base/atomic_file.h"
#include "gld/files/zip_archive.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/temporary_folder.h"
#include "tests/support/text_view.h"

#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::view_of_text;
using testing::ElementsAre;

std::string npy(const std::string& header, const std::string& data, int version = 1) {
  std::string text = "\x93NUMPY";
  text += static_cast<char>(version);
  text += '\0';
  const auto length = static_cast<uint32_t>(header.size());
  text.append(reinterpret_cast<const char*>(&length), version == 1 ? 2 : 4);
  return text + header + data;
}

std::string header_of(const std::string& descr, const std::string& order, const std::string& shape) {
  return "{'descr': '" + descr + "', 'fortran_order': " + order + ", 'shape': " + shape + ", }   \n";
}

template <class T>
std::string bytes_of(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

std::string npy_refusal(const std::string& text) {
  return error_of([&] { parse_npy(view_of_text(text), "a.npy"); });
}

TEST(Npy, ReadsEveryVersionDtypeAndOrder) {
  for (int version = 1; version <= 3; ++version) {
    const auto array = parse_npy(
        view_of_text(npy(header_of("<f4", "False", "(2, 3)"), bytes_of<float>({1, 2, 3, 4, 5, 6}), version)),
        "a");
    EXPECT_THAT(array.shape, ElementsAre(2, 3));
    EXPECT_THAT(array.to_doubles(), ElementsAre(1, 2, 3, 4, 5, 6));
  }
  const auto fortran = parse_npy(
      view_of_text(npy(header_of("<f8", "True", "(2, 3)"), bytes_of<double>({1, 4, 2, 5, 3, 6}))), "a");
  EXPECT_THAT(fortran.to_floats(), ElementsAre(1, 2, 3, 4, 5, 6));
  const auto swapped =
      parse_npy(view_of_text(npy(header_of(">i2", "False", "(2,)"), std::string("\x01\x02\xff\xfe"))), "a");
  EXPECT_THAT(swapped.to_doubles(), ElementsAre(258, -2));
  const auto half = parse_npy(
      view_of_text(npy(header_of("<f2", "False", "(3,)"), bytes_of<uint16_t>({0x3c00, 0xc100, 1}))), "a");
  EXPECT_THAT(half.to_floats(), ElementsAre(1.0F, -2.5F, 5.9604645e-8F));
  EXPECT_THAT(parse_npy(view_of_text(npy(header_of("|b1", "False", "(2,)"), std::string("\x01\0", 2))), "a")
                  .to_doubles(),
              ElementsAre(1, 0));
  EXPECT_THAT(
      parse_npy(view_of_text(npy(header_of("<u4", "False", "()"), bytes_of<uint32_t>({4000000000U}))), "a")
          .to_doubles(),
      ElementsAre(4e9));
  // Keys in another order, double quotes, Python 2's long integers.
  EXPECT_THAT(parse_npy(view_of_text(npy(R"({"shape": (1L, 2), "descr": "<i8", "fortran_order": False})",
                                         bytes_of<int64_t>({7, 8}))),
                        "a")
                  .to_doubles(),
              ElementsAre(7, 8));
  EXPECT_EQ(parse_npy(view_of_text(npy(header_of("<f4", "True", "(0, 5)"), "")), "a").element_count(), 0);
}

TEST(Npy, WhatIsWrittenIsRead) {
  const test::TemporaryFolder folder;
  const std::vector<double> values = {1.5, -2, 3e300, 0, 4, 5};
  for (const std::vector<int64_t>& shape : {std::vector<int64_t>{6}, {2, 3}, {1, 6, 1}}) {
    write_npy(folder.path() / "a.npy", npy_from_doubles(shape, values.data()));
    const auto back = read_npy(folder.path() / "a.npy");
    EXPECT_EQ(back.shape, shape);
    EXPECT_EQ(back.to_doubles(), values);
  }
  const float scalar = 2.5F;
  const std::string text = npy_text(npy_from_floats({}, &scalar));
  EXPECT_EQ(text.size() % 64, 4U) << "the data starts at a multiple of 64 bytes, as NumPy writes it";
  EXPECT_THAT(parse_npy(view_of_text(text), "a").to_floats(), ElementsAre(2.5F));
}

TEST(Npy, ReadsNpzStoredAndDeflated) {
  const test::TemporaryFolder folder;
  const auto file = folder.path() / "a.npz";
  const std::vector<double> ids = {3, 1, 2};
  std::vector<double> many(10000, 0.25);
  const NpyArray large = npy_from_doubles({100, 100}, many.data());
  for (const ZipMethod method : {ZipMethod::kStored, ZipMethod::kDeflated}) {
    write_zip(file,
              {{"ids.npy", npy_text(npy_from_doubles({3}, ids.data()))}, {"large.npy", npy_text(large)}},
              method);
    const auto npz = NpzFile::open(file);
    EXPECT_THAT(npz.names(), ElementsAre("ids", "large"));
    EXPECT_EQ(npz.read("ids").to_doubles(), ids);
    EXPECT_EQ(npz.read("large").to_doubles(), many);
    EXPECT_FALSE(npz.has("pose"));
    EXPECT_EQ(error_of([&] { npz.read("pose"); }),
              file.string() + ": expected an array named pose, found ids, large; check the file.");
  }
  write_npz(file, {{"ids", npy_from_doubles({3}, ids.data())}});
  const std::string first = read_file(file);
  write_npz(file, {{"ids", npy_from_doubles({3}, ids.data())}});
  EXPECT_EQ(read_file(file), first) << "the same arrays give the same bytes";
}

TEST(Npy, ReadsTheRealCameraFiles) {
  const auto folder = test::test_data() / "scenes/gld_layout_5e040cd0758dcc96/nerfstudio/images_4";
  int files = 0;
  for (const auto& item : std::filesystem::directory_iterator(folder)) {
    if (item.path().extension() != ".npz") continue;
    const auto npz = NpzFile::open(item.path());
    EXPECT_THAT(npz.read("intrinsic").shape, ElementsAre(3, 3));
    const auto pose = npz.read("pose").to_doubles();
    ASSERT_EQ(pose.size(), 16U);
    EXPECT_THAT(std::vector<double>(pose.begin() + 12, pose.end()), ElementsAre(0, 0, 0, 1));
    ++files;
  }
  EXPECT_EQ(files, 8);
  const auto depth =
      read_npy(test::test_data() / "scenes/tartanair_hospital/depth_left/000040_left_depth.npy");
  EXPECT_THAT(depth.shape, ElementsAre(480, 640));
  EXPECT_EQ(depth.dtype, DType::kFloat32);
}

struct HostileArray {
  const char* title;
  std::string text;
  std::string sentence;
};

TEST(Npy, RefusesHostileFiles) {
  const std::string a = "a.npy: ";
  const auto header_error = [&](const std::string& header) {
    return a + "expected a header with descr, fortran_order and shape, found " + header +
           "; save the array again.";
  };
  const auto truncated = [&](const std::string& expected, const std::string& found) {
    return a + "expected " + expected + ", found " + found +
           "; save the array again, the file may be truncated.";
  };
  const std::vector<HostileArray> corpus = {
      {"empty", "",
       a + "expected a NumPy array file, found other bytes at its start; save the array with numpy.save."},
      {"other bytes", std::string(64, 'x'),
       a + "expected a NumPy array file, found other bytes at its start; save the array with numpy.save."},
      {"version 9", npy("{}", "", 9),
       a + "expected a NumPy file of version 1 to 3, found version 9; save the array again."},
      {"cut in the length", npy("", "", 2).substr(0, 11),
       a + "expected a whole NumPy file, found only 11 bytes; save the array again."},
      {"header beyond the file", npy(std::string(100, ' '), "").substr(0, 50),
       a + "expected a header within the file and of at most 65536 bytes, found 100 bytes; "
           "save the array again."},
      {"huge header", npy(std::string(100000, ' '), "", 2),
       a + "expected a header within the file and of at most 65536 bytes, found 100000 bytes; "
           "save the array again."},
      {"no dictionary", npy("hello", ""), header_error("hello")},
      {"empty dictionary", npy("{}", ""), header_error("{}")},
      {"key twice", npy("{'descr':'<f4','descr':'<f4'}", ""), header_error("{'descr':'<f4','descr':'<f4'}")},
      {"unknown key", npy("{'code':'<f4'}", ""), header_error("{'code':'<f4'}")},
      {"open text", npy("{'descr", ""), header_error("{'descr")},
      {"no number", npy("{'shape':(x)}", ""), header_error("{'shape':(x)}")},
      {"negative size", npy("{'shape':(-1,)}", ""), header_error("{'shape':(-1,)}")},
      {"a call", npy("{'shape':eval('1')}", ""), header_error("{'shape':eval('1')}")},
      {"neither true nor false", npy("{'fortran_order': 1}", ""), header_error("{'fortran_order': 1}")},
      {"huge size", npy(header_of("<f4", "False", "(99999999999999999999,)"), ""),
       a + "expected sizes that fit 63 bits, found a larger one; save the array again."},
      {"overflow", npy(header_of("<f4", "False", "(4294967296, 4294967296)"), ""),
       truncated("a size that fits 63 bits for shape (4294967296, 4294967296) in float32",
                 "0 bytes of data")},
      {"truncated", npy(header_of("<f4", "False", "(2, 3)"), "12345678"),
       truncated("24 bytes for shape (2, 3) in float32", "8 bytes of data")},
      {"too long", npy(header_of("<f4", "False", "(1,)"), "12345678"),
       truncated("4 bytes for shape (1) in float32", "8 bytes of data")},
      {"objects", npy(header_of("|O", "False", "(1,)"), "12345678"),
       a + "expected an array of real numbers, integers or booleans, found NumPy type |O; "
           "save the array with another dtype."},
      {"text", npy(header_of("<U5", "False", "(1,)"), "12345678"),
       a + "expected an array of real numbers, integers or booleans, found NumPy type <U5; "
           "save the array with another dtype."},
      {"records", npy("{'descr': [('x', '<f4')]}", ""),
       a + "expected an array of numbers, found an array of records; "
           "save its fields as arrays of their own."},
  };
  for (const auto& hostile : corpus) EXPECT_EQ(npy_refusal(hostile.text), hostile.sentence) << hostile.title;
}

std::string zip_refusal(const std::string& text) {
  return error_of([&] {
    const auto archive = ZipArchive::parse(view_of_text(text), "a.npz");
    for (const auto& entry : archive->entries()) archive->read(entry);
  });
}

std::string broken(const std::string& where, const std::string& found) {
  return "a.npz" + where + ": expected a whole zip file, found " + found +
         "; download or write the file again.";
}

// What is unpacked must have the checksum that the directory names for it.
TEST(Zip, RefusesAWrongChecksumOfStoredAndDeflatedEntries) {
  for (const ZipMethod method : {ZipMethod::kStored, ZipMethod::kDeflated}) {
    std::string text = zip_text({{"a", std::string(100, 'x')}}, method, "test");
    const size_t checksum = text.size() - 22 - 47 + 16;  // in the directory's one record
    text[checksum] ^= 1;
    EXPECT_EQ(zip_refusal(text), broken(": entry a", "a wrong checksum"));
  }
}

TEST(Zip, RefusesHostileArchives) {
  const std::string good = zip_text({{"a", std::string(100, 'x')}, {"b", "y"}}, ZipMethod::kStored, "test");
  const std::string packed = zip_text({{"a", std::string(100, 'x')}}, ZipMethod::kDeflated, "test");
  const auto changed = [](std::string text, size_t position, const std::string& bytes) {
    return text.replace(position, bytes.size(), bytes);
  };
  // The directory of `good`: two records of 46 + 1 bytes before the 22 bytes of the end.
  const size_t directory = good.size() - 22 - 2 * 47;
  const size_t packed_directory = packed.size() - 22 - 47;
  EXPECT_EQ(zip_refusal(""), broken("", "only 0 bytes"));
  EXPECT_EQ(zip_refusal(std::string(70000, 'x')), broken("", "no directory at its end"));
  EXPECT_EQ(zip_refusal(changed(good, good.size() - 22 + 16, "\xff\xff\xff\x7f")),
            broken("", "a directory beyond the end of the file"));
  EXPECT_EQ(zip_refusal(changed(good, good.size() - 22 + 10, "\xff\xff")),
            broken("", "more entries than its directory holds"));
  EXPECT_EQ(zip_refusal(changed(good, directory, "XX")), broken("", "a broken directory"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 28, "\xff\xff")), broken("", "a broken directory"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 8, "\x01")),
            "a.npz: entry a: expected no encryption, found an encrypted entry; decrypt the file.");
  EXPECT_EQ(zip_refusal(changed(good, directory + 10, "\x0c")),
            "a.npz: entry a: expected a stored or deflated entry, found compression method 12; "
            "write the file again without it.");
  EXPECT_EQ(zip_refusal(changed(good, directory + 42, "\xff\xff\xff\x7f")),
            broken(": entry a", "a header beyond the end of the file"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 42, "\x01")),
            broken(": entry a", "no entry header where the directory points"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 20, "\xff\xff\xff\x7f\xff\xff\xff\x7f")),
            broken(": entry a", "data beyond the end of the file"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 24, "\x65")),
            broken(": entry a", "a stored entry of two sizes"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 20, std::string("\xa0\0\0\0\xa0\0\0\0", 8))),
            broken(": entry b", "an overlap with another entry"));
  EXPECT_EQ(zip_refusal(changed(good, directory + 47 + 46, "a")), broken(": entry a", "the name twice"));
  EXPECT_EQ(zip_refusal(changed(good, 31, "z")), broken(": entry a", "a wrong checksum"));
  EXPECT_EQ(zip_refusal(changed(packed, packed_directory + 24, "\xff\xff\xff\x7f")),
            broken(": entry a", "a size that its " + std::to_string(packed.size() - 22 - 47 - 31) +
                                    " packed bytes cannot give"));
  EXPECT_EQ(zip_refusal(changed(packed, packed_directory + 24, "\x65")),
            broken(": entry a", "broken compressed data"));
  EXPECT_EQ(zip_refusal(changed(packed, packed_directory + 24, "\x20")),
            broken(": entry a", "more data than the entry's size"));
  EXPECT_EQ(zip_refusal(changed(packed, 31, "\xff\xff")), broken(": entry a", "broken compressed data"));
  for (size_t size = 0; size < good.size(); ++size) {
    EXPECT_FALSE(zip_refusal(good.substr(0, size)).empty()) << size;
  }
}

}  // namespace
}  // namespace gld
