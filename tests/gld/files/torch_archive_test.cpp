#include "gld/files/torch_archive.h"

#include "gld/base/atomic_file.h"
#include "gld/files/dtype.h"
#include "gld/files/weight_file.h"
#include "tests/support/data_folders.h"
#include "tests/support/error_of.h"
#include "tests/support/pickle_text.h"
#include "tests/support/text_view.h"

#include <cstring>
#include <ctime>
#include <string>
#include <variant>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using test::error_of;
using test::float_bytes;
using test::PickleText;
using test::torch_legacy;
using test::torch_zip;
using test::view_of_text;
using testing::ElementsAre;

std::string archive_refusal(const std::string& pickle,
                            const std::map<std::string, std::string>& storages = {}) {
  const std::string file = torch_zip(pickle, storages);
  return error_of([&] { parse_torch_zip(view_of_text(file), "w.pt"); });
}

const TensorEntry& entry_of(const ParsedWeights& parsed, const std::string& name) {
  for (const auto& entry : parsed.entries) {
    if (entry.name == name) return entry;
  }
  throw std::runtime_error("no tensor " + name);
}

// Returns the elements in row-major order, through the strides.
std::vector<double> values_of(const TensorEntry& entry) {
  std::vector<double> values;
  std::vector<int64_t> index(entry.shape.size(), 0);
  for (int64_t count = entry.element_count(); count > 0; --count) {
    int64_t offset = 0;
    for (size_t axis = 0; axis < index.size(); ++axis) offset += index[axis] * entry.strides[axis];
    const uint8_t* at = entry.data + offset * byte_size(entry.dtype);
    if (entry.dtype == DType::kFloat32) {
      float value = 0;
      std::memcpy(&value, at, sizeof value);
      values.push_back(value);
    } else if (entry.dtype == DType::kFloat16) {
      uint16_t bits = 0;
      std::memcpy(&bits, at, sizeof bits);
      values.push_back(float_from_half(bits));
    }
    for (size_t axis = index.size(); axis-- > 0;) {
      if (++index[axis] < entry.shape[axis]) break;
      index[axis] = 0;
    }
  }
  return values;
}

double sum_of(const std::vector<TensorEntry>& entries) {
  double sum = 0;
  for (const auto& entry : entries) {
    for (const double value : values_of(entry)) sum += value;
  }
  return sum;
}

// The pickle is {"model": {"w": tensor}, "ema": OrderedDict(w=...), "steps": 7, "rate": 0.5, "name": "run", "on": True,
// "none": None, "list": [1, (2, 3)]}.
std::string checkpoint_pickle() {
  PickleText pickle;
  pickle.op('}').op('(');
  pickle.text("model").op('}').text("w").tensor("0", 6, 0, {2, 3}, {3, 1}).op('s');
  pickle.text("ema").empty_ordered_dictionary().op('(').text("w").tensor("1", 6, 1, {2, 2}, {1, 2}).op('u');
  // What PyTorch attaches to a state_dict.
  pickle.op('}').text("_metadata").empty_ordered_dictionary().op('s').op('b');
  pickle.text("steps").integer(7).text("rate").real(0.5).text("name").text("run").text("on").raw("\x88");
  pickle.text("none").op('N').text("list").op(']').integer(1).op('a').integer(2).integer(3).raw("\x86").op(
      'a');
  return pickle.op('u').stopped();
}

const std::map<std::string, std::string>& checkpoint_storages() {
  static const std::map<std::string, std::string> storages = {{"0", float_bytes({1, 2, 3, 4, 5, 6})},
                                                              {"1", float_bytes({0, 10, 20, 30, 40, 50})}};
  return storages;
}

void expect_checkpoint(const ParsedWeights& parsed) {
  ASSERT_EQ(parsed.entries.size(), 2U);
  EXPECT_THAT(values_of(entry_of(parsed, "model.w")), ElementsAre(1, 2, 3, 4, 5, 6));
  EXPECT_TRUE(entry_of(parsed, "model.w").contiguous());
  // Offset 1, transposed.
  EXPECT_THAT(values_of(entry_of(parsed, "ema.w")), ElementsAre(10, 30, 20, 40));
  EXPECT_FALSE(entry_of(parsed, "ema.w").contiguous());
  EXPECT_EQ(parsed.scalars.at("steps"), ScalarEntry(int64_t{7}));
  EXPECT_EQ(parsed.scalars.at("rate"), ScalarEntry(0.5));
  EXPECT_EQ(parsed.scalars.at("name"), ScalarEntry(std::string("run")));
  EXPECT_EQ(parsed.scalars.at("on"), ScalarEntry(true));
  EXPECT_EQ(parsed.scalars.at("list.1.1"), ScalarEntry(int64_t{3}));
  EXPECT_EQ(parsed.scalars.size(), 7U);
}

