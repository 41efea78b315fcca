// Friction that the contact law leaves open: of contacts of one pair of bodies whose normal rows
// depend on each other, and that slide in different directions.
//
// The law determines the sum of such pushes, and not the push of each contact. Each push times the
// coefficient of friction acts along its own slip. The solve chooses pushes, but their derivative
// is not that of the equations of the active rows. Freestanding: shared by host and device kernels.
#pragma once

#include "novaphy/dynamics/articulation/active_rows.h"

namespace novaphy::articulation {

// A row that other rows give up to this fraction of its length depends on them.
inline constexpr float kDependent = 0.1f;
// Distance of two unit vectors along the slips. Gradients of a box are 2 % off at this distance.
inline constexpr float kSlipsApart = 0.4f;
// m/s. A contact at the border of its cone may still stick: other contacts hold the body.
inline constexpr float kMoves = 1e-3f;
// A compliance above this part of the mobility of the row determines the push.
inline constexpr float kCompliant = 1e-3f;

// The pushing contacts of a pair, one after the other.
struct PairPushes {
  SpatialVectorf basis[6] = {};
  int32_t count = 0;
  bool is_dependent = false, has_slip = false, slips_apart = false;
  Vec3f slip{};

  // Adds a normal row: the direction of its force, and its moment about the first contact relative
  // to the largest arm.
  void add(SpatialVectorf row) {
    const float whole = math::sqrt(math::dot(row, row));
    for (int32_t k = 0; k < count; ++k) row = row - basis[k] * math::dot(basis[k], row);
    const float rest = math::sqrt(math::dot(row, row));
    if (count == 6 || rest < kDependent * whole) {
      is_dependent = true;
    } else {
      basis[count++] = row * (1.0f / rest);
    }
  }
  void add_slip(const Vec3f& direction) {
    if (!has_slip) slip = direction;
    slips_apart = slips_apart || math::length(direction - slip) > kSlipsApart;
    has_slip = true;
  }
};

// Returns whether two contacts have the same links.
inline bool same_links(const IslandContact& a, const IslandContact& b) {
  for (int side = 0; side < 2; ++side)
    if (a.sides[side].tree != b.sides[side].tree || a.sides[side].link != b.sides[side].link)
      return false;
  return true;
}

// Returns whether the law leaves the friction of contacts of one pair open.
inline bool has_open_friction(const IslandContact* rows, int32_t count, bool cone) {
  float reach = 0.0f;
  for (int32_t n = 1; n < count; ++n)
    reach = math::max(reach, math::length(rows[n].place.a - rows[0].place.a));
  if (!(reach > 0.0f)) return false;
  PairPushes pair;
  for (int32_t n = 0; n < count; ++n) {
    const PgsContact<float>& c = rows[n].solver;
    const ContactBranch branch = branch_of(c, cone);
    if (!branch.active) continue;
    if (c.cfm > kCompliant * c.normal) return false;
    const Vec3f* const axes = rows[n].frame.axes;
    const Vec3f arm = (rows[n].place.a - rows[0].place.a) * (1.0f / reach);
    pair.add({axes[0], math::cross(arm, axes[0])});
    const float along = tangent_length(c.impulse[1], c.impulse[2]);
    const bool moves = tangent_length(slip(c, 1), slip(c, 2)) > kMoves;
    if ((branch.slides[0] || branch.slides[1]) && moves && along > 0.0f)
      pair.add_slip(axes[1] * (c.impulse[1] / along) + axes[2] * (c.impulse[2] / along));
  }
  return pair.is_dependent && pair.slips_apart;
}

}  // namespace novaphy::articulation
