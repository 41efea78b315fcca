// A rope in VBD: a spring that pulls and never pushes. The law is stated for the end x of the rope,
// and the other end is x1.
//
// Law, with d, l, u, ke, kd, h, rest and ln of spring.h, and the tension T (N):
//   T = max(0, ke (l - rest) + kd/h (l - max(ln, rest)))
//   E = T^2 / (2 (ke + kd/h)),  f = -u T
//   H = (ke + kd/h) u u^T + T/l (I - u u^T) where T > 0, else 0
// T is 0 at and below the rest length. The damper acts only while the rope is taut, so T is
// continuous. H is the second derivative of E and positive semidefinite everywhere.
//
// Source: the tension-only member of structural analysis, with a Kelvin-Voigt damper that never
// pushes.
// Kinks: at T = 0 the derivatives are 0, as for the slack rope. At ln = rest with kd > 0 the
// derivatives are those of ln > rest.
// Gradient: exact in x, ke, kd, rest, ln away from the kinks.
#pragma once

#include "novaphy/vbd/elements/spring.h"

namespace novaphy::vbd {

// The numbers of a slot are the numbers of a spring.
struct Rope : Spring {
  static constexpr int kSlot = 1;

  // Returns the tension (N) before it is clamped at 0. The value is at most 0 where the rope is
  // slack.
  template <class In, class S>
  static S pull(const In& in, const S& l) {
    using math::max;
    const S rest = in.numbers[2];
    return in.numbers[0] * (l - rest) + in.numbers[1] * (l - max(in.numbers[3], rest));
  }
  template <template <class> class B = Block, class In>
  static auto block(const In& in, bool) {
    using math::max, math::select;
    using S = typename In::Scalar;
    const S zero = S(0.0f), l = length(in), of_law = pull(in, l);
    const S tension = max(zero, of_law), across = tension / l;
    const S along = select(of_law > zero, in.numbers[0] + in.numbers[1], zero);
    const Vec3<S> u = (in.own - in.others[0]) / l;
    B<S> block;
    block.f = u * (-tension);
    add_identity(block, across);
    add_outer(block, along - across, u);
    return block;
  }
  template <class In>
  static auto energy(const In& in) {
    using math::select;
    using S = typename In::Scalar;
    const S zero = S(0.0f), tension = pull(in, length(in));
    const auto taut = tension > zero;
    const S stiffness = select(taut, in.numbers[0] + in.numbers[1], S(1.0f));
    return select(taut, (tension * tension) / (stiffness + stiffness), zero);
  }
};

}  // namespace novaphy::vbd