TEST(TorchArchive, ReadsStoredAndDeflatedZip) {
  for (const ZipMethod method : {ZipMethod::kStored, ZipMethod::kDeflated}) {
    const std::string file = torch_zip(checkpoint_pickle(), checkpoint_storages(), method);
    const auto parsed = parse_torch_zip(view_of_text(file), "w.pt");
    expect_checkpoint(parsed);
    EXPECT_EQ(parsed.owners.size(), method == ZipMethod::kStored ? 0U : 2U);
  }
}

TEST(TorchArchive, ReadsTheLegacyLayout) {
  const std::string file = torch_legacy(checkpoint_pickle(), checkpoint_storages(), 4);
  expect_checkpoint(parse_torch_legacy(view_of_text(file), "w.pth"));
}

TEST(TorchArchive, ReadsALegacyViewOfAStorage) {
  PickleText pickle;
  pickle.global("torch._utils", "_rebuild_tensor").op('(');
  pickle.op('(').text("storage").global("torch.cuda", "FloatStorage").text("7").text("cuda:3").integer(6);
  pickle.integers({0, 2, 3}).raw("tQ");  // the view's key, its first element and its size
  pickle.integer(1).integers({2}).integers({1}).raw("tR");
  const std::string file = torch_legacy(pickle.stopped(), {{"7", float_bytes({0, 1, 2, 3, 4, 5})}}, 4);
  EXPECT_THAT(values_of(parse_torch_legacy(view_of_text(file), "w.pth").entries.at(0)), ElementsAre(3, 4));
}

TEST(TorchArchive, PublishedStatisticsLoad) {
  struct Expected {
    const char* file;
    double sum;  // of all elements, computed independently in double
    int64_t channels;
  };
  const std::vector<Expected> files = {{"stats/da3/normalization_stats_level0.pt", 1068.2210297274, 1536},
                                       {"stats/da3/normalization_stats_level1.pt", 3605.9942457739, 1536},
                                       {"stats/vggt/normalization_stats_level0.pt", 279.9144078922, 2048},
                                       {"stats/vggt/normalization_stats_level1.pt", 358.7086285246, 2048},
                                       {"stats/vggt/special_stats_level0.pt", 181.0597339891, 2048},
                                       {"stats/vggt/special_stats_level1.pt", 271.2118131904, 2048}};
  for (const auto& expected : files) {
    const auto file = WeightFile::open(test::test_data() / expected.file);
    EXPECT_EQ(file->format(), "PyTorch zip");
    EXPECT_NEAR(sum_of(file->entries()), expected.sum, 1e-6) << expected.file;
    EXPECT_EQ(file->entry("mean").element_count(), expected.channels);
    EXPECT_EQ(file->entry("var").element_count(), expected.channels);
    EXPECT_FALSE(file->scalars().empty()) << "the extra integer entries";
    for (const auto& [name, value] : file->scalars())
      EXPECT_TRUE(std::holds_alternative<int64_t>(value)) << name;
  }
}

TEST(TorchArchive, ThirdPartyWeightsLoad) {
  struct Expected {
    const char* file;
    const char* format;
    size_t tensors;
    double sum;
  };
  const std::vector<Expected> files = {{"lpips_v0.1_alex.pth", "PyTorch legacy", 5, 105.2753545809},
                                       {"lpips_v0.1_squeeze.pth", "PyTorch legacy", 7, 173.4387181383},
                                       {"lpips_v0.1_vgg.pth", "PyTorch legacy", 5, 131.8555085473},
                                       {"taef2_decoder_first_tensors.pth", "PyTorch zip", 3, -4.2027498484},
                                       {"taef2_encoder_first_tensors.pth", "PyTorch zip", 3, 32.3579867487}};
  for (const auto& expected : files) {
    const auto file = WeightFile::open(test::test_data() / "weights" / expected.file);
    EXPECT_EQ(file->format(), expected.format) << expected.file;
    EXPECT_EQ(file->entries().size(), expected.tensors) << expected.file;
    EXPECT_NEAR(sum_of(file->entries()), expected.sum, 1e-6) << expected.file;
  }
}

