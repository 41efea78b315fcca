// A bending edge in VBD: a rotational spring and damper between two triangles.
//
// Law, for the edge from vertex 2 to vertex 3 and the opposite vertices 0 and 1. The header
// math/hinge.h gives the unit normals n1 and n2 of the triangles, with the lengths N1 and N2 before
// normalization. The header also gives the unit vector e along the edge, the length |e| of the
// edge, and the bending angle th.
//
// The step size is h, and thn is the angle at the start of the step. The function wrap adds or
// subtracts one turn, so that the result is in (-pi, pi]:
//   E = ke L/2 (th - rest)^2 + kd L/(2h) wrap(th - thn)^2
//   f = -(ke L (th - rest) + kd L/h wrap(th - thn)) t,  H = (ke + kd/h) L t t^T,  t = dth/dx
//   dth/dx0 = -n1 |e|/N1                      dth/dx2 = n1 ((x3-x0).e)/N1 + n2 ((x3-x1).e)/N2
// H is the Gauss-Newton part of the second derivative: rank 1, positive semidefinite. The formulas
// for the vertices 1 and 3 follow from those for 0 and 2, because the same edge can be read from
// its other side. The force is 0 where a length is < 1e-6.
// Symbols: x (m), L = rest length of the edge (m), ke (N/m^2 per rad), kd (N*s/m^4), angles (rad).
//
// Source: the closed form of Bridson, Marino, Fedkiw (2003) and Tamstorf, Grinspun (2013).
// SolverVBD of Newton 1.8.0 has the same law. (The semi-implicit solver multiplies ke by the
// current length of the edge instead.)
// Not smooth: a full fold, where th jumps by one turn; lengths of 1e-6.
// Gradient: exact in x, ke, kd, L, rest and thn, except where the law is not smooth.
#pragma once

#include "novaphy/math/hinge.h"
#include "novaphy/vbd/elements/element.h"

#define NOVAPHY_VBD_HINGE_PARAMETERS(X)          \
  X(particle_edge_material, 2, 2, kMaterial)     \
  X(particle_edge_rest_angle, 1, 1, kRestLength) \
  X(particle_edge_rest_length, 1, 1, kRestLength)

namespace novaphy::vbd {

// The numbers of a slot (one corner of a hinge): ke L and (kd / h) L, with the length L of the edge
// and the step h; the rest angle (rad); and the angle at the start of the step.
struct Hinge : ElementOf<4> {
  static constexpr int kLawFloats = 3, kStartFloats = 1, kDampingParameter = 1;
  static constexpr int kSlots = 2;  // HingeOpposite and HingeEnd
  static constexpr bool kMayLackCorners = true, kMayBeUndefined = true, kHasBetween = true;
  NOVAPHY_VBD_ELEMENT(particle_edge_indices, NOVAPHY_VBD_HINGE_PARAMETERS)

