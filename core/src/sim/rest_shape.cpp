#include "rest_shape.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/math/types.h"

namespace novaphy::detail {
namespace {

template <int N>
struct Solved {
  double inverse[N][N] = {};
  double determinant = 0.0;
};

// Returns inverse and determinant by elimination with partial pivoting. A singular matrix has
// determinant 0.
template <int N>
Solved<N> solve(const float (&matrix)[N][N]) {
  double a[N][N];
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) a[i][j] = static_cast<double>(matrix[i][j]);
  Solved<N> result;
  for (int i = 0; i < N; ++i) result.inverse[i][i] = 1.0;
  double determinant = 1.0;
  for (int k = 0; k < N; ++k) {
    int pivot = k;
    for (int i = k + 1; i < N; ++i)
      if (std::abs(a[i][k]) > std::abs(a[pivot][k])) pivot = i;
    if (a[pivot][k] == 0.0) return {};
    if (pivot != k) {
      std::swap(a[pivot], a[k]);
      std::swap(result.inverse[pivot], result.inverse[k]);
      determinant = -determinant;
    }
    determinant *= a[k][k];
    for (int i = k + 1; i < N; ++i) {
      const double factor = a[i][k] / a[k][k];
      for (int j = k; j < N; ++j) a[i][j] -= factor * a[k][j];
      for (int j = 0; j < N; ++j) result.inverse[i][j] -= factor * result.inverse[k][j];
    }
  }
  for (int j = 0; j < N; ++j)
    for (int i = N - 1; i >= 0; --i) {
      for (int k = i + 1; k < N; ++k) result.inverse[i][j] -= a[i][k] * result.inverse[k][j];
      result.inverse[i][j] /= a[i][i];
    }
  result.determinant = determinant;
  return result;
}

template <int N>
void round_to(float (&target)[N][N], const Solved<N>& solved) {
  for (int i = 0; i < N; ++i)
    for (int j = 0; j < N; ++j) target[i][j] = static_cast<float>(solved.inverse[i][j]);
}

Vec3<double> exact(const Vec3f& a) {
  return {static_cast<double>(a.x), static_cast<double>(a.y), static_cast<double>(a.z)};
}
double squared(const Vec3<double>& a) { return math::dot(a, a); }

// Returns dot(a, b) as a chain of fused multiply-adds, in the order of a small matrix product.
float fused_dot(const Vec3f& a, const Vec3f& b) {
  return std::fma(a.z, b.z, std::fma(a.y, b.y, a.x * b.x));
}

}  // namespace

TriangleRest triangle_rest(const Vec3f& p, const Vec3f& q, const Vec3f& r) {
  TriangleRest rest{};
  const Vec3<double> a = exact(q) - exact(p), b = exact(r) - exact(p);
  const double longest = std::max({squared(a), squared(b), squared(b - a)});
  rest.relative = 0.5 * std::sqrt(squared(math::cross(a, b))) / longest;

  const Vec3f qp = q - p, rp = r - p;
  const Vec3f e1 = math::normalize(qp);
  const Vec3f e2 = math::normalize(math::cross(math::normalize(math::cross(qp, rp)), e1));
  const float basis[2][2] = {{fused_dot(e1, qp), fused_dot(e1, rp)},
                             {fused_dot(e2, qp), fused_dot(e2, rp)}};
  const Solved<2> solved = solve(basis);
  rest.area = static_cast<float>(solved.determinant) / 2.0f;
  round_to(rest.pose.m, solved);
  return rest;
}

TetrahedronRest tetrahedron_rest(const Vec3f& p, const Vec3f& q, const Vec3f& r, const Vec3f& s) {
  TetrahedronRest rest{};
  const Vec3<double> a = exact(q) - exact(p), b = exact(r) - exact(p), c = exact(s) - exact(p);
  const double longest = std::max(
      {squared(a), squared(b), squared(c), squared(b - a), squared(c - a), squared(c - b)});
  rest.relative = math::dot(a, math::cross(b, c)) / 6.0 / (longest * std::sqrt(longest));

  const Vec3f qp = q - p, rp = r - p, sp = s - p;
  const float edges[3][3] = {{qp.x, rp.x, sp.x}, {qp.y, rp.y, sp.y}, {qp.z, rp.z, sp.z}};
  const Solved<3> solved = solve(edges);
  rest.volume = static_cast<float>(solved.determinant) / 6.0f;
  round_to(rest.pose.m, solved);
  return rest;
}

void check_elasticity(std::string_view solver, const Model& model) {
  const std::vector<float> material = model.particle_tet_material.to_host();
  const std::vector<int32_t> is_lame = model.particle_tet_is_lame.to_host();
  for (size_t e = 0; e < is_lame.size(); ++e) {
    const double mu = double{material[3 * e]}, lambda = double{material[3 * e + 1]};
    const bool lame = is_lame[e] != 0;
    require(lame ? 3.0 * lambda + 2.0 * mu >= -1e-6 * mu : lambda >= 0.0, ErrorKind::Value, solver,
            ": model.particle_tet_material[", e, "]: expected finite numbers ",
            lame ? "with k_lambda >= -2/3 k_mu" : ">= 0", ", got ", lambda);
  }
}

}  // namespace novaphy::detail
