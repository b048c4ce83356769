#include "datasets/scenes/scene.h"

#include "gld/base/error.h"

namespace gld {
namespace {

template <class Pixels>
Pixels checked(const Frame& frame, const std::function<Pixels()>& load, const char* what) {
  if (!load) fail({frame.name, what, "none", "choose a frame that has it"});
  Pixels pixels = load();
  if (pixels.width != frame.camera.width || pixels.height != frame.camera.height) {
    fail({frame.name,
          std::string(what) + " of the camera's size " + size_text(frame.camera.width, frame.camera.height),
          size_text(pixels.width, pixels.height), "check that the files belong together"});
  }
  return pixels;
}

}  // namespace

Image Frame::image() const { return checked(*this, load_image, "an image"); }

DepthMap Frame::depth() const { return checked(*this, load_depth, "depth"); }

ValidityMask Frame::validity() const {
  if (!load_validity) return {camera.width, camera.height};
  return checked(*this, load_validity, "a validity mask");
}

}  // namespace gld
