#include "gld/splatting/splat_ply.h"

#include "gld/base/atomic_file.h"
#include "gld/base/error.h"
#include "gld/base/mapped_file.h"
#include "gld/files/ply_vertices.h"

#include <algorithm>
#include <locale>
#include <sstream>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr const char* kOriginNote = "gld:origin";
std::vector<std::string> property_names(int64_t harmonics_each) {
  std::vector<std::string> names = {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"};
  for (int64_t k = 0; k < harmonics_each; ++k) names.push_back(fmt::format("f_rest_{}", k));
  for (const char* name : {"opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
    names.emplace_back(name);
  return names;
}

// Returns whether world coordinates lose digits that matter as floats.
bool is_far_away(const GaussianSet& set) {
  constexpr double kFloatRounding = 1.0 / (1 << 24), kHarmless = 1e-5;
  if (set.size() == 0) return false;
  Eigen::Vector3d low = Eigen::Vector3d::Constant(1e300), high = -low;
  for (size_t i = 0; i < set.means.size(); ++i) {
    const auto axis = static_cast<Eigen::Index>(i % 3);
    low[axis] = std::min<double>(low[axis], set.means[i]);
    high[axis] = std::max<double>(high[axis], set.means[i]);
  }
  const double largest =
      std::max((low + set.origin).cwiseAbs().maxCoeff(), (high + set.origin).cwiseAbs().maxCoeff());
  return largest * kFloatRounding > kHarmless * (high - low).norm() && set.origin.norm() > 0;
}

}  // namespace

void write_splat_ply(const std::filesystem::path& file, const GaussianSet& set,
                     const std::vector<std::pair<std::string, std::string>>& notes) {
  check_gaussians(set, file.string());
  PlyVertices vertices;
  const bool relative = is_far_away(set);
  if (relative) {
    vertices.comments.push_back(
        fmt::format("{} {} {} {}", kOriginNote, set.origin[0], set.origin[1], set.origin[2]));
  }
  for (const auto& [name, text] : notes) {
    for (std::string& line : ply_comments(name, text)) vertices.comments.push_back(std::move(line));
  }
  const int64_t others = harmonic_coefficients(set.degree) - 1;
  vertices.properties = property_names(3 * others);
  vertices.count = set.size();
  vertices.values.reserve(vertices.properties.size() * static_cast<size_t>(set.size()));
  const auto put = [&](float value) { vertices.values.push_back(value); };
  for (int64_t i = 0; i < set.size(); ++i) {
    for (int64_t k = 0; k < 3; ++k) {
      const float mean = set.means[static_cast<size_t>(3 * i + k)];
      put(relative ? mean : static_cast<float>(set.origin[k] + mean));
    }
    for (int64_t k = 0; k < 3; ++k) put(0);
    for (int64_t k = 0; k < 3; ++k) put(set.colours[static_cast<size_t>(3 * i + k)]);
    for (int64_t c = 0; c < 3; ++c) {
      for (int64_t k = 0; k < others; ++k) put(set.harmonics[static_cast<size_t>(3 * (others * i + k) + c)]);
    }
    put(set.logit_opacities[static_cast<size_t>(i)]);
    for (int64_t k = 0; k < 3; ++k) put(set.log_scales[static_cast<size_t>(3 * i + k)]);
    for (int64_t k = 0; k < 4; ++k) put(set.rotations[static_cast<size_t>(4 * i + k)]);
  }
  write_file_atomically(file, ply_vertices_bytes(vertices));
}

GaussianSet read_splat_ply(const std::filesystem::path& file) {
  const std::string where = file.string();
  const auto mapped = MappedFile::open(file);
  const PlyVertices vertices = parse_ply_vertices(mapped->bytes(), where);
  int64_t harmonics_each = 0;
  while (vertices.column(fmt::format("f_rest_{}", harmonics_each)) >= 0) ++harmonics_each;
  GaussianSet set;
  while (set.degree <= kMostHarmonicDegree && set.harmonics_each() != harmonics_each) ++set.degree;
  if (set.degree > kMostHarmonicDegree) {
    fail({where, "0, 9, 24 or 45 properties f_rest_*", fmt::format("{}", harmonics_each),
          "write it with spherical harmonics of a whole degree"});
  }
  std::vector<int64_t> columns;
  for (const std::string& name : property_names(harmonics_each)) {
    columns.push_back(vertices.column(name));
    const bool is_normal = name[0] == 'n';
    if (columns.back() < 0 && !is_normal)
      fail({where, "Gaussians of 3DGS", "vertices without \"" + name + "\"", "choose a file of Gaussians"});
  }
  for (const std::string& comment : vertices.comments) {
    std::istringstream words(comment);
    words.imbue(std::locale::classic());
    std::string name;
    words >> name;
    if (name != kOriginNote) continue;
    if (!(words >> set.origin[0] >> set.origin[1] >> set.origin[2]))
      fail({where, "three numbers behind " + std::string(kOriginNote), "something else", "write it again"});
  }
  const int64_t others = harmonic_coefficients(set.degree) - 1, degree = set.degree;
  const Eigen::Vector3d origin = set.origin;
  set = zero_gaussians(vertices.count, degree);
  set.origin = origin;
  const auto width = vertices.properties.size();
  for (int64_t i = 0; i < vertices.count; ++i) {
    const float* row = vertices.values.data() + static_cast<size_t>(i) * width;
    size_t next = 0;
    const auto take = [&] { return row[columns[next++]]; };
    for (int64_t k = 0; k < 3; ++k) set.means[static_cast<size_t>(3 * i + k)] = take();
    next += 3;
    for (int64_t k = 0; k < 3; ++k) set.colours[static_cast<size_t>(3 * i + k)] = take();
    for (int64_t c = 0; c < 3; ++c) {
      for (int64_t k = 0; k < others; ++k)
        set.harmonics[static_cast<size_t>(3 * (others * i + k) + c)] = take();
    }
    set.logit_opacities[static_cast<size_t>(i)] = take();
    for (int64_t k = 0; k < 3; ++k) set.log_scales[static_cast<size_t>(3 * i + k)] = take();
    for (int64_t k = 0; k < 4; ++k) set.rotations[static_cast<size_t>(4 * i + k)] = take();
  }
  check_gaussians(set, where);
  return set;
}

}  // namespace gld