TEST(TorchArchive, ALoneTensorHasAName) {
  const std::string file =
      torch_zip(PickleText().tensor("0", 1, 0, {}, {}).stopped(), {{"0", float_bytes({2.5F})}});
  const auto parsed = parse_torch_zip(view_of_text(file), "w.pt");
  EXPECT_EQ(parsed.entries.at(0).name, "tensor");
  EXPECT_THAT(values_of(parsed.entries[0]), ElementsAre(2.5));
}

TEST(TorchArchive, RefusesWhateverCouldRunCode) {
  const auto refused = [](const std::string& name) {
    return "w.pt: expected only tensors, numbers, strings, lists and dictionaries, found " + name +
           ", which could run code; save only the state_dict() of the model.";
  };
  EXPECT_EQ(archive_refusal(PickleText().global("os", "system").op('(').text("true").raw("tR").stopped()),
            refused("os.system"));
  EXPECT_EQ(archive_refusal(
                PickleText().text("builtins").text("eval").raw("\x93").op('(').text("1").raw("tR").stopped()),
            refused("builtins.eval"));
  EXPECT_EQ(archive_refusal(PickleText().global("torch", "nn.Module").stopped()), refused("torch.nn.Module"));
  EXPECT_EQ(archive_refusal(PickleText().global("torch._utils", "_rebuild_tensor_v3").stopped()),
            refused("torch._utils._rebuild_tensor_v3"));
  EXPECT_EQ(archive_refusal(
                PickleText().global("torch", "FloatStorage").op('(').integer(1000000000).raw("tR").stopped()),
            refused("a call of a storage type"));
  EXPECT_EQ(archive_refusal(PickleText().op(']').op('}').op('b').stopped()),
            refused("attributes set on a list"));
  EXPECT_EQ(archive_refusal(PickleText().raw("ios\nsystem\n").stopped()),
            "w.pt: expected a whole pickle, found opcode 105, which no state_dict needs, at byte 2; "
            "download or save the file again.");
}

struct HostilePickle {
  const char* title;
  std::string pickle;
  std::string found;  // in "expected a whole pickle, found ... at byte N"
};

