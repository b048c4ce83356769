#include "infer/splats/splat_spectrum.h"

#include "datasets/loading/batching.h"
#include "gld/base/atomic_file.h"
#include "gld/base/command_options.h"
#include "gld/base/error.h"
#include "gld/base/interrupt.h"
#include "gld/machine/timing.h"
#include "gld/metrics/latent_spectrum.h"
#include "gld/metrics/metric.h"
#include "gld/report/distinct_names.h"
#include "gld/report/plot.h"
#include "gld/report/progress.h"
#include "gld/report/provenance.h"
#include "gld/report/run_folder.h"
#include "gld/report/table.h"
#include "gld/tensors/compute_threads.h"
#include "infer/export/image_export.h"
#include "infer/splats/scene_spectrum.h"

#include <algorithm>
#include <filesystem>
#include <iostream>
#include <set>

#include <fmt/format.h>

namespace gld {
namespace {

constexpr int64_t kPictureSide = 192;  // pixels of one in pictures/

SpectrumSettings settings_of(const SplatSpectrumOptions& options) {
  SpectrumSettings settings;
  settings.latent_side = options.latent_side;
  settings.side = options.side;
  settings.held_out = options.held_out;
  settings.seed = options.seed;
  settings.fit = options.fit;
  settings.solve = options.solve;
  settings.levels = options.levels;
  settings.kernels.threads = use_threads(options.threads);
  for (const std::string& folder : options.models) {
    ModelBundle model = ModelBundle::open(folder);
    latent_levels(options.levels, model.options(), "--levels");
    image_size_of_latents(model.options(), options.latent_side, options.latent_side);
    if (!model.has(BundlePart::backbone())) {
      fail({folder, "a backbone with weights", "none", "add it with gld convert or gld train"});
    }
    settings.models.push_back(std::move(model));
  }
  return settings;
}

// Every scene is there once: one that counts twice would make the intervals too narrow.
std::vector<SceneLocation> locations_of(const SplatSpectrumOptions& options) {
  std::vector<SceneLocation> locations;
  std::set<std::string> known;
  for (const std::string& root : options.scenes) {
    for (auto& location : list_scenes(root, options.reading)) {
      const std::string where = std::filesystem::canonical(location.path).string();
      if (!known.insert(where + " " + location.part).second) {
        fail({"--scenes", "every scene once", where + " twice", "leave out one of the two"});
      }
      locations.push_back(std::move(location));
    }
  }
  return locations;
}

// The band of which the headline is: rings 8 to 15 of 32 pixels, and the same share of others.
struct Band {
  int64_t first = 0, last = 0;
};
Band band_of(int64_t side) {
  const int64_t last = last_whole_ring(side);
  return {std::min(last, side / 4), last};
}

// A space over all scenes.
struct SpaceSummary {
  std::string space;
  LatentTag tag;
  std::vector<double> encoded, rendered;  // rings of held-out views over the encoded DC, mean over scenes
  std::vector<double> ring_ratios;        // rendered over encoded, mean over scenes
  SceneStatistics ratio;                  // in the band
  double plain_ratio = 0;                 // without a window
  double fitted_ratio = 0;                // of the views that features were fitted to
  double error = 0;                       // of held-out views
};

SpaceSummary summary_of(const std::vector<SceneSpectrum>& scenes, size_t space, const Band& band) {
  SpaceSummary summary;
  summary.space = scenes.front().spaces[space].space;
  summary.tag = scenes.front().spaces[space].tag;
  std::vector<double> ratios, plain, fitted, errors;
  std::vector<torch::Tensor> encoded, rendered, ring_ratios;
  for (const SceneSpectrum& scene : scenes) {
    const SpaceSpectrum& of_scene = scene.spaces[space];
    const ViewSpectrum& views = of_scene.held_out;
    const double constant = views.encoded[0].item<double>();
    encoded.push_back(views.encoded / constant);
    rendered.push_back(views.rendered / constant);
    ring_ratios.push_back(views.rendered / views.encoded);
    ratios.push_back(band_ratio(views.rendered, views.encoded, band.first, band.last));
    plain.push_back(band_ratio(views.plain_rendered, views.plain_encoded, band.first, band.last));
    fitted.push_back(band_ratio(of_scene.fitted.rendered, of_scene.fitted.encoded, band.first, band.last));
    errors.push_back(of_scene.held_out_error);
  }
  const auto numbers = [](const std::vector<torch::Tensor>& tensors) {
    const auto mean = torch::stack(tensors).mean(0).contiguous();
    return std::vector<double>(mean.data_ptr<double>(), mean.data_ptr<double>() + mean.numel());
  };
  summary.encoded = numbers(encoded);
  summary.rendered = numbers(rendered);
  summary.ring_ratios = numbers(ring_ratios);
  summary.ratio = statistics_over_scenes(ratios);
  summary.plain_ratio = statistics_over_scenes(plain).mean;
  summary.fitted_ratio = statistics_over_scenes(fitted).mean;
  summary.error = statistics_over_scenes(errors).mean;
  return summary;
}

Table ring_table(const std::vector<SceneSpectrum>& scenes) {
  Table table({"scene", "space", "views", "ring", "encoded", "rendered", "plain_encoded", "plain_rendered"});
  for (const SceneSpectrum& scene : scenes) {
    for (const SpaceSpectrum& space : scene.spaces) {
      for (const bool held_out : {true, false}) {
        const ViewSpectrum& views = held_out ? space.held_out : space.fitted;
        for (int64_t ring = 0; ring < views.encoded.size(0); ++ring) {
          table.add_row({scene.scene, space.space, std::string(held_out ? "held out" : "fitted"), ring,
                         views.encoded[ring].item<double>(), views.rendered[ring].item<double>(),
                         views.plain_encoded[ring].item<double>(),
                         views.plain_rendered[ring].item<double>()});
        }
      }
    }
  }
  return table;
}

Table space_table(const std::vector<SpaceSummary>& spaces) {
  Table table({"space", "channels", "ratio", "low", "high", "plain_ratio", "fitted_ratio", "held_out_error"});
  for (const SpaceSummary& space : spaces) {
    table.add_row({space.space, space.tag.channels, space.ratio.mean, space.ratio.interval.low,
                   space.ratio.interval.high, space.plain_ratio, space.fitted_ratio, space.error});
  }
  return table;
}

Figure figure_of(const std::vector<SpaceSummary>& spaces) {
  Figure figure;
  figure.title = "Splatted latents by frequency, views that no feature was fitted to";
  PlotPanel ratio, amplitude;
  ratio.title = "rendered over encoded";
  ratio.x = {"ring [periods a picture]", AxisScale::kLinear};
  ratio.y = {"share of the amplitude", AxisScale::kLinear};
  amplitude.title = "amplitude: encoded (lines), rendered (dotted)";
  amplitude.x = ratio.x;
  amplitude.y = {"over the encoded DC", AxisScale::kLog};
  for (const SpaceSummary& space : spaces) {
    PlotSeries ratios{space.space, SeriesStyle::kLine, {}};
    PlotSeries encoded{space.space, SeriesStyle::kLine, {}};
    PlotSeries rendered{space.space, SeriesStyle::kLevel, {}};
    for (size_t ring = 1; ring < space.ring_ratios.size(); ++ring) {
      const auto at = static_cast<double>(ring);
      ratios.points.emplace_back(at, space.ring_ratios[ring]);
      encoded.points.emplace_back(at, space.encoded[ring]);
      rendered.points.emplace_back(at, space.rendered[ring]);
    }
    ratio.series.push_back(std::move(ratios));
    amplitude.series.push_back(std::move(encoded));
    amplitude.series.push_back(std::move(rendered));
  }
  figure.panels = {ratio, amplitude};
  return figure;
}

// Writes the picture, what is encoded of it and what the features show, side by side; each latent pixel is a square.
void write_pictures(const RunFolder& run, const SceneSpectrum& scene, const Provenance& provenance) {
  const std::vector<int64_t> size{kPictureSide, kPictureSide};
  const auto enlarged = [&](const torch::Tensor& picture) {
    return torch::upsample_nearest2d(picture.unsqueeze(0).to(torch::kFloat32), size)[0];
  };
  const auto photograph = torch::adaptive_avg_pool2d(scene.picture.to(torch::kFloat32), size);
  for (size_t i = 0; i < scene.spaces.size(); ++i) {
    const SpaceSpectrum& space = scene.spaces[i];
    const auto sheet =
        torch::cat({photograph, enlarged(space.encoded_picture), enlarged(space.rendered_picture)}, 2);
    export_image(run.subfolder("pictures") / fmt::format("{}_space{}.png", scene.scene, i), to_image(sheet),
                 provenance);
  }
}

nlohmann::ordered_json report_of(const std::vector<SceneSpectrum>& scenes,
                                 const std::vector<SpaceSummary>& spaces, const Band& band) {
  nlohmann::ordered_json report;
  report["band"] = {band.first, band.last};
  for (const SceneSpectrum& scene : scenes) {
    report["scenes"].push_back(
        {{"name", scene.scene}, {"gaussians", scene.gaussians}, {"held_out_psnr", scene.held_out_psnr}});
  }
  for (const SpaceSummary& space : spaces) {
    report["spaces"].push_back({{"space", space.space},
                                {"latents", tag_json(space.tag)},
                                {"ratio", space.ratio.mean},
                                {"interval", {space.ratio.interval.low, space.ratio.interval.high}},
                                {"plain_ratio", space.plain_ratio},
                                {"fitted_ratio", space.fitted_ratio},
                                {"held_out_error", space.error},
                                {"ring_ratios", space.ring_ratios}});
  }
  return report;
}

}  // namespace

SplatSpectrumOptions::SplatSpectrumOptions() {
  fit.steps = 500;
  fit.density.most_gaussians = 30000;
}

void SplatSpectrumOptions::visit(FieldVisitor& visitor) {
  visit_scenes(visitor, scenes, "an error");
  visitor.texts({"models", "model bundles whose backbones' latents are splatted"}, models);
  visitor.texts({"levels", "of each: numbers from 0, or all"}, levels);
  visit_out(visitor, out, overwrite);
  visitor.integer(
      {"latent_side", "latent pixels a side; 32 are 256 pixels of an autoencoder that takes 8 x 8"},
      latent_side, {4, 512});
  visitor.integer(
      {"side", "pixels a side of the squares that geometry is fitted to; smaller pictures are enlarged"},
      side, {16, 8192});
  visitor.integer({"held_out", "views that no feature is fitted to, of which the figure is"}, held_out,
                  {1, 100000});
  visit_seed(visitor, seed, "the order of views and the control's texture");
  visit_threads(visitor, threads);
  visitor.group({"reading", "how scenes are read"}, reading);
  visitor.group({"fit", "how geometry is fitted to colours"}, fit);
  visitor.group({"solve", "how features are solved for"}, solve);
}

void SplatSpectrumOptions::check() const {
  check_out(out, "runs/spectrum");
  if (scenes.empty()) {
    fail({"--scenes", "folders that are scenes or hold some", "none",
          "add for example --scenes rooms/scenes"});
  }
  fit.check();
  check_without_latents(fit);
}

void run_splat_spectrum(const SplatSpectrumOptions& options) {
  options.check();
  check_run_folder(options.out, "splat spectrum", earlier_run(options.overwrite));
  const SpectrumSettings settings = settings_of(options);
  const auto locations = locations_of(options);
  RunFolder run(options.out, "splat spectrum", options, earlier_run(options.overwrite));
  const Provenance provenance = make_provenance("splat spectrum", options);
  std::vector<SceneSpectrum> scenes;
  DistinctNames names;  // in tables and files
  Progress progress({"scenes", static_cast<int64_t>(locations.size()), 0, run.path()});
  const double seconds = seconds_of([&] {
    for (const SceneLocation& location : locations) {
      stop_if_interrupted(fmt::format("{} of {} scenes were done", scenes.size(), locations.size()));
      SceneReading reading = options.reading;
      reading.part = location.part;
      scenes.push_back(scene_spectrum(open_scene(location.path, reading), settings));
      scenes.back().scene = names.of(scenes.back().scene);
      write_pictures(run, scenes.back(), provenance);
      // What there is of it if the run ends here.
      write_file_atomically(run.path() / "rings.csv", ring_table(scenes).csv());
      progress.update(static_cast<int64_t>(scenes.size()));
    }
  });
  progress.finish();
  const Band band = band_of(options.latent_side);
  std::vector<SpaceSummary> spaces;
  for (size_t space = 0; space < scenes.front().spaces.size(); ++space)
    spaces.push_back(summary_of(scenes, space, band));
  const Table table = space_table(spaces);
  const std::string text = fmt::format(
      "# Splatted latents by frequency\n\n"
      "{} scene{}, {} views held out of each, latents of {} x {} pixels, features of degree {} solved for with ridge {}. ratio: |FFT2| "
      "of held-out views under Hann's window as features show them over what is encoded of them, mean over rings {} to "
      "{}; low and high: 95 % by bootstrap over scenes. plain_ratio: without a window, as Splatent has it. fitted_ratio: of views that features were fitted to. held_out_error: distance over the latents' spread.\n\n{}",
      scenes.size(), scenes.size() == 1 ? "" : "s", options.held_out, options.latent_side,
      options.latent_side, options.solve.feature_degree, options.solve.ridge, band.first, band.last,
      table.markdown());
  write_file_atomically(run.path() / "spaces.csv", table.csv());
  write_file_atomically(run.path() / "spectrum.md", text);
  const Figure figure = figure_of(spaces);
  write_svg(figure, run.path() / "spectrum.svg");
  write_png(figure, run.path() / "spectrum.png");
  nlohmann::ordered_json report = report_of(scenes, spaces, band);
  report["ridge"] = options.solve.ridge;
  report["degree"] = options.solve.feature_degree;
  report["seconds"] = seconds;
  report["threads"] = settings.kernels.threads;
  run.write_report(report);
  std::cout << text;
  run.note("spaces", "spaces.csv");
  run.note("rings", "rings.csv");
  run.note("plot", "spectrum.png");
  run.note("pictures", "pictures/");
  run.note("report", "report.json");
  std::cout << run.closing_box();
}

}  // namespace gld
