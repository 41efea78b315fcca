// The contacts of penalties that push in a step, or that stand within half a step of that, as the
// motion of their times sees them (diff_touches.h). On the host.
#pragma once

#include <array>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/articulation/gradient_counts.h"

namespace novaphy::diff::detail {

using Vec3d = Vec3<double>;
using Columns3 = std::array<Vec3d, 3>;

struct TouchOptions {
  bool rigid = false, soft = false;  // which contacts act
  float smoothing = 0.0f;            // m/s, of friction between bodies
  float kf_rate = 0.0f;              // 1/s, of friction of particles
  float dt = 0.0f;
};

// A body or a particle; neither: the world.
struct TouchSide {
  int32_t body = -1, particle = -1;
  bool responds = false;  // to forces
  Vec3d arm{};            // of a body: from its center of mass to the contact, world frame
  bool exists() const { return body >= 0 || particle >= 0; }
  bool is(const TouchSide& other) const {
    return exists() && body == other.body && particle == other.particle;
  }
};

// The force acts on side 1, its opposite on side 0. With P the points where the sides meet, v their
// velocities and n the normal, the gap is n . (P_0 - P_1), and u = v_0 - v_1.
struct TouchRow {
  int32_t first = 0, second = 0, point = 0;  // pair as in ContactPair, and the point of it
  std::array<TouchSide, 2> sides;
  Vec3d normal{}, force{};
  double gap = 0.0, speed = 0.0;  // m, m/s: n . u
  double inverse_mass = 0.0;      // 1/kg, along n
  double stiffness = 0.0;         // N/m
  double slip_taken = 0.0;        // by friction below its cone, in a step: a part of the slip
  double speed_taken = 0.0;       // by damping, likewise: a part of the approach
  bool pushes = false;
  bool slides = false;   // its friction is at the cone
  bool adheres = false;  // acts beyond the gap 0
  // Within half a step of the gap 0: what the force averaged over that step has by the gap and by u
  // (columns) besides what the force as it is has. The force that jumps at the gap 0 is a part.
  bool ramp = false;
  Vec3d by_gap{};
  Columns3 by_velocity{};
};

// Replaces the rows.
void find_touches(const Model& model, const SimState& state, const Contacts& contacts,
                  const TouchOptions& options, std::vector<TouchRow>& rows);

}  // namespace novaphy::diff::detail
