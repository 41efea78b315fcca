// The common base of the elements of VBD: springs, triangles, bending edges and tetrahedra.
//
// A corner of an element is a particle that the element connects. A slot is the incidence of an
// element and one of its corners. The sweep reads a slot to move that corner. The struct of an
// element (spring.h) describes the element for the solver, and is also the type of its slots. An
// element whose corners have different laws (hinge.h) has one more struct for each type of slot.
//
// A slot stores floats ("numbers" in the code): the weights of the other corners, the coefficients
// of the law, and values at the start of the step. The weights and coefficients depend on
// parameters, which are columns of arrays of Model.
//
// Freestanding (no standard headers), because device code includes this header. The scalar is a
// float, SIMD lanes of floats, a dual number (math/dual.h), or a symbolic expression
// (tools/vbd_adjoints).
#pragma once

#include "novaphy/vbd/stiffness_law.h"

namespace novaphy::vbd {

// The meaning of the columns of an array. kMaterial: coefficients of the law. An element is skipped
// if all its coefficients are 0.
enum ArrayUse : int { kMaterial, kRestShape, kRestLength, kActivation };

constexpr int kMostArrays = 4, kMostSlots = 2;  // the most parameter arrays and slots of an element

// The base of the struct of an element, with default values. The struct also defines:
// - kLawFloats and kStartFloats: counts of a slot's coefficients, and of its values at the start of
// the step; kDampingParameter: index of kd among the parameters;
// - block<B>(in, damped): the Block or Force of the slot's own corner; energy(in): the energy (J);
// - put_start(in, put) and put_numbers(corner, parameters, h, put): compute the values at the start
// of the step and the other numbers of a slot, and call put(k, value) for each of them;
// - stiffness(in, damped), if the element has more than two corners: returns a function of
// displacements d that sums H_k d[k]. H_k is the stiffness (stiffness_law.h) between the own corner
// and itself (k = 0) or another corner. If kHasBetween is true, the function has a member
// between(k) that returns H_k for k > 0.
template <int corners>
struct ElementOf {
  static constexpr int kCorners = corners;
  static constexpr int kWeights = 0;     // count of weights among a slot's numbers
  static constexpr int kActivated = -1;  // index of the number that an activation changes; -1: none
  // number of slot types of the element, and the index of this type
  static constexpr int kSlots = 1, kSlot = 0;
  static constexpr bool kIsOuter = false;         // summed with the contacts, before the inertia
  static constexpr bool kIsAlwaysDamped = false;  // false: without damping terms if all kd are 0
  static constexpr bool kResistsTurns = false;    // H of block() is larger than H_0 of stiffness()
  static constexpr bool kHasBetween = false;      // stiffness() has the member between(k)
  static constexpr bool kMayLackCorners = false;
  static constexpr const char* kUnread = "";  // columns of the material that no force uses
  // True: the struct has is_defined(in), which returns whether the law is defined. If not,
  // derivatives are 0.
  static constexpr bool kMayBeUndefined = false;
  // Returns the index of the slot type of a corner. The index may depend on arrays of flags of the
  // model, which for_flags lists.
  template <class M>
  static int slot_of(const M&, int32_t, int) {
    return 0;
  }
  template <class M, class Body>
  static void for_flags(M&, const Body&) {}
  // Returns the index of the k-th other corner, in the order in which the slot of `corner` lists
  // them.
  static constexpr int other_corner(int corner, int k) { return (corner + 1 + k) % corners; }
};

// Declares the index array and the parameter arrays of an element. PARAMETERS(X) lists X(array of
// Model, count of columns that the law reads, count of all columns, ArrayUse) for each array.
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

// Computes the weights of the other corners of a slot, in the order of other_corner. The weights of
// corner m > 0 are row m - 1 of the inverse rest matrix {n, n}. The weights of corner 0 are minus
// the sum of these rows.
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

// Computes the four coefficients of stable Neo-Hookean elasticity: size mu, size ln, alpha and
// size kd/h (triangle.h). `size` is the rest area or volume. `first` is the index of the first one.
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
