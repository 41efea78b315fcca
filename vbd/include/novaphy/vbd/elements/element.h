// The common part of the elements of VBD.
//
// A slot is an element as one of its particles sees it. The struct of an element (spring.h) has all
// that the solver needs from the element, and is also the slot of each corner. An element whose
// corners have different laws (hinge.h) has an additional struct for each slot.
//
// The numbers of a slot are the weights of the other corners, the coefficients of the law, and
// values of the start of the step. The numbers depend on parameters: columns of arrays of Model.
//
// Freestanding: device code reads it too. The scalar is a float, lanes of floats, carries a
// derivative (math/dual.h), or is an expression (tools/vbd_adjoints).
#pragma once

#include "novaphy/vbd/stiffness_law.h"

namespace novaphy::vbd {

// The meaning of the columns of an array. kMaterial: coefficients; an element acts where one of
// them is not 0.
enum ArrayUse : int { kMaterial, kRestShape, kRestLength, kActivation };

constexpr int kMostArrays = 4, kMostSlots = 2;  // arrays of parameters, and slots, of an element

// The base of the struct of an element, with defaults. The struct also has:
// - kLawFloats and kStartFloats, the numbers of the law and of the start; kDampingParameter;
// - block<B>(in, damped), a Block or a Force, and energy(in);
// - put_start(in, put) and put_numbers(corner, parameters, h, put), which call put(k, value) for
// the k-th number of the start and of the slot;
// - with more than two corners stiffness(in, damped), a function of d that sums H_k d[k], with the
// stiffness H_k (stiffness_law.h) between the own corner and itself (k = 0) or another corner. The
// function may have a member between(k), which returns H_k for k > 0: kHasBetween.
template <int corners>
struct ElementOf {
  static constexpr int kCorners = corners;
  static constexpr int kWeights = 0;     // count of weights among a slot's numbers
  static constexpr int kActivated = -1;  // the number that an activation changes; -1: none
  // number of slots of the element, and the index of this one
  static constexpr int kSlots = 1, kSlot = 0;
  static constexpr bool kIsOuter = false;         // summed with the contacts, before the inertia
  static constexpr bool kIsAlwaysDamped = false;  // false: no damping terms where all kd are 0
  static constexpr bool kResistsTurns = false;    // H of block() is larger than H_0
  static constexpr bool kHasBetween = false;      // stiffness() has the member between(k)
  static constexpr bool kMayLackCorners = false;
  static constexpr const char* kUnread = "";  // names of the material's columns that no force reads
  // True: the struct has is_defined(in), and derivatives are 0 where it returns false.
  static constexpr bool kMayBeUndefined = false;
  // Returns the slot of a corner. slot_of may depend on flags of the model, which for_flags lists.
  template <class M>
  static int slot_of(const M&, int32_t, int) {
    return 0;
  }
  template <class M, class Body>
  static void for_flags(M&, const Body&) {}
  // Returns the corner that is the k-th other one of the slot of `corner`.
  static constexpr int other_corner(int corner, int k) { return (corner + 1 + k) % corners; }
};

// The arrays of an element. PARAMETERS(X) lists X(array of Model, columns read, columns, ArrayUse).
#define NOVAPHY_VBD_COLUMNS(array, columns, width, use) +columns
#define NOVAPHY_VBD_VISIT_COLUMNS(array, columns, width, use) body(columns, width, use);
#define NOVAPHY_VBD_VISIT_ARRAY(array, columns, width, use) body(#array, m.array, columns, use);
#define NOVAPHY_VBD_ELEMENT(INDICES, PARAMETERS)                        \
  static constexpr int kParameters = 0 PARAMETERS(NOVAPHY_VBD_COLUMNS); \
  template <class Body>                                                 \
  static void for_columns(const Body& body) {                           \
    PARAMETERS(NOVAPHY_VBD_VISIT_COLUMNS)                               \
  }                                                                     \
  template <class M, class Body>                                        \
  static void for_arrays(M& m, const Body& body) {                      \
    PARAMETERS(NOVAPHY_VBD_VISIT_ARRAY)                                 \
  }                                                                     \
  template <class M, class Body>                                        \
  static void with_indices(M& m, const Body& body) {                    \
    body(#INDICES, m.INDICES);                                          \
  }

// Puts the weights of the other corners, in their order behind `corner`: their rows of the inverse
// rest matrix {n, n}. The row of corner 0 is minus the sum of the rows.
template <int n, class T, class Put>
void put_weights(int corner, const T* pose, const Put& put) {
  for (int m = 0; m < n; ++m)
    for (int c = 0; c < n; ++c) {
      const int of = (corner + 1 + m) % (n + 1);
      if (of > 0) {
        put(n * m + c, pose[n * (of - 1) + c]);
      } else {
        T sum = pose[c];
        for (int r = 1; r < n; ++r) sum = sum + pose[n * r + c];
        put(n * m + c, -sum);
      }
    }
}

// Puts the coefficients of stable Neo-Hookean elasticity, scaled by the size at rest, from the
// number `first` on.
template <class T, class Put>
void put_neo_hookean(int first, const T& size, const T& mu, const T& lambda, const T& activation,
                     const T& kd_by_h, const Put& put) {
  using math::max;
  const T ln = lambda + mu;
  const T all[] = {size * mu, size * ln, (T(1.0f) + mu / max(ln, T(1e-6f))) - activation,
                   size * kd_by_h};
  for (int k = 0; k < 4; ++k) put(first + k, all[k]);
}

}  // namespace novaphy::vbd
