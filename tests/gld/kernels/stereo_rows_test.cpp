// The loops of plane-sweep stereo beside the same in double, at every instruction set.
#include "gld/kernels/kernel_table.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include <gtest/gtest.h>

namespace gld {
namespace {

std::vector<float> uniform(size_t count, unsigned seed) {
  std::mt19937 engine(seed);
  std::uniform_real_distribution<float> distribution(-1, 1);
  std::vector<float> values(count);
  for (float& value : values) value = distribution(engine);
  return values;
}

struct Texels {
  int64_t width, height;
  std::vector<int> whole;  // brightness in 1 / kTexelOne, without the border
  std::vector<uint64_t> texels;

  Texels(int64_t picture_width, int64_t picture_height) : width(picture_width), height(picture_height) {
    for (const float value : uniform(static_cast<size_t>(width * height), 3))
      whole.push_back(2 * static_cast<int>(std::lround(value * static_cast<float>(kTexelOne) / 2)));
    texels.assign(static_cast<size_t>((width + 2) * (height + 2)), 1);
    for (int64_t y = 0; y < height; ++y) {
      for (int64_t x = 0; x < width; ++x) {
        uint64_t texel = 0;
        for (int corner = 0; corner < 4; ++corner) {
          texel |= static_cast<uint64_t>(static_cast<uint16_t>(at(x + corner % 2, y + corner / 2)))
                   << (16 * corner);
        }
        texels[static_cast<size_t>((y + 1) * (width + 2) + x + 1)] = texel;
      }
    }
  }
  int at(int64_t x, int64_t y) const {
    return whole[static_cast<size_t>(std::min(y, height - 1) * width + std::min(x, width - 1))];
  }
};

class StereoRows : public testing::TestWithParam<InstructionSet> {
 protected:
  const KernelTable& kernels() const { return kernel_table(GetParam()); }
};

TEST_P(StereoRows, WarpIsBilinear) {
  const Texels picture(37, 23);
  // A row that begins before the picture, crosses it with perspective and leaves it below.
  const float first[3] = {-1.3F, 2.1F, 1.0F}, step[3] = {1.17F, 0.61F, 0.004F};
  constexpr int64_t kCount = 43;  // no multiple of any vector
  std::vector<float> brightness(kCount), seen(kCount);
  kernels().warp_row({{picture.texels.data(), 39, 25}, first, step, kCount, brightness.data(), seen.data()});
  int64_t inside = 0;
  for (int64_t i = 0; i < kCount; ++i) {
    const auto at = static_cast<double>(i);
    const double z = first[2] + at * step[2];
    const double x = (first[0] + at * step[0]) / z - 1, y = (first[1] + at * step[1]) / z - 1;
    const auto k = static_cast<size_t>(i);
    const bool shown = x >= 0 && y >= 0 && x < 37 && y < 23;
    EXPECT_EQ(seen[k], shown ? 1 : 0) << i;
    if (!shown) {
      EXPECT_EQ(brightness[k], 0) << i;
      continue;
    }
    ++inside;
    const auto column = static_cast<int64_t>(x), row = static_cast<int64_t>(y);
    const double right = x - static_cast<double>(column), down = y - static_cast<double>(row);
    const double expected =
        ((1 - down) * ((1 - right) * picture.at(column, row) + right * picture.at(column + 1, row)) +
         down * ((1 - right) * picture.at(column, row + 1) + right * picture.at(column + 1, row + 1))) /
        static_cast<double>(kTexelOne);
    // Places have 24 bits and weights 14: neighbours that differ by 2 move by 2 (40 / 2^23 + 1 / 2^14) at most.
    EXPECT_NEAR(brightness[k], expected, 2e-4) << i;
  }
  EXPECT_GT(inside, 15);
}

TEST_P(StereoRows, WarpSeesNothingBehindTheCameraOrWhereNothingIsANumber) {
  const Texels picture(16, 16);
  const float nan = std::nanf("");
  for (const auto& first :
       {std::vector<float>{-5, -5, -1}, std::vector<float>{5, 5, 0}, std::vector<float>{nan, 5, 1},
        std::vector<float>{5, nan, 1}, std::vector<float>{1e30F, 5, 1e-30F}}) {
    const float step[3] = {0, 0, 0};
    std::vector<float> brightness(11, 7), seen(11, 7);
    kernels().warp_row(
        {{picture.texels.data(), 18, 18}, first.data(), step, 11, brightness.data(), seen.data()});
    for (size_t i = 0; i < 11; ++i) {
      EXPECT_EQ(brightness[i], 0);
      EXPECT_EQ(seen[i], 0);
    }
  }
}

TEST_P(StereoRows, CorrelationsAreThoseOfDouble) {
  for (const int64_t radius : {1, 2, 3, 4, 5, 6, 7}) {
    constexpr int64_t kCount = 53;
    const int64_t rows = 2 * radius + 4;
    const auto picture = uniform(static_cast<size_t>(rows * kCount), 5);
    auto reference = uniform(static_cast<size_t>(rows * kCount), 6);
    for (size_t i = 0; i < reference.size(); ++i) reference[i] = 0.5F * (reference[i] + picture[i]);
    std::vector<float> sums(static_cast<size_t>(3 * (kCount + 2 * kWindowPadding))), share(kCount),
        mean(kCount), inverse(kCount), seen(kCount, 1), correlation(kCount);
    const std::vector<float> zeros(kCount, 0.0F);
    seen[4] = 0;
    constexpr float kNoise = 0.01F;
    for (int64_t row = 0; row < rows; ++row) {
      const int64_t leaving = row - 2 * radius - 1, middle = row - radius;
      std::vector<double> expected(kCount);
      for (int64_t x = 0; middle >= radius && x < kCount; ++x) {
        double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
        for (int64_t v = middle - radius; v <= row; ++v) {
          for (int64_t u = std::max<int64_t>(0, x - radius); u <= std::min(x + radius, kCount - 1); ++u) {
            const double p = picture[static_cast<size_t>(v * kCount + u)];
            const double q = reference[static_cast<size_t>(v * kCount + u)];
            n += 1, a += p, b += q, aa += p * p, bb += q * q, ab += p * q;
          }
        }
        const auto at = static_cast<size_t>(x);
        share[at] = static_cast<float>(1 / n);
        mean[at] = static_cast<float>(b / n);
        inverse[at] = static_cast<float>(1 / std::sqrt(bb - b * b / n));
        expected[at] =
            (ab - a * b / n) / std::sqrt((bb - b * b / n) * (aa - a * a / n + static_cast<double>(kNoise)));
      }
      CorrelatedRow task{};
      task.count = kCount;
      task.radius = radius;
      task.entering = picture.data() + row * kCount;
      task.entering_reference = reference.data() + row * kCount;
      task.leaving = leaving >= 0 ? picture.data() + leaving * kCount : zeros.data();
      task.leaving_reference = leaving >= 0 ? reference.data() + leaving * kCount : zeros.data();
      task.sums = sums.data();
      task.share = share.data();
      task.mean = mean.data();
      task.inverse_deviation = inverse.data();
      task.seen = seen.data();
      task.noise = kNoise;
      task.correlation = middle >= radius ? correlation.data() : nullptr;
      kernels().correlate_row(task);
      for (size_t x = 0; middle >= radius && x < kCount; ++x) {
        // The reciprocal root has 11 bits and a half at least: 1.5 / 4096.
        EXPECT_NEAR(correlation[x], x == 4 ? static_cast<double>(kNotSeenCorrelation) : expected[x], 4e-4)
            << radius << " " << row << " " << x;
      }
    }
  }
}

TEST_P(StereoRows, CostIsOfTheBetterHalf) {
  constexpr size_t kCount = 21;
  std::vector<std::vector<float>> correlations;
  for (unsigned i = 0; i < 4; ++i) correlations.push_back(uniform(kCount, 10 + i));
  // Some see nothing, and at pixel 3 all do.
  for (size_t i = 0; i < 4; ++i) correlations[i][3] = kNotSeenCorrelation;
  correlations[0][5] = correlations[2][6] = correlations[1][6] = correlations[3][7] = kNotSeenCorrelation;
  for (size_t i = 0; i < 3; ++i) correlations[i][8] = kNotSeenCorrelation;
  for (int64_t photographs = 1; photographs <= kMostSweptPhotographs; ++photographs) {
    PlaneCostRow row{};
    row.count = kCount;
    row.photographs = photographs;
    for (int64_t i = 0; i < photographs; ++i)
      row.correlations[i] = correlations[static_cast<size_t>(i)].data();
    std::vector<uint8_t> cost(kCount);
    row.cost = cost.data();
    kernels().plane_cost_row(row);
    for (size_t x = 0; x < kCount; ++x) {
      std::vector<double> seen;
      for (int64_t i = 0; i < photographs; ++i) {
        const double value = correlations[static_cast<size_t>(i)][x];
        if (value > -1.5) seen.push_back(value);
      }
      double expected = kUnseenMatch;
      if (!seen.empty()) {
        std::sort(seen.rbegin(), seen.rend());
        const size_t half = (seen.size() + 1) / 2;
        double sum = 0;
        for (size_t i = 0; i < half; ++i) sum += seen[i];
        expected = kDearestMatch * (1 - std::max(0.0, sum / static_cast<double>(half)));
      }
      EXPECT_NEAR(cost[x], expected, 0.51) << photographs << " " << x;  // rounded
    }
  }
}

TEST_P(StereoRows, PriorCostsAreAParabolaCutOff) {
  std::vector<float> places;
  places.reserve(37);
  for (int i = 0; i < 37; ++i) places.push_back(0.05F * static_cast<float>(i));
  std::vector<uint8_t> cost(37, 100);
  kernels().add_prior_costs({37, places.data(), 0.7F, 200, 60, cost.data()});
  for (size_t i = 0; i < 37; ++i) {
    const double off = static_cast<double>(places[i]) - 0.7;
    EXPECT_NEAR(cost[i], 100 + std::min(60.0, 200 * off * off), 1.001) << i;  // rounded down
  }
}

TEST_P(StereoRows, PathsAreThoseOfTheirDefinition) {
  constexpr int64_t kPlanes = 48;
  std::mt19937 engine(4);
  std::vector<uint8_t> cost(kPlanes);
  for (uint8_t& value : cost) value = static_cast<uint8_t>(engine() % 200);
  std::vector<std::vector<uint16_t>> before(4), after(4);
  PathStep step{};
  step.planes = kPlanes;
  step.cost = cost.data();
  step.small_step = 7;
  std::vector<uint16_t> sum_before(kPlanes), sum(kPlanes);
  for (uint16_t& value : sum_before) value = static_cast<uint16_t>(engine() % 1000);
  step.sum_before = sum_before.data();
  step.sum = sum.data();
  for (size_t path = 0; path < 4; ++path) {
    before[path].assign(kPlanes + 2 * kPathGuard, kPathGuardCost);
    after[path].assign(kPlanes, 0);
    uint16_t least = 0xFFFF;
    for (int64_t i = 0; i < kPlanes; ++i) {
      const auto value = static_cast<uint16_t>(engine() % 300);
      before[path][static_cast<size_t>(kPathGuard + i)] = value;
      least = std::min(least, value);
    }
    step.before[path] = before[path].data() + kPathGuard;
    step.after[path] = after[path].data();
    step.least[path] = least;
    step.big_step[path] = static_cast<uint16_t>(20 + 10 * path);
  }
  PathStep done = step;
  kernels().path_step(done);
  for (int64_t i = 0; i < kPlanes; ++i) {
    int expected_sum = sum_before[static_cast<size_t>(i)];
    for (size_t path = 0; path < 4; ++path) {
      const auto at = [&](int64_t plane) {
        return static_cast<int>(before[path][static_cast<size_t>(kPathGuard + plane)]);
      };
      const int reached = std::min(
          {at(i), at(i - 1) + 7, at(i + 1) + 7, step.least[path] + static_cast<int>(step.big_step[path])});
      const int expected = cost[static_cast<size_t>(i)] + reached - step.least[path];
      EXPECT_EQ(after[path][static_cast<size_t>(i)], expected);
      expected_sum += expected;
    }
    EXPECT_EQ(sum[static_cast<size_t>(i)], expected_sum);
  }
  for (size_t path = 0; path < 4; ++path)
    EXPECT_EQ(done.least[path], *std::min_element(after[path].begin(), after[path].end()));
}

TEST_P(StereoRows, LeastAndSecondCost) {
  std::mt19937 engine(9);
  for (const int64_t planes : {8, 17, 48, 61}) {
    for (int repeat = 0; repeat < 50; ++repeat) {
      std::vector<uint16_t> sum(static_cast<size_t>(planes));
      for (uint16_t& value : sum) value = static_cast<uint16_t>(engine() % 500);
      LeastCost best{};
      best.sum = sum.data();
      best.planes = planes;
      best.apart = 3;
      kernels().least_cost(best);
      const auto place = std::min_element(sum.begin(), sum.end()) - sum.begin();
      EXPECT_EQ(best.plane, place);
      EXPECT_EQ(best.least, sum[static_cast<size_t>(place)]);
      uint16_t second = 0xFFFF;
      for (int64_t i = 0; i < planes; ++i) {
        if (std::abs(i - place) > 3) second = std::min(second, sum[static_cast<size_t>(i)]);
      }
      EXPECT_EQ(best.second, second);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(All, StereoRows, testing::ValuesIn(available_instruction_sets()),
                         [](const testing::TestParamInfo<InstructionSet>& info) {
                           std::string name = instruction_set_name(info.param);
                           name.erase(std::remove(name.begin(), name.end(), '-'), name.end());
                           return name;
                         });

}  // namespace
}  // namespace gld
