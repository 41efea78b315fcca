// A body as the rows of a step use it: pose, inverse mass and inertia.
#pragma once

#include <algorithm>

#include "bodies.h"

namespace novaphy::vbd {

constexpr float kMetric = 100.0f;  // rho over the inertial stiffness 1/(h^2 w)
constexpr float kRecall = 0.999f;  // factor of the previous step's multipliers

// A body of a row. The world and kinematic bodies have the inverse mass and inertia 0.
struct BodySide {
  BodySide(const Model& m, const SimState& in, const int32_t* kinematic, int32_t body) {
    if (body < 0) return;
    pose = in.body_q.data()[body];
    center = math::transform_point(pose, m.body_com.data()[body]);
    if (kinematic[body] != 0) return;
    moves = true;
    inv_mass = m.body_inv_mass.data()[body];
    inv_inertia = m.body_inv_inertia.data()[body];
  }
  // mobility() returns the inverse effective mass (1/kg) along n of the point at the lever `arm`.
  // turning() returns the inverse inertia about n.
  float mobility(const Vec3f& arm, const Vec3f& n) const {
    return inv_mass + turning(math::cross(arm, n));
  }
  float turning(const Vec3f& n) const {
    const Vec3f local = math::rotate_inverse(pose.q, n);
    return math::dot(local, math::multiply(inv_inertia, local));
  }
  Transformf pose = Transformf::identity();
  Vec3f center{};
  bool moves = false;
  float inv_mass = 0.0f;
  Mat33f inv_inertia{};
};

inline float metric(float dt, float mobility) { return kMetric / (dt * dt * mobility); }

}  // namespace novaphy::vbd
