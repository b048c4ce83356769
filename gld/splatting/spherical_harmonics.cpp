#include "gld/splatting/spherical_harmonics.h"

namespace gld {
namespace {

constexpr double kC0 = 0.28209479177387814;                             // 1 / (2 sqrt(pi))
constexpr double kC1 = 0.4886025119029199;                              // sqrt(3 / pi) / 2
constexpr double kC2 = 1.0925484305920792, kC20 = 0.31539156525252005;  // sqrt(15 / pi) / 2, sqrt(5 / pi) / 4
constexpr double kC22 = 0.5462742152960396;                             // sqrt(15 / pi) / 4
constexpr double kC33 = 0.5900435899266435,
                 kC32 = 2.890611442640554;  // sqrt(35 / 2 pi) / 4, sqrt(105 / pi) / 2
constexpr double kC31 = 0.4570457994644658,
                 kC30 = 0.3731763325901154;  // sqrt(21 / 2 pi) / 4, sqrt(7 / pi) / 4
constexpr double kC322 = 1.445305721320277;  // sqrt(105 / pi) / 4

}  // namespace

void spherical_harmonics(int64_t degree, const double direction[3], double* values) {
  const double x = direction[0], y = direction[1], z = direction[2];
  values[0] = kC0;
  if (degree < 1) return;
  values[1] = -kC1 * y;
  values[2] = kC1 * z;
  values[3] = -kC1 * x;
  if (degree < 2) return;
  const double xx = x * x, yy = y * y, zz = z * z;
  values[4] = kC2 * x * y;
  values[5] = -kC2 * y * z;
  values[6] = kC20 * (2 * zz - xx - yy);
  values[7] = -kC2 * x * z;
  values[8] = kC22 * (xx - yy);
  if (degree < 3) return;
  values[9] = -kC33 * y * (3 * xx - yy);
  values[10] = kC32 * x * y * z;
  values[11] = -kC31 * y * (4 * zz - xx - yy);
  values[12] = kC30 * z * (2 * zz - 3 * xx - 3 * yy);
  values[13] = -kC31 * x * (4 * zz - xx - yy);
  values[14] = kC322 * z * (xx - yy);
  values[15] = -kC33 * x * (xx - 3 * yy);
}

void spherical_harmonic_slopes(int64_t degree, const double direction[3], double (*slopes)[3]) {
  const double x = direction[0], y = direction[1], z = direction[2];
  const auto set = [&](int64_t i, double dx, double dy, double dz) {
    slopes[i][0] = dx;
    slopes[i][1] = dy;
    slopes[i][2] = dz;
  };
  set(0, 0, 0, 0);
  if (degree < 1) return;
  set(1, 0, -kC1, 0);
  set(2, 0, 0, kC1);
  set(3, -kC1, 0, 0);
  if (degree < 2) return;
  set(4, kC2 * y, kC2 * x, 0);
  set(5, 0, -kC2 * z, -kC2 * y);
  set(6, -2 * kC20 * x, -2 * kC20 * y, 4 * kC20 * z);
  set(7, -kC2 * z, 0, -kC2 * x);
  set(8, 2 * kC22 * x, -2 * kC22 * y, 0);
  if (degree < 3) return;
  const double xx = x * x, yy = y * y, zz = z * z;
  set(9, -6 * kC33 * x * y, -3 * kC33 * (xx - yy), 0);
  set(10, kC32 * y * z, kC32 * x * z, kC32 * x * y);
  set(11, 2 * kC31 * x * y, -kC31 * (4 * zz - xx - 3 * yy), -8 * kC31 * y * z);
  set(12, -6 * kC30 * x * z, -6 * kC30 * y * z, 3 * kC30 * (2 * zz - xx - yy));
  set(13, -kC31 * (4 * zz - 3 * xx - yy), 2 * kC31 * x * y, -8 * kC31 * x * z);
  set(14, 2 * kC322 * x * z, -2 * kC322 * y * z, kC322 * (xx - yy));
  set(15, -3 * kC33 * (xx - yy), 6 * kC33 * x * y, 0);
}

double coefficient_of_colour(double colour) { return (colour - kHarmonicGrey) / kC0; }

double colour_of_coefficient(double coefficient) { return kHarmonicGrey + kC0 * coefficient; }

}  // namespace gld
