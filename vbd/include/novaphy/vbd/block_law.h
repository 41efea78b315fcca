// The 3x3 system of one particle in VBD: the force, the stiffness matrix, and the step that solves
// the system.
//
// A particle at x feels the force f (N) and has the stiffness H (N/m), symmetric and positive
// definite. The step d (m) of the particle solves H d = f. f and H together are the particle's
// block. Every law of VBD (elements/, particle_contact_law.h) returns the part of the block that
// one element adds. The law takes the particle as the first corner of the element.
//
// The part of inertia has the mass m (kg), the step size h (s), and the inertial position y = xn +
// h vn + h^2 (g + f_ext/m):
//   E = m/(2 h^2) |x - y|^2,  f = m/h^2 (y - x),  H = m/h^2 I
//
// Source: Chen et al., "Vertex Block Descent" (2024), equations 5 to 10.
//
// Freestanding (no standard headers). T is a float, SIMD lanes of floats, or a scalar that carries
// derivatives.
#pragma once

#include "novaphy/math/ldlt.h"
#include "novaphy/math/types.h"

namespace novaphy::vbd {

// The force f (N) and the entries of the symmetric stiffness H (N/m).
template <class T>
struct Block {
  Vec3<T> f{};
  T h00{}, h11{}, h22{}, h01{}, h02{}, h12{};
};

template <class T>
Block<T> operator+(const Block<T>& a, const Block<T>& b) {
  return {a.f + b.f,     a.h00 + b.h00, a.h11 + b.h11, a.h22 + b.h22,
          a.h01 + b.h01, a.h02 + b.h02, a.h12 + b.h12};
}

// A block without stiffness. A law that is instantiated with Force instead of Block skips H.
template <class T>
struct Force {
  Vec3<T> f{};
};
template <class T>
Force<T> operator+(const Force<T>& a, const Force<T>& b) {
  return {a.f + b.f};
}
template <class B, class T>
Force<T> where(const B& c, const Force<T>& a) {
  return {math::select(c, a.f, Vec3<T>{})};
}
template <class T>
void add_identity(Force<T>&, const T&) {}
template <class T>
void add_outer(Force<T>&, const T&, const Vec3<T>&) {}

// Returns the block in the lanes where the condition holds, and 0 in the other lanes.
template <class B, class T>
Block<T> where(const B& c, const Block<T>& a) {
  using math::select;
  const T zero = T(0.0f);
  return {select(c, a.f, Vec3<T>{}), select(c, a.h00, zero), select(c, a.h11, zero),
          select(c, a.h22, zero),    select(c, a.h01, zero), select(c, a.h02, zero),
          select(c, a.h12, zero)};
}

// add_identity adds s I to H, and add_outer adds s a a^T.
template <class T>
void add_identity(Block<T>& block, const T& s) {
  block.h00 = block.h00 + s;
  block.h11 = block.h11 + s;
  block.h22 = block.h22 + s;
}
template <class T>
void add_outer(Block<T>& block, const T& s, const Vec3<T>& a) {
  const Vec3<T> sa = a * s;
  block.h00 = block.h00 + sa.x * a.x;
  block.h11 = block.h11 + sa.y * a.y;
  block.h22 = block.h22 + sa.z * a.z;
  block.h01 = block.h01 + sa.x * a.y;
  block.h02 = block.h02 + sa.x * a.z;
  block.h12 = block.h12 + sa.y * a.z;
}

template <class T>
Vec3<T> multiply_stiffness(const Block<T>& b, const Vec3<T>& d) {
  return {(b.h00 * d.x + b.h01 * d.y) + b.h02 * d.z, (b.h01 * d.x + b.h11 * d.y) + b.h12 * d.z,
          (b.h02 * d.x + b.h12 * d.y) + b.h22 * d.z};
}

template <template <class> class B = Block, class T>
B<T> inertia_block(const Vec3<T>& x, const Vec3<T>& target, const T& mass_by_h2) {
  B<T> block;
  block.f = (target - x) * mass_by_h2;
  add_identity(block, mass_by_h2);
  return block;
}
template <class T>
T inertia_energy(const Vec3<T>& x, const Vec3<T>& target, const T& mass_by_h2) {
  const Vec3<T> d = x - target;
  return (T(0.5f) * mass_by_h2) * math::dot(d, d);
}

// Returns the factors L D L^T of H. H counts as nearly singular if det H <= 1e-7 h00 h11 h22, by
// rounding. The function then first adds `regularization` times the mean of the diagonal to the
// diagonal.
template <class T>
math::Ldlt<T, 3> factorize(const Block<T>& b, const T& regularization) {
  const auto factors = [&b](const T& shift) {
    const T a[3][3] = {{b.h00 + shift, b.h01, b.h02},
                       {b.h01, b.h11 + shift, b.h12},
                       {b.h02, b.h12, b.h22 + shift}};
    return math::ldlt(a);
  };
  const T zero = T(0.0f);
  const math::Ldlt<T, 3> plain = factors(zero);
  const T product = (b.h00 * b.h11) * b.h22;
  const T det = (plain.d[0] * plain.d[1]) * plain.d[2];
  const T mean = ((b.h00 + b.h11) + b.h22) * T(0x1.555556p-2f);
  using math::select;
  const auto is_regular = det > T(1e-7f) * product;
  if constexpr (__is_same(decltype(is_regular), const bool))
    if (is_regular) return plain;  // no shift, because a shift by 0 gives the same bits
  return factors(select(is_regular, zero, regularization * mean));
}

// Returns the adjoints of a block, from the multiplier u of the force and the step d. The adjoint
// of f is u. The adjoint of an entry of H is the derivative of -u.(H d). The adjoint law of an
// element takes these adjoints.
template <class T>
Block<T> adjoints_of(const Vec3<T>& u, const Vec3<T>& d) {
  Block<T> adjoint;
  adjoint.f = u;
  adjoint.h00 = -(u.x * d.x);
  adjoint.h11 = -(u.y * d.y);
  adjoint.h22 = -(u.z * d.z);
  adjoint.h01 = -(u.x * d.y + u.y * d.x);
  adjoint.h02 = -(u.x * d.z + u.z * d.x);
  adjoint.h12 = -(u.y * d.z + u.z * d.y);
  return adjoint;
}

// Solves H d = f for the step d (m).
template <class T>
Vec3<T> solve_block(const math::Ldlt<T, 3>& factors, const Vec3<T>& f) {
  const T b[3] = {f.x, f.y, f.z};
  T d[3];
  math::solve(factors, b, d);
  return {d[0], d[1], d[2]};
}

}  // namespace novaphy::vbd
