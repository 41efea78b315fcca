// How the slots of a sweep lie in memory: an element seen from one particle, as rows of numbers.
//
// A group is some particles of one color, its lanes. The group has slots for each role of an
// element. Slot s of a group is one element for each lane: kInts[role] rows of indices, then
// kFloats[role] rows of constants, with a number for each lane in a row. A lane with fewer elements
// of a role reads, in the rest of its slots, itself and coefficients of 0.
//
// Freestanding: device code reads it too.
#pragma once

namespace novaphy::vbd {

enum Role : int { kSpring, kTriangle, kHingeOpposite, kHingeEnd, kTetrahedron, kRoles };

// Indices: the other particles. Constants: the weights of the other particles, the law, and room
// for what the slot needs of the start of the step.
//   spring        x1;          ke, kd/h, rest; length
//   triangle      x1, x2;      w1 (2), w2 (2), mu, ln, alpha, kd/h; strain (3)
//   hinge         the four;    ke, kd/h, rest; angle
//   tetrahedron   x1, x2, x3;  w1, w2, w3 (3 each), mu, ln, alpha, kd/h; strain (6)
constexpr int kInts[kRoles] = {1, 2, 4, 4, 3};
constexpr int kFloats[kRoles] = {4, 11, 4, 4, 19};
constexpr int kStartFloats[kRoles] = {1, 3, 1, 1, 6};  // the last ones

// kLawFloats: how many constants are parameters of the law; they precede the last ones. kOthers:
// the number of other particles. kOwnPlace: the index of the particle itself among the four of a
// hinge.
constexpr int kLawFloats[kRoles] = {3, 4, 3, 3, 4};
constexpr int start_begin(int role) { return kFloats[role] - kStartFloats[role]; }
constexpr int law_begin(int role) { return start_begin(role) - kLawFloats[role]; }
constexpr int kOthers[kRoles] = {1, 2, 3, 3, 3};
constexpr int kOwnPlace[kRoles] = {-1, -1, 0, 2, -1};
constexpr int kCorners[kRoles] = {2, 3, 4, 4, 4};  // of an element
// The row of indices of the k-th other.
template <int role>
constexpr int other_place(int k) {
  return kOwnPlace[role] < 0 || k < kOwnPlace[role] ? k : k + 1;
}

template <Role of>
struct RoleIs {
  static constexpr Role role = of;
};
// Calls body(RoleIs<role>()) in the order of sums.
template <class Body>
void for_inner_roles(const Body& body) {
  body(RoleIs<kTriangle>());
  body(RoleIs<kHingeOpposite>());
  body(RoleIs<kHingeEnd>());
  body(RoleIs<kTetrahedron>());
}
template <class Body>
void for_roles(const Body& body) {
  body(RoleIs<kSpring>());
  for_inner_roles(body);
}

// A contact of a particle in the step: point (3), normal (3), travel (3), radius, ke, kd/h, mu.
// Derivatives are by the last four.
constexpr int kContactFloats = 13, kContactLawFloats = 4;

}  // namespace novaphy::vbd
