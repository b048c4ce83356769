// Two photographs in, the views between them out, as PPM files: what gld sample --photos makes, by the library.
#include <cstdio>
#include <fstream>
#include <iostream>
#include <string>

#include <gld/sampler.h>

namespace {

void write_ppm(const std::string& file, const gld::sampler::Picture& picture) {
  std::ofstream stream(file, std::ios::binary);
  stream << "P6\n" << picture.width << " " << picture.height << "\n255\n";
  stream.write(reinterpret_cast<const char*>(picture.rgb.data()),
               static_cast<std::streamsize>(picture.rgb.size()));
  stream.close();
  if (!stream) throw gld::sampler::SamplerError(file + " cannot be written");
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 5) {
    std::cerr << "usage: sample_two_photographs MODEL PHOTOGRAPH PHOTOGRAPH OUT_FOLDER\n";
    return 1;
  }
  gld::sampler::SampleRequest request;
  request.model = argv[1];
  request.photographs = {argv[2], argv[3]};
  request.path_views = 2;

  gld::sampler::SampleCallbacks callbacks;
  callbacks.progress = [](const gld::sampler::SampleProgress& progress) {
    std::fprintf(stderr, "\r%s: step %d of %d  ", progress.stage.c_str(), static_cast<int>(progress.step),
                 static_cast<int>(progress.steps));
    return true;  // false would stop
  };
  try {
    const auto result = gld::sampler::sample(request, callbacks);
    if (!result) return 130;
    std::cout << "\n" << result->verdict << "\n";
    for (const std::string& doubt : result->doubts) std::cout << "in doubt: " << doubt << "\n";
    for (const auto& view : result->views) {
      const std::string file = std::string(argv[4]) + "/" + view.name + ".ppm";
      write_ppm(file, view.picture);
      std::cout << file << ": " << static_cast<int>(100 * view.from_photographs + 0.5)
                << " % of it comes from the photographs\n";
    }
  } catch (const gld::sampler::SamplerError& error) {
    std::cerr << "error: " << error.what() << "\n";
    return 1;
  }
  return 0;
}
