#include "mjcf_softness.h"

#include <algorithm>
#include <cmath>

namespace novaphy::detail {
namespace {

constexpr double kLeastImpedance = 1e-4, kMostImpedance = 0.9999;  // MuJoCo's limits

double impedance(const double (&solimp)[5], double overlap) {
  const auto within = [](double d) { return std::clamp(d, kLeastImpedance, kMostImpedance); };
  const double first = within(solimp[0]), last = within(solimp[1]);
  const double middle = within(solimp[3]), power = std::max(solimp[4], 1.0);
  if (!(solimp[2] > 1e-15)) return 0.5 * (first + last);
  const double x = std::min(overlap / solimp[2], 1.0);
  const double y = x <= middle
                       ? std::pow(x, power) / std::pow(middle, power - 1.0)
                       : 1.0 - std::pow(1.0 - x, power) / std::pow(1.0 - middle, power - 1.0);
  return first + y * (last - first);
}

}  // namespace

SpringPerMass spring_per_mass(const MjcfSoftness& of, double gravity, double shortest) {
  const double last = std::clamp(of.solimp[1], kLeastImpedance, kMostImpedance);
  double k = -of.solref[0] / (last * last), b = -of.solref[1] / last;
  if (of.solref[0] > 0.0) {
    const double time = std::max(of.solref[0], shortest), ratio = of.solref[1];
    k = 1.0 / (last * last * time * time * ratio * ratio);
    b = 2.0 / (last * time);
  }
  const auto stiffness = [&](double overlap) {
    const double d = impedance(of.solimp, overlap);
    return k * d * d / (1.0 - d);
  };
  double overlap = 0.0;
  if (k > 0.0) {  // find the overlap at which the spring carries the weight
    double low = 0.0, high = gravity / std::min(stiffness(0.0), stiffness(1e6));
    for (int i = 0; i < 60; ++i) {
      overlap = 0.5 * (low + high);
      (stiffness(overlap) * overlap < gravity ? low : high) = overlap;
    }
  }
  const double d = impedance(of.solimp, overlap);
  return {stiffness(overlap), b * d / (1.0 - d)};
}

}  // namespace novaphy::detail
