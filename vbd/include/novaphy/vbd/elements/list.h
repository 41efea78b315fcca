// The list of the elements of VBD, and functions over all elements.
//
// The slots (element.h) of particles are stored for SIMD. A group is a set of particles of the same
// color, with one particle in each SIMD lane. A group has a list of slots for each role (the type
// of a slot). A slot of a group holds one element for each lane.
//
// The memory of a slot has kOthers[role] rows with the indices of the other corners, then
// kFloats[role] rows of numbers. A row has one entry for each lane. A particle may have fewer
// elements of a role than its group has slots. Its remaining entries then have the particle's own
// index and numbers of 0.
//
// Freestanding (no standard headers), because device code includes this header.
#pragma once

#include "novaphy/vbd/elements/hinge.h"
#include "novaphy/vbd/elements/rope.h"
#include "novaphy/vbd/elements/spring.h"
#include "novaphy/vbd/elements/tetrahedron.h"
#include "novaphy/vbd/elements/triangle.h"

// Lists X(slot) for all slot types, in the order of the sums. The types of one element are
// neighbors.
#define NOVAPHY_VBD_SLOTS(X) \
  X(Spring) X(Rope) X(Triangle) X(HingeOpposite) X(HingeEnd) X(Tetrahedron)
// Lists the parameter arrays of all elements (see NOVAPHY_VBD_ELEMENT).
#define NOVAPHY_VBD_PARAMETERS(X)    \
  NOVAPHY_VBD_SPRING_PARAMETERS(X)   \
  NOVAPHY_VBD_TRIANGLE_PARAMETERS(X) \
  NOVAPHY_VBD_HINGE_PARAMETERS(X) NOVAPHY_VBD_TETRAHEDRON_PARAMETERS(X)

namespace novaphy::vbd {

// The type of a slot: which element, and for elements with several laws which kind of corner.
#define NOVAPHY_VBD_ENUMERATOR(slot) k##slot,
enum Role : int { NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_ENUMERATOR) kRoles };
template <Role>
struct RoleIs;
#define NOVAPHY_VBD_ROLE(slot)            \
  template <>                             \
  struct RoleIs<k##slot> {                \
    static constexpr Role role = k##slot; \
    using Slot = slot;                    \
  };
NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_ROLE)
template <Role role>
using SlotOf = typename RoleIs<role>::Slot;

// For each role: the count of other corners, the count of all numbers of a slot, and how many of
// them are coefficients of the law and values at the start of the step.
#define NOVAPHY_VBD_OTHERS(slot) slot::kCorners - 1,
#define NOVAPHY_VBD_FLOATS(slot) slot::kWeights + slot::kLawFloats + slot::kStartFloats,
#define NOVAPHY_VBD_LAW_FLOATS(slot) slot::kLawFloats,
#define NOVAPHY_VBD_START_FLOATS(slot) slot::kStartFloats,
constexpr int kOthers[kRoles] = {NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_OTHERS)};
constexpr int kFloats[kRoles] = {NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_FLOATS)};
constexpr int kLawFloats[kRoles] = {NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_LAW_FLOATS)};
constexpr int kStartFloats[kRoles] = {NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_START_FLOATS)};
constexpr int start_begin(int role) { return kFloats[role] - kStartFloats[role]; }
constexpr int law_begin(int role) { return start_begin(role) - kLawFloats[role]; }

// Calls body(RoleIs<role>()) for all roles, in the order of the sums.
template <class Body>
void for_roles(const Body& body) {
#define NOVAPHY_VBD_CALL(slot) body(RoleIs<k##slot>());
  NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_CALL)
}
// Calls body for the roles that are summed with the contacts (outer), or for the remaining roles.
template <bool outer, class Body>
void for_roles_that_are(const Body& body) {
  for_roles([&body](auto is) {
    if constexpr (decltype(is)::Slot::kIsOuter == outer) body(is);
  });
}
constexpr bool is_outer(int role) {
#define NOVAPHY_VBD_IS_OUTER(slot) (slot::kIsOuter && role == k##slot) ||
  return NOVAPHY_VBD_SLOTS(NOVAPHY_VBD_IS_OUTER) false;
}
// Calls body(RoleIs<role>()) for the first role of each element.
template <class Body>
void for_each_kind(const Body& body) {
  for_roles([&body](auto is) {
    if constexpr (decltype(is)::Slot::kSlot == 0) body(is);
  });
}

// The inputs of the law of a slot: positions of the own and the other corners, and the slot's
// numbers. `Numbers` is a type whose [k] is the k-th number.
template <Role role, class S, class Numbers = S[kFloats[role]]>
struct SlotInputs {
  using Scalar = S;
  Vec3<S> own, others[kOthers[role]];
  Numbers numbers;
};
// Returns the block of a slot. With B = Force returns its force alone. `turns`: H is the H_0 of
// stiffness().
template <template <class> class B = Block, Role role, class S, class N>
B<S> block_of(const SlotInputs<role, S, N>& in, bool damped, [[maybe_unused]] bool turns = false) {
  if constexpr (SlotOf<role>::kResistsTurns) {
    return SlotOf<role>::template block<B>(in, damped, turns);
  } else {
    return SlotOf<role>::template block<B>(in, damped);
  }
}

// Returns a function of displacements d that sums H_k d[k]. H_k is the stiffness between the own
// corner and itself (k = 0) or the k-th other corner.
template <Role role, class S, class N>
auto stiffness(const SlotInputs<role, S, N>& in, bool damped) {
  if constexpr (kOthers[role] == 1) {  // the force is along the line between the points
    const Block<S> block = block_of(in, damped);
    return [=](const Vec3<S>* d) { return multiply_stiffness(block, d[0] - d[1]); };
  } else {
    return SlotOf<role>::stiffness(in, damped);
  }
}
// Calls put(k, H_k) for each other corner k, then for the own corner (k = 0). The sum of all H_k is
// 0, because a translation of the element does not change the forces.
template <Role role, class S, class N, class Put>
void stiffness_of(const SlotInputs<role, S, N>& in, bool damped, const Put& put) {
  const auto times = stiffness(in, damped);
  Mat33<S> own;
  for (int k = 1; k <= kOthers[role]; ++k) {
    Mat33<S> h;
    if constexpr (SlotOf<role>::kHasBetween) {
      h = times.between(k);
    } else {
      for (int c = 0; c < 3; ++c) {
        Vec3<S> d[kOthers[role] + 1] = {};
        (c == 0 ? d[k].x : c == 1 ? d[k].y : d[k].z) = S(1.0f);
        const Vec3<S> column = times(d);
        h.m[0][c] = column.x;
        h.m[1][c] = column.y;
        h.m[2][c] = column.z;
      }
    }
    put(k, h);
    add_to(own, h);
  }
  for (auto& row : own.m)
    for (S& entry : row) entry = -entry;
  put(0, own);
}

// Calls body(parameter, array, index in the array) for each parameter of an element. `parameter`
// and `array` count from 0.
template <class Element, class Body>
void for_parameters(int64_t element, const Body& body) {
  int k = 0, array = 0;
  Element::for_columns([&](int columns, int width, ArrayUse) {
    for (int c = 0; c < columns; ++c) body(k++, array, element * width + c);
    ++array;
  });
}

// The numbers of a contact in a step: point (3), normal (3), travel (3), radius, ke, kd/h, mu. The
// last four are coefficients of the law, and have derivatives.
constexpr int kContactFloats = 13, kContactLawFloats = 4;

}  // namespace novaphy::vbd
