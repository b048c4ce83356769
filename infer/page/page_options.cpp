#include "infer/page/page_options.h"

namespace gld {

void PageOptions::visit(FieldVisitor& visitor) {
  visitor.integer({"page_points", "points of the cloud in report.html; 0: no cloud"}, page_points,
                  {0, 10'000'000});
  visitor.real(
      {"page_megabytes",
       "pictures in report.html are lossless as long as it stays below this, then JPEG as good as that "
       "lets them, of quality 70 at least"},
      page_megabytes, {1, 1000});
}

}  // namespace gld
