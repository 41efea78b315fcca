// The common part of the elements of VBD.
//
// A sweep sees an element from one of its particles: as a slot. The struct of an element (spring.h)
// says all that the solver asks of it, and is the slot of its corners. An element whose corners
// have different laws (hinge.h) has a struct for each slot besides.
//
// The numbers of a slot are weights of the other corners, the law, and room for what the law needs
// of the start of the step. Parameters are what the numbers are made of: columns of arrays of
// Model.
//
// Freestanding: device code reads it too. The scalar is a float, lanes of floats, carries a
// derivative (math/dual.h), or is an expression (tools/vbd_adjoints).
#pragma once

#include "novaphy/vbd/stiffness_law.h"

namespace novaphy::vbd {

// The meaning of the columns of an array. kMaterial: an element acts where one is not 0.
enum ArrayUse : int { kMaterial, kRestShape, kRestLength, kActivation };

constexpr int kMostArrays = 4, kMostSlots = 2;  // of parameters and of slots of an element

// The base of the struct of an element, with what holds where the struct says nothing. The struct
// also has kLawFloats and kStartFloats, the numbers of the law and of the start; kDampingParameter;
// block(in, damped) and energy(in); put_start(in, put) and put_numbers(corner, parameters, h, put),
// which call put(k, value) for the k-th number of the start and of the slot. With more than two
// corners the struct has stiffness(in, damped, put). The function calls put(k, H) with the
// stiffness (stiffness_law.h) between the own corner and itself (k = 0) or the k-th other one.
template <int corners>
struct ElementOf {
  static constexpr int kCorners = corners;
  static constexpr int kWeights = 0;              // numbers of a slot
  static constexpr int kActivated = -1;           // the number that an activation changes; -1: none
  static constexpr int kSlots = 1, kSlot = 0;     // slots of the element, and which one this is
  static constexpr bool kIsOuter = false;         // summed with contacts, before the inertia
  static constexpr bool kIsAlwaysDamped = false;  // else without damping where all of it is 0
  static constexpr bool kResistsTurns = false;  // H of block() holds more than that of stiffness()
  static constexpr bool kMayLackCorners = false;
  static constexpr const char* kUnread = "";  // the columns of its material that no force reads
  // Derivatives are 0 where is_defined(in) does not hold.
  static constexpr bool kMayBeUndefined = false;
  // Which slot of the element a corner has, by flags of the model, and these flags.
  template <class M>
  static int slot_of(const M&, int32_t, int) {
    return 0;
  }
  template <class M, class Body>
  static void for_flags(M&, const Body&) {}
  // Which corner is the k-th other one of a slot.
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

// Weights of the corners behind `corner`: their rows of the inverse rest matrix {n, n}. The row of
// corner 0 is minus the sum of the others.
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

// The law of stable Neo-Hookean elasticity, scaled by the size at rest, from the number `first` on.
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
