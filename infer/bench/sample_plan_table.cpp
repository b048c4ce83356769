#include "infer/bench/sample_plan_table.h"

#include "gld/base/configuration.h"
#include "gld/base/error.h"
#include "infer/method/plan_errors.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <utility>

#include <fmt/format.h>

namespace gld {
namespace {

const std::string kFewerEvaluations = "fewer evaluations";
constexpr int64_t kComparedEvaluations = 16;

PlotPanel panel_of(const std::vector<PlanRow>& rows, const std::string& title, const PlotAxis& x,
                   double PlanRow::*cost, double PlanRow::*value, double unit) {
  PlotPanel panel;
  panel.title = title;
  panel.x = x;
  panel.y = {value == &PlanRow::mean_error ? "mean relative latent error" : "PSNR to truth (dB)",
             value == &PlanRow::mean_error ? AxisScale::kLog : AxisScale::kLinear};
  for (const auto& row : rows) {
    auto series = std::find_if(panel.series.begin(), panel.series.end(),
                               [&](const PlotSeries& entry) { return entry.name == row.variant.family; });
    if (series == panel.series.end()) {
      const bool line = row.variant.family == kFewerEvaluations;
      panel.series.push_back({row.variant.family, line ? SeriesStyle::kLine : SeriesStyle::kMarkers, {}});
      series = panel.series.end() - 1;
    }
    series->points.emplace_back(row.*cost / unit, row.*value);
  }
  return panel;
}

}  // namespace

SamplingMethod exact_method(int64_t evaluations) {
  SamplingMethod method = quality_method(SamplingQuality::kExact, BundleOptions());
  method.solver.evaluations = evaluations;
  if (evaluations != kComparedEvaluations) method.name = fmt::format("{} evaluations", evaluations);
  return method;
}

std::vector<PlanVariant> plan_variants(const std::vector<int64_t>& counts, const BundleOptions& bundle) {
  std::vector<PlanVariant> variants;
  variants.push_back({"published", quality_method(SamplingQuality::kPublished, bundle)});
  for (const int64_t count : counts) variants.push_back({kFewerEvaluations, exact_method(count)});
  const auto add = [&](const std::string& family, int64_t evaluations, const std::string& what,
                       const std::function<void(SamplingMethod&)>& change) {
    PlanVariant variant{family, exact_method(evaluations)};
    variant.method.name = fmt::format("{} evaluations, {}", evaluations, what);
    change(variant.method);
    variants.push_back(std::move(variant));
  };
  const auto add_nodes = [&](int64_t evaluations, int64_t nodes) {
    if (!can_have_encoder_nodes(bundle)) return;
    add("encoder nodes", evaluations, fmt::format("{} nodes", nodes),
        [&](SamplingMethod& method) { method.approximate.cascade_encoder_nodes = nodes; });
  };
  for (const int64_t nodes : {4, 6, 8}) add_nodes(kComparedEvaluations, nodes);
  add_nodes(10, 6);
  add_nodes(24, 8);
  for (const int64_t every : {2, 3, 5}) {
    add("M1 encoder reuse", kComparedEvaluations, fmt::format("M1 encoder every {}", every),
        [&](SamplingMethod& method) { method.approximate.level1_encoder_every = every; });
  }
  for (const double low : {0.9, 0.5}) {
    add("guidance interval", kComparedEvaluations, fmt::format("guided from t = {:g}", low),
        [&](SamplingMethod& method) {
          method.guidance_interval = {low, 1};
        });
  }
  for (const double tolerance : {0.01, 0.03}) {
    add("guidance dropped", kComparedEvaluations, fmt::format("guidance dropped below {:g}", tolerance),
        [&](SamplingMethod& method) { method.guidance_tolerance = tolerance; });
  }
  add("visible pairs", kComparedEvaluations, "visible pairs",
      [&](SamplingMethod& method) { method.approximate.view_pairs = ViewPairs::kVisible; });
  variants.push_back({"balanced", quality_method(SamplingQuality::kBalanced, bundle)});
  variants.push_back({"fast", quality_method(SamplingQuality::kFast, bundle)});
  return variants;
}

std::vector<PlanVariant> precision_variants(const std::vector<int64_t>& counts, const BundleOptions& bundle,
                                            ComputePrecision precision) {
  std::vector<SamplingMethod> methods;
  methods.reserve(counts.size() + 2);
  for (const int64_t count : counts) methods.push_back(exact_method(count));
  methods.push_back(quality_method(SamplingQuality::kBalanced, bundle));
  methods.push_back(quality_method(SamplingQuality::kFast, bundle));
  std::vector<PlanVariant> variants;
  const std::string& family = compute_precision_name(precision);
  for (auto& method : methods) {
    method.precision = precision;
    method.name += ", " + family;
    variants.push_back({family, std::move(method)});
  }
  return variants;
}

std::vector<PlanVariant> of_families(std::vector<PlanVariant> variants,
                                     const std::vector<std::string>& families) {
  if (families.empty()) return variants;
  std::vector<std::string> names;
  names.reserve(variants.size());
  for (const auto& variant : variants) names.push_back(variant.family);
  const auto among = [](const std::vector<std::string>& texts, const std::string& text) {
    return std::find(texts.begin(), texts.end(), text) != texts.end();
  };
  for (const auto& family : families) {
    if (among(names, family)) continue;
    const auto near = nearest_name(family, names);
    fail({"--families", "kinds of methods", "'" + family + "'",
          near.empty() ? "leave it out to see them all in the table" : "did you mean '" + near + "'?"});
  }
  variants.erase(std::remove_if(variants.begin(), variants.end(),
                                [&](const PlanVariant& variant) {
                                  return variant.family != kFewerEvaluations &&
                                         !among(families, variant.family);
                                }),
                 variants.end());
  return variants;
}

double error_at_flop(std::vector<std::pair<double, double>> points, double flop) {
  for (auto& [work, error] : points) error = std::max(error, 1e-300);
  std::sort(points.begin(), points.end());
  size_t end = 1;
  while (end + 1 < points.size() && points[end].first < flop) ++end;
  const auto &low = points[end - 1], &high = points[end];
  const double share = std::log(flop / low.first) / std::log(high.first / low.first);
  return std::exp((1 - share) * std::log(low.second) + share * std::log(high.second));
}

void summarise(std::vector<PlanRow>& rows) {
  for (auto& row : rows) {
    const auto count = static_cast<double>(row.samples.size());
    row.mean_error = row.largest_error = row.psnr = row.psnr_difference = row.psnr_to_reference = row.flop =
        0;
    for (const auto& sample : row.samples) {
      row.mean_error += sample.error() / count;
      row.largest_error = std::max(row.largest_error, sample.error());
      row.psnr += sample.psnr / count;
      row.psnr_difference += sample.psnr_difference / count;
      row.psnr_to_reference += sample.psnr_to_reference / count;
      row.flop += sample.flop / count;
    }
  }
  std::vector<std::pair<double, double>> points;
  for (const auto& row : rows) {
    if (row.variant.family == kFewerEvaluations) points.emplace_back(row.flop, row.mean_error);
  }
  for (auto& row : rows) {
    // Another precision has the operations of the same method in float32: it saves time, not work.
    const bool in_float32 = row.variant.method.precision == ComputePrecision::kFloat32;
    row.error_of_fewer_evaluations =
        row.variant.family == kFewerEvaluations || !in_float32 ? 0 : error_at_flop(points, row.flop);
  }
}

Table plan_sample_table(const std::vector<PlanRow>& rows) {
  Table table({"family", "method", "scene", "level1_error", "level0_error", "psnr", "psnr_difference",
               "psnr_to_reference", "gflop"});
  for (const auto& row : rows) {
    for (const auto& sample : row.samples) {
      table.add_row({row.variant.family, row.variant.method.name, sample.scene, sample.boundary_error,
                     sample.shallowest_error, sample.psnr, sample.psnr_difference, sample.psnr_to_reference,
                     sample.flop / 1e9});
    }
  }
  return table;
}

Table plan_row_table(const std::vector<PlanRow>& rows) {
  Table table({"method", "gflop", "seconds", "peak_megabytes", "mean_error", "largest_error", "psnr",
               "psnr_difference", "psnr_to_reference", "error_of_fewer_evaluations", "wins_at_equal_flop"});
  for (const auto& row : rows) {
    const bool compared = row.error_of_fewer_evaluations > 0;
    const bool wins = row.mean_error < row.error_of_fewer_evaluations;
    table.add_row({row.variant.method.name, row.flop / 1e9, row.seconds,
                   static_cast<double>(row.peak_bytes) / 1e6, row.mean_error, row.largest_error, row.psnr,
                   row.psnr_difference, row.psnr_to_reference,
                   compared ? TableCell(row.error_of_fewer_evaluations) : TableCell(std::string()),
                   compared ? std::string(wins ? "this" : kFewerEvaluations) : std::string()});
  }
  return table;
}

Figure plan_figure(const std::vector<PlanRow>& rows) {
  constexpr double kGiga = 1e9;
  Figure figure;
  figure.title = "Ways to sample: error against work and time";
  figure.panels = {panel_of(rows, "error against work", {"GFLOP of both flows", AxisScale::kLog},
                            &PlanRow::flop, &PlanRow::mean_error, kGiga),
                   panel_of(rows, "error against time", {"seconds of both flows", AxisScale::kLog},
                            &PlanRow::seconds, &PlanRow::mean_error, 1),
                   panel_of(rows, "quality against time", {"seconds of both flows", AxisScale::kLog},
                            &PlanRow::seconds, &PlanRow::psnr, 1)};
  return figure;
}

BoundCheck check_bounds(const std::vector<PlanRow>& rows) {
  BoundCheck check;
  for (const auto& row : rows) {
    for (const size_t half : {0U, 1U}) {
      std::vector<double> known;
      for (size_t i = half; i < row.samples.size(); i += 2) known.push_back(row.samples[i].error());
      if (known.empty()) continue;
      const double bound = error_bound(known);
      for (size_t i = 1 - half; i < row.samples.size(); i += 2) {
        ++check.samples;
        check.exceeded += row.samples[i].error() > bound ? 1 : 0;
      }
    }
  }
  return check;
}

}  // namespace gld
