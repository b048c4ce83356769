#pragma once

#include <map>
#include <string>
#include <vector>

namespace gld {

// The multiply-add peak of float32 that the fractions of one run refer to, and a check of it. Clocks change while a run
// goes on, and other programs only slow a measurement down: the peak is measured between what is timed, as often as
// that, and the best counts for all of the run. Nothing that is computed can be faster than it; what is tells that the
// peak was missed, and no fraction of the run is worth recording.
class PeakMeter {
 public:
  // Measures with that many threads, for about 0.2 s.
  void measure(int threads);
  // Does the same with the present thread setting, and measures a large product of LibTorch beside it.
  void measure_with_product();

  // Returns operations a second, the best so far; 0 where nothing was measured with that many threads.
  double peak(int threads) const;
  double product() const { return product_; }  // the best of LibTorch's

  // Notes that something computed in float32 took these seconds for so many operations; problems() looks at it.
  void reached(const std::string& what, double operations, double seconds, int threads);

  // Returns one sentence for each thread count with which something was faster than the peak, naming the fastest.
  std::vector<std::string> problems() const;

 private:
  struct Fastest {
    std::string what;
    double rate = 0;  // operations a second
  };
  std::map<int, double> peaks_;  // by threads
  std::map<int, Fastest> fastest_;
  double product_ = 0;
};

}  // namespace gld