TEST(TorchArchive, RefusesBrokenPickles) {
  const auto tensor = [](int64_t elements, int64_t offset, const std::vector<int64_t>& shape,
                         const std::vector<int64_t>& strides) {
    return PickleText().tensor("0", elements, offset, shape, strides).stopped();
  };
  const std::vector<int64_t> ones65(65, 1);
  constexpr int64_t kHuge = int64_t{1} << 62;
  const std::vector<HostilePickle> corpus = {
      {"empty", "", "the end of the data at byte 0"},
      {"cut in a number", std::string("\x80\x02\x8a\x08\x01", 5), "the end of the data at byte 4"},
      {"text of 4 GiB", std::string("\x80\x02X\xff\xff\xff\xff.", 8), "the end of the data at byte 7"},
      {"text of 2^64 bytes", std::string("\x80\x05\x8d\xff\xff\xff\xff\xff\xff\xff\xff.", 12),
       "the end of the data at byte 11"},
      {"negative length", std::string("\x80\x02\x8b\xff\xff\xff\xff.", 8), "the end of the data at byte 7"},
      {"unknown protocol", "\x80\x09.", "an unknown pickle protocol at byte 2"},
      {"empty stack", PickleText().op('s').stopped(), "an empty stack at byte 3"},
      {"nothing", PickleText().stopped(), "objects left over at byte 3"},
      {"two objects", PickleText().op(']').op(']').stopped(), "objects left over at byte 5"},
      {"mark left", PickleText().op(']').op('(').stopped(), "objects left over at byte 5"},
      {"below the mark", PickleText().op(']').op('(').op('a').stopped(), "an empty stack at byte 5"},
      {"no mark", PickleText().op('t').stopped(), "no mark at byte 3"},
      {"forgotten", PickleText().raw("h\x05").stopped(), "an object that was never remembered at byte 4"},
      {"append to a number", PickleText().integer(1).integer(1).op('a').stopped(),
       "an integer in place of a list at byte 23"},
      {"key without value", PickleText().op('}').op('(').op('N').op('u').stopped(),
       "a key without a value at byte 6"},
      {"reference to nothing", PickleText().integer(1).op('Q').stopped(),
       "a reference that is no tuple at byte 13"},
      {"reference to something",
       PickleText().op('(').text("module").op('N').op('N').op('N').op('N').raw("tQ").stopped(),
       "a reference to something else than a storage at byte 20"},
      {"storage of None",
       PickleText().op('(').text("storage").op('N').op('N').op('N').op('N').raw("tQ").stopped(),
       "a storage without a type at byte 21"},
      {"call of a list", PickleText().op(']').op(')').op('R').stopped(), "a call of a list at byte 5"},
      {"call without a tuple", PickleText().global("collections", "OrderedDict").op('N').op('R').stopped(),
       "a call without arguments at byte 29"},
      {"tensor without storage",
       PickleText().global("torch._utils", "_rebuild_tensor_v2").op(')').op('R').stopped(),
       "a tensor without storage at byte 37"},
      {"negative elements", tensor(-1, 0, {1}, {1}), "a negative number of elements at byte 95"},
      {"negative offset", tensor(4, -1, {1}, {1}), "a negative storage offset at byte 159"},
      {"negative size", tensor(4, 0, {-1}, {1}), "a negative size at byte 159"},
      {"negative stride", tensor(4, 0, {2}, {-1}), "a negative stride at byte 159"},
      {"beyond the storage", tensor(4, 0, {5}, {1}),
       "a tensor of shape (5) that reaches beyond its storage of 4 elements at byte 159"},
      {"offset beyond the storage", tensor(4, 3, {2}, {1}),
       "a tensor of shape (2) that reaches beyond its storage of 4 elements at byte 159"},
      {"overflowing stride", tensor(4, 0, {3}, {kHuge}),
       "a tensor of shape (3) that reaches beyond its storage of 4 elements at byte 159"},
      {"overflowing shape", tensor(4, 0, {kHuge, kHuge}, {0, 0}),
       "a tensor whose size overflows at byte 179"},
      {"expanded", tensor(4, 0, {1000000000}, {0}),
       "a tensor of shape (1000000000) expanded from a storage of 4 elements at byte 159"},
      {"fewer strides", tensor(4, 0, {1, 1}, {1}),
       "a tensor whose sizes and strides differ in number at byte 169"},
      {"65 dimensions", tensor(4, 0, ones65, ones65), "a tensor of more than 64 dimensions at byte 1439"},
  };
  for (const auto& hostile : corpus) {
    EXPECT_EQ(archive_refusal(hostile.pickle, {{"0", float_bytes({1, 2, 3, 4})}}),
              "w.pt: expected a whole pickle, found " + hostile.found + "; download or save the file again.")
        << hostile.title;
  }
}

TEST(TorchArchive, RefusesLoopsAndMultiplication) {
  const std::string deep =
      "w.pt: expected objects nested at most 64 deep, found deeper ones (a list may contain itself); "
      "save only the state_dict() of the model.";
  EXPECT_EQ(archive_refusal(PickleText()
                                .raw("]q\x01h\x01"
                                     "a")
                                .stopped()),
            deep);
  EXPECT_EQ(archive_refusal(PickleText().raw("}q\x01").text("k").raw("h\x01s").stopped()), deep);
  std::string nested;
  for (int i = 0; i < 100000; ++i) nested += ']';
  for (int i = 1; i < 100000; ++i) nested += 'a';
  EXPECT_EQ(archive_refusal(PickleText().raw(nested).stopped()), deep);
  // Forty lists, each holding the one before it twice: 2^40 leaves.
  PickleText laughs;
  laughs.op(']').integer(1).op('a');
  for (int i = 0; i < 40; ++i)
    laughs.raw(
        std::string("q\x01"
                    "0]h\x01"
                    "ah\x01"
                    "a"));
  EXPECT_EQ(archive_refusal(laughs.stopped()),
            "w.pt: expected at most 200000 objects, found more; save only the state_dict() of the model.");
}

