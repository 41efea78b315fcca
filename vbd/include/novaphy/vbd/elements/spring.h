// A spring with a damper in VBD. The law is stated for the end x of the spring, and the other end
// is x1.
//
// Law, with d = x - x1, l = max(|d|, 1e-8) and u = d/l. The step size is h, and ln is the length l
// at the start of the step:
//   E = ke/2 (l - rest)^2 + kd/(2h) (l - ln)^2
//   f = -u (ke (l - rest) + kd/h (l - ln))
//   H = (ke + kd/h) u u^T + ke max(0, 1 - rest/l) (I - u u^T)
// H is the second derivative of E where l >= rest. In a compressed spring the second derivative
// also has the negative part ke (1 - rest/l) across the spring. H leaves this part out. The
// template parameter project = false keeps the negative part.
// Symbols: x (m), ke (N/m), kd_by_h = kd/h (N/m), rest and ln (m).
//
// Source: Chen et al. (2024); Newton 1.8.0's SolverVBD has the same forces, and H without the max.
// Not smooth: l = rest in H; |d| < 1e-8, where u is d/1e-8.
// Gradient: exact in x, ke, kd, rest and ln, except where the law is not smooth.
#pragma once

#include "novaphy/vbd/elements/element.h"

#define NOVAPHY_VBD_SPRING_PARAMETERS(X)        \
  X(particle_spring_stiffness, 1, 1, kMaterial) \
  X(particle_spring_damping, 1, 1, kMaterial)   \
  X(particle_spring_rest_length, 1, 1, kRestLength)

namespace novaphy::vbd {

// The numbers of a slot: the coefficients ke, kd/h and rest, and the start value ln.
struct Spring : ElementOf<2> {
  static constexpr int kLawFloats = 3, kStartFloats = 1, kDampingParameter = 1;
  static constexpr int kSlots = 2;  // Spring, and Rope (rope.h)
  static constexpr bool kIsOuter = true, kIsAlwaysDamped = true;
  NOVAPHY_VBD_ELEMENT(particle_spring_indices, NOVAPHY_VBD_SPRING_PARAMETERS)
  template <class M>
  static int slot_of(const M& m, int32_t e, int) {
    return m.particle_spring_tension_only.data()[e] != 0 ? 1 : 0;
  }
  template <class M, class Body>
  static void for_flags(M& m, const Body& body) {
    body("particle_spring_tension_only", m.particle_spring_tension_only);
  }

  template <class In>
  static auto length(const In& in) {
    using math::max;
    return max(math::length(in.own - in.others[0]), typename In::Scalar(1e-8f));
  }
  template <template <class> class B = Block, bool project = true, class In>
  static auto block(const In& in, bool) {
    using math::max;
    using S = typename In::Scalar;
    const S ke = in.numbers[0], kd_by_h = in.numbers[1], rest = in.numbers[2];
    const S l = length(in), one = S(1.0f);
    const Vec3<S> u = (in.own - in.others[0]) / l;
    const S tension = ke * (l - rest) + kd_by_h * (l - in.numbers[3]);
    const S slack = one - rest / l;
    const S across = ke * (project ? max(S(0.0f), slack) : slack);
    B<S> block;
    block.f = u * (-tension);
    add_identity(block, across);
    add_outer(block, (ke + kd_by_h) - across, u);
    return block;
  }
  template <class In>
  static auto energy(const In& in) {
    using S = typename In::Scalar;
    const S l = length(in), stretch = l - in.numbers[2], moved = l - in.numbers[3];
    return S(0.5f) * ((in.numbers[0] * stretch) * stretch + (in.numbers[1] * moved) * moved);
  }
  template <class In, class Put>
  static void put_start(const In& in, const Put& put) {
    put(0, length(in));
  }
  template <class T, class Put>
  static void put_numbers(int, const T* p, const T& h, const Put& put) {
    put(0, p[0]);
    put(1, p[1] / h);
    put(2, p[2]);
  }
};

}  // namespace novaphy::vbd
