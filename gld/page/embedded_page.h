#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace gld {

// A piece of the template of pages, in order. embed_page.cmake makes the definition.
struct PagePart {
  std::string seam;  // empty: text of the template
  std::string_view
      text;  // of the template, or what the build put into the seam; empty for a seam of the page
};

const std::vector<PagePart>& embedded_page();

}  // namespace gld
