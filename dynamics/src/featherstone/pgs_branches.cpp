#include "pgs_branches.h"

#include <algorithm>
#include <cmath>

namespace novaphy {
namespace {

namespace art = articulation;
constexpr float kLeastSlip = 1e-6f;  // m/s

float length(float x, float y) { return math::sqrt(x * x + y * y); }

}  // namespace

ContactBranch branch_of(const art::PgsContact<float>& c, bool cone) {
  ContactBranch b;
  b.active = c.impulse[0] > 0.0f;
  const float limit = c.friction * c.impulse[0] * (1.0f - kSlides);
  if (cone) {
    b.slides[0] = b.slides[1] = length(c.impulse[1], c.impulse[2]) >= limit;
  } else {
    for (int r = 0; r < 2; ++r) b.slides[r] = std::fabs(c.impulse[r + 1]) >= limit;
  }
  return b;
}

ContactBlocks blocks_of(const art::PgsContact<float>& c, const ContactBranch& branch, bool cone,
                        const double* w) {
  ContactBlocks k;
  k.b[0][0] = 1.0;
  k.r[0][0] = c.cfm;
  for (int i = 0; i < 2; ++i) {
    if (!branch.slides[i]) {
      k.b[i + 1][i + 1] = 1.0;
      continue;
    }
    k.r[i + 1][i + 1] = 1.0;
    if (!cone) k.r[i + 1][0] = (c.impulse[i + 1] < 0.0f ? 1.0 : -1.0) * c.friction;
  }
  if (!cone || !branch.slides[0]) return k;
  const double size = std::max(std::sqrt(w[0] * w[0] + w[1] * w[1]), double{kLeastSlip});
  const double by = length(c.impulse[1], c.impulse[2]);
  double t[2] = {w[0] / size, w[1] / size};  // a converged sweep has t = -lambda_t / |lambda_t|
  if (by > 0.0)
    for (int i = 0; i < 2; ++i) t[i] = -c.impulse[i + 1] / by;
  const double push = double{c.friction} * c.impulse[0] / size;
  for (int i = 0; i < 2; ++i) {
    k.r[i + 1][0] = c.friction * t[i];
    for (int j = 0; j < 2; ++j) k.b[i + 1][j + 1] = push * ((i == j ? 1.0 : 0.0) - t[i] * t[j]);
  }
  return k;
}

void rows_by_friction(const art::PgsContact<float>& c, const ContactBranch& branch, bool cone,
                      const double* slip, double* to) {
  double direction[2] = {-c.impulse[1], -c.impulse[2]};
  if (c.impulse[1] == 0.0f && c.impulse[2] == 0.0f) std::copy_n(slip, 2, direction);
  const double size = std::hypot(direction[0], direction[1]);
  for (int i = 0; i < 2; ++i) {
    to[i] = 0.0;
    if (!branch.slides[i] || direction[i] == 0.0) continue;
    to[i] = c.impulse[0] * (cone ? direction[i] / size : std::copysign(1.0, direction[i]));
  }
}

void solve_dense(std::vector<double>& a, size_t n) {
  const size_t width = n + 1;
  for (size_t k = 0; k < n; ++k) {
    size_t best = k;
    for (size_t i = k + 1; i < n; ++i)
      if (std::fabs(a[i * width + k]) > std::fabs(a[best * width + k])) best = i;
    if (a[best * width + k] == 0.0) continue;
    if (best != k)
      std::swap_ranges(a.begin() + static_cast<int64_t>(k * width),
                       a.begin() + static_cast<int64_t>((k + 1) * width),
                       a.begin() + static_cast<int64_t>(best * width));
    for (size_t i = k + 1; i < n; ++i) {
      const double f = a[i * width + k] / a[k * width + k];
      if (f == 0.0) continue;
      for (size_t j = k; j < width; ++j) a[i * width + j] -= f * a[k * width + j];
    }
  }
  for (size_t k = n; k-- > 0;) {
    double x = a[k * width + n];
    for (size_t j = k + 1; j < n; ++j) x -= a[k * width + j] * a[j * width + n];
    a[k * width + n] = a[k * width + k] == 0.0 ? 0.0 : x / a[k * width + k];
  }
}

}  // namespace novaphy
