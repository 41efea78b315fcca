// The inputs of a slot, as scalars of any kind (sweep_kernels.h, tools/vbd_adjoints), its block and
// its energy. The functions are templates on the scalar, so that no level of the sweep shares code
// with another one.
#pragma once

#include "novaphy/vbd/bending_law.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/slot_layout_law.h"
#include "novaphy/vbd/spring_law.h"
#include "novaphy/vbd/tetrahedron_law.h"

namespace novaphy::vbd {

// Numbers: has the k-th number of the slot as [k].
template <Role role, class S, class Numbers = S[kFloats[role]]>
struct SlotInputs {
  Vec3<S> own, others[kOthers[role]];
  Numbers numbers;
};

template <class S, class N>
MembraneWeights<S> weights_of(const SlotInputs<kTriangle, S, N>& in) {
  const N& n = in.numbers;
  return {{n[0], n[1]}, {n[2], n[3]}};
}
template <class S, class N>
TetrahedronWeights<S> weights_of(const SlotInputs<kTetrahedron, S, N>& in) {
  const N& n = in.numbers;
  return {{n[0], n[1], n[2]}, {n[3], n[4], n[5]}, {n[6], n[7], n[8]}};
}
template <class S, class N>
SpringLaw<S> law_of(const SlotInputs<kSpring, S, N>& in) {
  return {in.numbers[0], in.numbers[1], in.numbers[2]};
}
template <class S, class N>
MembraneLaw<S> law_of(const SlotInputs<kTriangle, S, N>& in) {
  return {in.numbers[4], in.numbers[5], in.numbers[6], in.numbers[7]};
}
template <Role role, class S, class N>
BendingLaw<S> law_of(const SlotInputs<role, S, N>& in) {
  return {in.numbers[0], in.numbers[1], in.numbers[2]};
}
template <class S, class N>
TetrahedronLaw<S> law_of(const SlotInputs<kTetrahedron, S, N>& in) {
  return {in.numbers[9], in.numbers[10], in.numbers[11], in.numbers[12]};
}
template <class S, class N>
MembraneStrain<S> start_of(const SlotInputs<kTriangle, S, N>& in) {
  return {in.numbers[8], in.numbers[9], in.numbers[10]};
}
template <class S, class N>
TetrahedronStrain<S> start_of(const SlotInputs<kTetrahedron, S, N>& in) {
  const N& n = in.numbers;
  return {{n[13], n[14], n[15], n[16], n[17], n[18]}};
}

// Calls law(the four vertices of a hinge).
template <class S, class N, class Law>
auto of_hinge(const SlotInputs<kHingeOpposite, S, N>& in, const Law& law) {
  return law(in.own, in.others[0], in.others[1], in.others[2]);
}
template <class S, class N, class Law>
auto of_hinge(const SlotInputs<kHingeEnd, S, N>& in, const Law& law) {
  return law(in.others[0], in.others[1], in.own, in.others[2]);
}

template <Role role, class S, class N>
Block<S> block_of(const SlotInputs<role, S, N>& in, [[maybe_unused]] bool damped) {
  const auto& x = in.others;
  if constexpr (role == kSpring) {
    return spring_block(in.own, x[0], law_of(in), in.numbers[3]);
  } else if constexpr (role == kTriangle) {
    return membrane_block(in.own, x[0], x[1], weights_of(in), law_of(in), start_of(in), damped);
  } else if constexpr (role == kHingeOpposite) {
    return bending_opposite_block(in.own, x[0], x[1], x[2], law_of(in), in.numbers[3]);
  } else if constexpr (role == kHingeEnd) {
    return bending_end_block(x[0], x[1], in.own, x[2], law_of(in), in.numbers[3]);
  } else {
    return tetrahedron_block(in.own, x[0], x[1], x[2], weights_of(in), law_of(in), start_of(in),
                             damped);
  }
}

template <Role role, class S, class N>
S energy_of(const SlotInputs<role, S, N>& in) {
  const auto& x = in.others;
  if constexpr (role == kSpring) {
    return spring_energy(in.own, x[0], law_of(in), in.numbers[3]);
  } else if constexpr (role == kTriangle) {
    return membrane_energy(in.own, x[0], x[1], weights_of(in), law_of(in), start_of(in));
  } else if constexpr (role == kTetrahedron) {
    return tetrahedron_energy(in.own, x[0], x[1], x[2], weights_of(in), law_of(in), start_of(in));
  } else {
    return of_hinge(in, [&](const auto&... corners) {
      return bending_energy(corners..., law_of(in), in.numbers[3]);
    });
  }
}

// What a slot has of the start, as functions of xn and the weights: calls put(k, value) for the
// k-th of it.
template <Role role, class S, class N, class Put>
void start_of_slot(const SlotInputs<role, S, N>& in, const Put& put) {
  const auto& x = in.others;
  if constexpr (role == kSpring) {
    put(0, spring_length(in.own, x[0]));
  } else if constexpr (role == kTriangle) {
    const auto c = membrane_strain(in.own, x[0], x[1], weights_of(in));
    put(0, c.c00);
    put(1, c.c01);
    put(2, c.c11);
  } else if constexpr (role == kTetrahedron) {
    const auto c = tetrahedron_strain(in.own, x[0], x[1], x[2], weights_of(in));
    for (int k = 0; k < 6; ++k) put(k, c.c[k]);
  } else {
    put(0, of_hinge(in, [](const auto&... corners) { return bending_angle(corners...); }));
  }
}

}  // namespace novaphy::vbd
