// The inputs of a slot, as scalars of any kind (tangent_law.h, tools/vbd_adjoints), and its
// block. All is templated on the scalar, so that no level of the sweep shares code with another
// one.
#pragma once

#include "novaphy/vbd/bending_law.h"
#include "novaphy/vbd/membrane_law.h"
#include "novaphy/vbd/slot_layout_law.h"
#include "novaphy/vbd/spring_law.h"
#include "novaphy/vbd/tetrahedron_law.h"

namespace novaphy::vbd {

template <Role role, class S>
struct SlotInputs {
  Vec3<S> own, others[3];
  S numbers[kFloats[role]];  // as in the slot
};

template <class S>
MembraneWeights<S> weights_of(const SlotInputs<kTriangle, S>& in) {
  const S* const n = in.numbers;
  return {{n[0], n[1]}, {n[2], n[3]}};
}
template <class S>
TetrahedronWeights<S> weights_of(const SlotInputs<kTetrahedron, S>& in) {
  const S* const n = in.numbers;
  return {{n[0], n[1], n[2]}, {n[3], n[4], n[5]}, {n[6], n[7], n[8]}};
}

template <class S>
Block<S> block_of(const SlotInputs<kSpring, S>& in, bool) {
  const S* const n = in.numbers;
  return spring_block(in.own, in.others[0], {n[0], n[1], n[2]}, n[3]);
}
template <class S>
Block<S> block_of(const SlotInputs<kTriangle, S>& in, bool damped) {
  const S* const n = in.numbers;
  return membrane_block(in.own, in.others[0], in.others[1], weights_of(in),
                        {n[4], n[5], n[6], n[7]}, {n[8], n[9], n[10]}, damped);
}
template <class S>
Block<S> block_of(const SlotInputs<kHingeOpposite, S>& in, bool) {
  const S* const n = in.numbers;
  return bending_opposite_block(in.own, in.others[0], in.others[1], in.others[2],
                                {n[0], n[1], n[2]}, n[3]);
}
template <class S>
Block<S> block_of(const SlotInputs<kHingeEnd, S>& in, bool) {
  const S* const n = in.numbers;
  return bending_end_block(in.others[0], in.others[1], in.own, in.others[2], {n[0], n[1], n[2]},
                           n[3]);
}
template <class S>
Block<S> block_of(const SlotInputs<kTetrahedron, S>& in, bool damped) {
  const S* const n = in.numbers;
  return tetrahedron_block(in.own, in.others[0], in.others[1], in.others[2], weights_of(in),
                           {n[9], n[10], n[11], n[12]},
                           {{n[13], n[14], n[15], n[16], n[17], n[18]}}, damped);
}

// What a slot has of the start, as functions of xn and the weights: calls put(k, value) for the
// k-th of it.
template <Role role, class S, class Put>
void start_of_slot(const SlotInputs<role, S>& in, const Put& put) {
  if constexpr (role == kSpring) {
    put(0, spring_length(in.own, in.others[0]));
  } else if constexpr (role == kTriangle) {
    const auto c = membrane_strain(in.own, in.others[0], in.others[1], weights_of(in));
    put(0, c.c00);
    put(1, c.c01);
    put(2, c.c11);
  } else if constexpr (role == kTetrahedron) {
    const auto c =
        tetrahedron_strain(in.own, in.others[0], in.others[1], in.others[2], weights_of(in));
    for (int k = 0; k < 6; ++k) put(k, c.c[k]);
  } else if constexpr (role == kHingeOpposite) {
    put(0, bending_angle(in.own, in.others[0], in.others[1], in.others[2]));
  } else {
    put(0, bending_angle(in.others[0], in.others[1], in.own, in.others[2]));
  }
}

}  // namespace novaphy::vbd
