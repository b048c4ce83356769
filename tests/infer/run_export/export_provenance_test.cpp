#include "infer/run_export/export_provenance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace gld {
namespace {

using ::testing::HasSubstr;
using ::testing::Pair;

FinishedRun run() {
  FinishedRun run;
  run.model_hash = "abc";
  run.seed = 5;
  run.precision = "float32";
  run.options = R"({"scene":"a & <b>"})";
  return run;
}

TEST(ExportProvenance, NamesTheRunsModelAndSeed) {
  EXPECT_THAT(export_provenance(run(), R"({"between":3})"),
              ::testing::ElementsAre(Pair("Software", program_version()), Pair("gld:command", "export"),
                                     Pair("gld:options", R"({"between":3})"), Pair("gld:model", "abc"),
                                     Pair("gld:seed", "5"), Pair("gld:precision", "float32"),
                                     Pair("gld:run_options", R"({"scene":"a & <b>"})")));
}

TEST(ExportProvenance, IsAnXmpPacket) {
  const std::string xmp = xmp_packet({{"Software", "gld 1"}, {"gld:run_options", "a & <b>\n"}});
  EXPECT_THAT(xmp, HasSubstr("<xmp:CreatorTool>gld 1</xmp:CreatorTool>"));
  EXPECT_THAT(xmp, HasSubstr("<gld:run_options>a &amp; &lt;b&gt; </gld:run_options>"));
  EXPECT_THAT(xmp, ::testing::StartsWith("<?xpacket begin="));
  EXPECT_THAT(xmp, ::testing::EndsWith("<?xpacket end=\"r\"?>"));
}

}  // namespace
}  // namespace gld
