#include "infer/sample/picture_verdict.h"

#include "gld/base/printable_text.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

namespace gld {
namespace {

// Means over the left-out photographs of scenes. Real ones, with the PSNR of target views between them: 30 dB of
// what is covered (targets 37), 25 (32), 26 (28), 22 (27), 11 (15; 42 % covered), and nothing covered (12), as they
// were when this was chosen.
constexpr double kHardlyCovered = 0.3;
constexpr double kWellCovered = 0.5;
// dB of what is covered; carried photographs that fit have more than 20 even across a room's corner.
constexpr double kWell = 22, kFits = 18;
// A prediction that is no better than pictures as they are says that depth or cameras are wrong.
constexpr double kBetterBy = 1;
// Spread of the logarithm of (photographs' depth / the model's own): .05 to .20 in 13 drawn rooms, .33 to .82 in three
// real places, for a model that has seen drawn rooms only.
constexpr double kOtherShape = 0.25;

// What photographs show of a target view, over what they show of each other, below which it lies beyond them, and from
// which on beside them: .54 in a drawn room whose cameras leave the two photographs (20 dB, and 28 would be expected as
// of a view between them), .87 to 1 of views between photographs.
constexpr double kBeyond = 0.6, kBeside = 0.85;

// Share of the target views' pixels that reads as 100 %.
constexpr double kWhole = 0.995;
// A view is named that is expected to be so many dB worse than the middle one.
constexpr double kWorseBy = 3;

PhotographsAgree agreement_of(const std::vector<LeftOutPhotograph>& left_out) {
  if (left_out.empty()) return PhotographsAgree::kOne;
  const LeftOutPhotograph mean = mean_of(left_out);
  if (!mean.depth_known) return PhotographsAgree::kUntold;
  if (mean.covered < kHardlyCovered) return PhotographsAgree::kHardly;
  const bool better = mean.psnr > std::max(mean.psnr_nearest, mean.psnr_mean) + kBetterBy;
  if (!better || !(mean.psnr_covered >= kFits)) return PhotographsAgree::kNot;
  return mean.psnr_covered >= kWell && mean.covered >= kWellCovered ? PhotographsAgree::kWell
                                                                    : PhotographsAgree::kRoughly;
}

bool is_unfamiliar(const PictureEvidence& evidence) {
  if (evidence.prior && evidence.prior->pixels > 0 && evidence.prior->spread > kOtherShape) return true;
  for (size_t i = 0; i < std::min(evidence.usual.size(), evidence.divergences.size()); ++i) {
    if (evidence.divergences[i] > evidence.usual[i].usual) return true;
  }
  return false;
}

// Returns whether photographs that agree so let something be expected of the views.
bool promises(PhotographsAgree agree) {
  return agree == PhotographsAgree::kWell || agree == PhotographsAgree::kRoughly;
}

std::string photographs_sentence(PhotographsAgree agree, const PictureEvidence& evidence) {
  const LeftOutPhotograph mean = mean_of(evidence.left_out);
  const double trivial = std::max(mean.psnr_nearest, mean.psnr_mean);
  const std::string kept =
      evidence.keeps_photographs
          ? fmt::format("; {:.0f} % of the target views come from them", 100 * evidence.kept)
          : "";
  const std::string measured =
      fmt::format("{:.0f} dB where they show the same, {:.0f} dB in all, {:.0f} % shown", mean.psnr_covered,
                  mean.psnr, 100 * mean.covered);
  const bool beyond = evidence.keeps_photographs && evidence.kept < kBeyond * mean.covered;
  if (beyond && promises(agree)) {
    return fmt::format(
        "{:.0f} % of the target views come from no photograph: expect inventions there; ask for views between the "
        "photographs or take some from there; of each other these tell {}",
        100 * (1 - evidence.kept), measured);
  }
  switch (agree) {
    case PhotographsAgree::kOne:
      break;
    case PhotographsAgree::kUntold:
      return fmt::format(
          "The photographs tell no depth: they were taken from one place or from far away, show nothing in common or have no "
          "texture: expect inventions{}; take some a step to the side of each other, of the same things",
          kept);
    case PhotographsAgree::kHardly:
      return fmt::format(
          "The photographs hardly overlap (the others show {:.0f} % of one): expect inventions{}; take some in between, each "
          "with half of what the one beside it shows",
          100 * mean.covered, kept);
    case PhotographsAgree::kNot:
      return fmt::format(
          "The photographs hardly overlap, or do not fit their cameras (the others predict one to {:.0f} dB, as they are "
          "they have {:.0f}): expect inventions{}; take some in between, or look whether the cameras are theirs",
          mean.psnr, trivial, kept);
    case PhotographsAgree::kRoughly:
      return fmt::format("These pictures are rough, as the photographs' predictions of each other are ({}){}",
                         measured, kept);
    case PhotographsAgree::kWell:
      return fmt::format("{} the photographs' predictions of each other are ({}){}",
                         evidence.keeps_photographs ? "These pictures are as good as"
                                                    : "The photographs fit their cameras: as good as this",
                         measured, kept);
  }
  if (evidence.keeps_photographs) {
    std::string sure;
    if (const double deviation = evidence.unit_log_deviation; deviation > 0) {
      sure = fmt::format(" ({:.0f} % nearer or {:.0f} % farther would not surprise)",
                         100 * (1 - std::exp(-2 * deviation)), 100 * (std::exp(2 * deviation) - 1));
    }
    return fmt::format(
        "One photograph does not tell how far away things are, the model guesses it{}; {:.0f} % of the target "
        "views come from that photograph: expect bends and inventions; take a second one, a step to the side",
        sure, 100 * evidence.kept);
  }
  return "One photograph does not tell how far away things are: expect inventions; take a second one, a step to the side";
}

std::string decibels_between(double lowest, double highest) {
  const std::string low = fmt::format("{:.0f}", lowest), high = fmt::format("{:.0f}", highest);
  return low == high ? low + " dB" : low + " to " + high + " dB";
}

// What is expected of the views, those apart that lie far behind the others: their cameras leave the photographs.
std::string views_sentence(const PictureEvidence& evidence) {
  const auto views = expected_views(evidence);
  if (views.empty()) return "";
  std::vector<double> sorted;
  sorted.reserve(views.size());
  for (const ExpectedView& view : views) sorted.push_back(view.psnr);
  std::sort(sorted.begin(), sorted.end());
  const double middle = sorted[sorted.size() / 2], behind = middle - kWorseBy;
  const auto first = std::lower_bound(sorted.begin(), sorted.end(), behind);
  std::string text = "; about " + decibels_between(*first, sorted.back()) + " can be expected of " +
                     (views.size() == 1 ? "the view" : "the views");
  const auto count = static_cast<size_t>(first - sorted.begin());
  if (count == 0) return text;
  constexpr size_t kNamed = 4;
  std::string names = fmt::format("{} of {}", count, views.size());
  if (count <= kNamed) {
    names.clear();
    for (const ExpectedView& view : views) {
      if (view.psnr < behind) names += (names.empty() ? "" : ", ") + printable_text(view.name);
    }
  }
  return text + ", only " + decibels_between(sorted.front(), *(first - 1)) + " of " + names;
}

// Returns whether nothing that stands in the pictures was generated, to the percent that the sentence says.
bool nothing_generated(const PictureEvidence& evidence) {
  return evidence.keeps_photographs && evidence.kept >= kWhole;
}

std::string model_sentence(const PictureEvidence& evidence) {
  if (evidence.drawn_rooms_only) {
    return "; this model has seen drawn rooms only and has nothing to say about what no photograph shows here";
  }
  return "; the photographs are unlike what this model was trained on: do not trust what it generates";
}

}  // namespace

std::vector<ExpectedView> expected_views(const PictureEvidence& evidence) {
  if (evidence.left_out.empty()) return {};
  const LeftOutPhotograph mean = mean_of(evidence.left_out);
  std::vector<ExpectedView> views = evidence.views;
  const double wrong_by = mean.psnr - mean.expected;
  for (ExpectedView& view : views) {
    const double as_much = mean.covered > 0 ? view.kept / mean.covered : 1;
    const double beside = std::clamp((as_much - kBeyond) / (kBeside - kBeyond), 0.0, 1.0);
    view.psnr += wrong_by > 0 ? beside * wrong_by : wrong_by;
  }
  return views;
}

PictureVerdict verdict_of(const PictureEvidence& evidence) {
  PictureVerdict verdict;
  verdict.photographs = agreement_of(evidence.left_out);
  verdict.unfamiliar = is_unfamiliar(evidence);
  verdict.sentence = photographs_sentence(verdict.photographs, evidence) +
                     (promises(verdict.photographs) ? views_sentence(evidence) : "") +
                     (verdict.unfamiliar && !nothing_generated(evidence) ? model_sentence(evidence) : "") +
                     ".";
  return verdict;
}

std::string left_out_text(const std::vector<LeftOutPhotograph>& left_out) {
  if (left_out.empty()) return "";
  const LeftOutPhotograph mean = mean_of(left_out);
  const std::string covered =
      std::isfinite(mean.psnr_covered) ? fmt::format(", {:.1f} dB there", mean.psnr_covered) : "";
  return fmt::format(
      "each of {} photographs predicted from the others: {:.1f} dB (nearest photograph {:.1f}, mean of them {:.1f}); "
      "they show {:.0f} % of it{}\n",
      left_out.size(), mean.psnr, mean.psnr_nearest, mean.psnr_mean, 100 * mean.covered, covered);
}

nlohmann::ordered_json verdict_json(const PictureVerdict& verdict, const PictureEvidence& evidence) {
  const char* names[] = {"one photograph", "tell no depth", "hardly overlap",
                         "do not fit",     "roughly",       "well"};
  nlohmann::ordered_json json{{"sentence", verdict.sentence},
                              {"photographs", names[static_cast<size_t>(verdict.photographs)]},
                              {"unfamiliar", verdict.unfamiliar},
                              {"drawn_rooms_only", evidence.drawn_rooms_only}};
  if (evidence.prior && evidence.prior->pixels > 0) json["spread_of_model_depth"] = evidence.prior->spread;
  json["latent_divergence"] = evidence.divergences;
  if (!evidence.usual.empty()) {
    auto usual = nlohmann::ordered_json::array();
    for (const SeenLevel& level : evidence.usual) usual.push_back(level.usual);
    json["usual_latent_divergence"] = usual;
  }
  return json;
}

nlohmann::ordered_json left_out_json(const std::vector<LeftOutPhotograph>& left_out,
                                     const std::vector<std::string>& names) {
  auto list = nlohmann::ordered_json::array();
  for (const LeftOutPhotograph& one : left_out) {
    auto from = nlohmann::ordered_json::array();
    for (const size_t other : one.from) from.push_back(names[other]);
    nlohmann::ordered_json row{{"view", names[one.view]},
                               {"from", from},
                               {"depth", one.by_its_match ? "of their match with it" : "of their own"},
                               {"covered", one.covered},
                               {"psnr", one.psnr},
                               {"psnr_nearest_source", one.psnr_nearest},
                               {"psnr_mean_of_sources", one.psnr_mean},
                               {"expected_psnr_unmoved", one.expected}};
    if (std::isfinite(one.psnr_covered)) row["psnr_covered"] = one.psnr_covered;
    list.push_back(row);
  }
  return list;
}

}  // namespace gld