  template <class M>
  static int slot_of(const M&, int32_t, int corner) {
    return corner / 2;
  }
  // The corners 1 and 3 read the edge from the other side than the corners 0 and 2.
  static constexpr int other_corner(int corner, int k) {
    return (k < (corner & 2) ? k : k + 1) ^ (corner & 1);
  }
  template <class S>
  static S wrapped(const S& angle) {
    using math::select;
    const S pi = S(0x1.921fb6p+1f), turn = S(0x1.921fb6p+2f);
    return select(angle > pi, angle - turn, select(angle < -pi, angle + turn, angle));
  }
  // Return dth/dx: for an opposite vertex whose triangle has the unit normal n (length N before
  // normalization), and for the end x2 of the edge.
  template <class S>
  static Vec3<S> turning_of_opposite(const Vec3<S>& n, const S& n_length, const math::Hinge<S>& h) {
    return n * (-(h.e_length / n_length));
  }
  template <class S>
  static Vec3<S> turning_of_end(const math::Hinge<S>& h, const Vec3<S>& x0, const Vec3<S>& x1,
                                const Vec3<S>& x3) {
    return h.n1 * (math::dot(x3 - x0, h.e) / h.n1_length) +
           h.n2 * (math::dot(x3 - x1, h.e) / h.n2_length);
  }
  template <class T, class Put>
  static void put_numbers(int, const T* p, const T& h, const Put& put) {
    put(0, p[0] * p[3]);
    put(1, (p[1] / h) * p[3]);
    put(2, p[2]);
  }
};

// The law for both types of slots. `Slot` maps the inputs to the vertices 0 to 3, and returns
// dth/dx of its own vertex.
template <class Slot>
struct HingeSlot : Hinge {
  template <class V>
  struct ByVertex {
    V x0, x1, x2, x3;
  };
  template <class S>
  static auto is_defined_by(const math::Hinge<S>& h) {
    using math::both;
    const S smallest = S(1e-6f);
    return both(h.n1_length >= smallest, both(h.n2_length >= smallest, h.e_length >= smallest));
  }
  template <class In>
  static auto is_defined(const In& in) {
    return is_defined_by(Slot::hinge(in));
  }
  template <template <class> class B = Block, class In>
  static auto block(const In& in, bool) {
    using S = typename In::Scalar;
    const S ke = in.numbers[0], kd_by_h = in.numbers[1];
    const math::Hinge<S> h = Slot::hinge(in);
    const Vec3<S> t = Slot::turning(in, h);
    const S moment = ke * (h.angle - in.numbers[2]) + kd_by_h * wrapped(h.angle - in.numbers[3]);
    B<S> block;
    block.f = t * (-moment);
    add_outer(block, ke + kd_by_h, t);
    return where(is_defined_by(h), block);
  }
  template <class In>
  static auto energy(const In& in) {
    using math::select;
    using S = typename In::Scalar;
    const math::Hinge<S> h = Slot::hinge(in);
    const S bent = h.angle - in.numbers[2], moved = wrapped(h.angle - in.numbers[3]);
    const S energy = S(0.5f) * ((in.numbers[0] * bent) * bent + (in.numbers[1] * moved) * moved);
    return select(is_defined_by(h), energy, S(0.0f));
  }
  // A function of displacements d that sums H_0k d_k. H_0k is the stiffness between the own corner
  // and the k-th other corner.
  template <class V, class S>
  struct Stiffness {
    ByVertex<V> turning;  // dth/dx
    V own;                // dth/dx of the own corner, times the stiffness
    V operator()(const V* d) const {
      const ByVertex<V> by = Slot::by_vertex(d);
      // The sum of dth/dx over the vertices is 0, because a translation keeps the angle.
      return own * ((math::dot(turning.x0, by.x0 - by.x3) + math::dot(turning.x1, by.x1 - by.x3)) +
                    math::dot(turning.x2, by.x2 - by.x3));
    }
    // Returns H_0k.
    Mat33<S> between(int k) const { return outer_product(own, Slot::of_corner(turning, k)); }
  };
  template <class In>
  static auto stiffness(const In& in, bool) {
    using math::select;
    using S = typename In::Scalar;
    const math::Hinge<S> h = Slot::hinge(in);
    const auto is_defined = is_defined_by(h);
    const auto kept = [&](const Vec3<S>& v) { return select(is_defined, v, Vec3<S>{}); };
    ByVertex<Vec3<S>> turning = {kept(turning_of_opposite(h.n1, h.n1_length, h)),
                                 kept(turning_of_opposite(h.n2, h.n2_length, h)),
                                 kept(Slot::turning_of_x2(in, h)),
                                 {}};
    turning.x3 = -((turning.x0 + turning.x1) + turning.x2);
    const S stiffness = in.numbers[0] + in.numbers[1];
    return Stiffness<Vec3<S>, S>{turning, kept(Slot::turning(in, h)) * stiffness};
  }
  template <class In, class Put>
  static void put_start(const In& in, const Put& put) {
    put(0, Slot::hinge(in).angle);
  }
};
// The slot of an opposite vertex, which is x0 of the law.
struct HingeOpposite : HingeSlot<HingeOpposite> {
  template <class V>
  static ByVertex<V> by_vertex(const V* d) {
    return {d[0], d[1], d[2], d[3]};
  }
  template <class V>
  static const V& of_corner(const ByVertex<V>& by, int k) {
    return k == 1 ? by.x1 : k == 2 ? by.x2 : by.x3;
  }
  template <class In>
  static auto hinge(const In& in) {
    return math::make_hinge(in.own, in.others[0], in.others[1], in.others[2]);
  }
  template <class In, class S>
  static auto turning(const In&, const math::Hinge<S>& h) {
    return turning_of_opposite(h.n1, h.n1_length, h);
  }
  template <class In, class S>
  static auto turning_of_x2(const In& in, const math::Hinge<S>& h) {
    return turning_of_end(h, in.own, in.others[0], in.others[2]);
  }
};
// The slot of an end of the edge, which is x2 of the law.
struct HingeEnd : HingeSlot<HingeEnd> {
  static constexpr int kSlot = 1;
  template <class V>
  static ByVertex<V> by_vertex(const V* d) {
    return {d[1], d[2], d[0], d[3]};
  }
  template <class V>
  static const V& of_corner(const ByVertex<V>& by, int k) {
    return k == 1 ? by.x0 : k == 2 ? by.x1 : by.x3;
  }
  template <class In>
  static auto hinge(const In& in) {
    return math::make_hinge(in.others[0], in.others[1], in.own, in.others[2]);
  }
  template <class In, class S>
  static auto turning(const In& in, const math::Hinge<S>& h) {
    return turning_of_end(h, in.others[0], in.others[1], in.others[2]);
  }
  template <class In, class S>
  static auto turning_of_x2(const In& in, const math::Hinge<S>& h) {
    return turning(in, h);
  }
};

}  // namespace novaphy::vbd