// Two bytes of a file each: copies of a list of 20 000 items.
TEST(TorchArchive, CopiesShareOneBudgetOfMemory) {
  PickleText dictionaries;
  dictionaries.raw("(").raw("](");
  for (int i = 0; i < 20'000; ++i) dictionaries.integer(1).integer(2).raw("\x86");
  dictionaries.raw("eq\x01").raw("0");
  for (int i = 0; i < 1000; ++i) dictionaries.global("collections", "OrderedDict").raw("h\x01\x85R");
  EXPECT_THAT(
      archive_refusal(dictionaries.raw("t").stopped()),
      testing::HasSubstr("w.pt: expected a whole pickle, found more than eight million items in lists"));

  // A call copied its million arguments each time: 50 s.
  PickleText calls;
  calls.raw("(").storage("FloatStorage", "0", 1).integer(0).integers({1}).integers({1});
  for (int i = 0; i < 200'000; ++i) calls.op('N');
  calls.raw("tq\x01").raw("0").raw("(");
  for (int i = 0; i < 20'000; ++i) calls.global("torch._utils", "_rebuild_tensor_v2").raw("h\x01R");
  const std::clock_t start = std::clock();
  const std::string file = torch_zip(calls.raw("t").stopped(), {{"0", float_bytes({1})}});
  EXPECT_EQ(parse_torch_zip(view_of_text(file), "w.pt").entries.size(), 20'000U);
  EXPECT_LT(std::clock() - start, 20 * CLOCKS_PER_SEC);
}

TEST(TorchArchive, LongNamesAndTextsShareOneBudget) {
  const std::string huge =
      "w.pt: expected a PyTorch file, found names and texts of more than 64 MiB together; "
      "download or save the file again.";
  PickleText texts;
  texts.text(std::string(1'000'000, 'x')).raw("q\x01").raw("0").raw("(");
  for (int i = 0; i < 1000; ++i) texts.raw("h\x01");
  EXPECT_EQ(archive_refusal(texts.raw("l").stopped()), huge);
  // Lists have names too while they are walked, although they hold nothing.
  PickleText keys;
  keys.raw("}").text(std::string(1'000'000, 'x')).raw("](");
  for (int i = 0; i < 1000; ++i) keys.op(']');
  EXPECT_EQ(archive_refusal(keys.raw("es").stopped()), huge);
  PickleText storages;
  storages.storage("FloatStorage", std::string(1000, 'k'), 1);
  EXPECT_THAT(archive_refusal(storages.stopped()), testing::HasSubstr("found a storage's key of 1000 bytes"));
}

// 22 of 60 such files gave other numbers without a word.
TEST(TorchArchive, AnyFlippedBitOfAStoredTensorIsNoticed) {
  const std::string file = torch_zip(checkpoint_pickle(), checkpoint_storages());
  for (const auto& [key, bytes] : checkpoint_storages()) {
    const size_t at = file.find(bytes);
    ASSERT_NE(at, std::string::npos);
    for (size_t bit = 0; bit < 8 * bytes.size(); ++bit) {
      std::string flipped = file;
      flipped[at + bit / 8] = static_cast<char>(flipped[at + bit / 8] ^ 1 << bit % 8);
      EXPECT_THAT(error_of([&] { parse_torch_zip(view_of_text(flipped), "w.pt"); }),
                  testing::MatchesRegex("w\\.pt: entry .*data/" + key +
                                        ": expected a whole zip file, found a wrong checksum; .*"));
    }
  }
}

TEST(TorchArchive, RefusesValuesWithoutANameOrMeaning) {
  EXPECT_EQ(archive_refusal(
                PickleText().op('}').integer(1).integer(2).op('s').text("1").integer(3).op('s').stopped()),
            "w.pt: entry 1: expected each name once, found the name twice; "
            "save the file again with distinct names.");
  EXPECT_EQ(archive_refusal(PickleText().op('}').op(')').integer(2).op('s').stopped()),
            "w.pt: expected dictionary keys that are strings or integers, found a list; "
            "save only the state_dict() of the model.");
  EXPECT_EQ(archive_refusal(PickleText().op('}').text("k").storage("FloatStorage", "0", 1).op('s').stopped()),
            "w.pt: entry k: expected a tensor, number or string, found a storage; "
            "save only the state_dict() of the model.");
}

TEST(TorchArchive, RefusesStoragesThatDoNotFit) {
  const std::string pickle = PickleText().tensor("0", 4, 0, {4}, {1}).stopped();
  EXPECT_EQ(
      archive_refusal(pickle),
      "w.pt: tensor tensor: expected a storage named data/0, found none; download or save the file again.");
  EXPECT_EQ(archive_refusal(pickle, {{"0", float_bytes({1, 2, 3})}}),
            "w.pt: tensor tensor: expected 4 elements of float32, found a storage of 12 bytes; "
            "download or save the file again.");
  const std::string legacy = torch_legacy(pickle, {{"0", float_bytes({1, 2, 3, 4})}}, 4);
  EXPECT_EQ(error_of([&] { parse_torch_legacy(view_of_text(legacy.substr(0, legacy.size() - 1)), "w.pth"); }),
            "w.pth: expected a PyTorch file, found storage 0 of 4 elements in the 15 bytes that are left; "
            "download or save the file again.");
  EXPECT_EQ(error_of([&] { parse_torch_legacy(view_of_text(legacy + "x"), "w.pth"); }),
            "w.pth: expected a PyTorch file, found 1 bytes after the last storage; "
            "download or save the file again.");
  const std::string unused = torch_legacy(pickle, {{"0", float_bytes({1, 2, 3, 4})}, {"9", ""}}, 4);
  EXPECT_EQ(error_of([&] { parse_torch_legacy(view_of_text(unused), "w.pth"); }),
            "w.pth: expected a PyTorch file, found storage 9, which nothing uses; "
            "download or save the file again.");
}

TEST(TorchArchive, RefusesOtherPicklesAndZips) {
  const std::string plain = PickleText().op(']').stopped();
  EXPECT_EQ(error_of([&] { parse_torch_legacy(view_of_text(plain), "w.pth"); }),
            "w.pth: expected a PyTorch file, found a pickle without PyTorch's magic number; "
            "download or save the file again.");
  const std::string other = zip_text({{"a.txt", "x"}}, ZipMethod::kStored, "test");
  EXPECT_EQ(
      error_of([&] { parse_torch_zip(view_of_text(other), "w.pt"); }),
      "w.pt: expected a PyTorch file, found a zip file without data.pkl; download or save the file again.");
  const std::string big =
      zip_text({{"a/data.pkl", plain}, {"a/byteorder", "big"}}, ZipMethod::kStored, "test");
  EXPECT_EQ(
      error_of([&] { parse_torch_zip(view_of_text(big), "w.pt"); }),
      "w.pt: expected little-endian data, found big-endian data; save the file on a little-endian machine.");
}

TEST(TorchArchive, RefusesADecompressionBomb) {
  PickleText pickle;
  pickle.tensor("0", 1 << 20, 0, {1 << 20}, {1});
  const std::string file =
      torch_zip(pickle.stopped(), {{"0", std::string(size_t{4} << 20, '\0')}}, ZipMethod::kDeflated);
  ASSERT_LT(file.size(), 10000U);
  EXPECT_EQ(error_of([&] { parse_torch_zip(view_of_text(file), "w.pt"); }),
            "w.pt: expected a PyTorch file, found data that expands more than 16 times; "
            "download or save the file again.");
}

TEST(TorchArchive, EveryTruncationOfARealFileIsRefused) {
  for (const char* name : {"weights/lpips_v0.1_alex.pth", "stats/da3/normalization_stats_level0.pt"}) {
    const auto path = test::test_data() / name;
    const std::string whole = read_file(path);
    const bool zip = whole[0] == 'P';
    for (size_t size = 0; size < whole.size(); size += 1 + size / 50) {
      const std::string cut = whole.substr(0, size);
      EXPECT_FALSE(error_of([&] {
                     if (zip) {
                       parse_torch_zip(view_of_text(cut), "w");
                     } else {
                       parse_torch_legacy(view_of_text(cut), "w");
                     }
                   }).empty())
          << name << " cut to " << size;
    }
  }
}

}  // namespace
}  // namespace gld
