// The penalty contacts that push in a step, and those within half a step of touching, for the
// derivatives of event times (diff_touches.h). Runs on the host.
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
  bool rigid = false, soft = false;  // which kinds of contacts act
  float smoothing = 0.0f;            // m/s: slip below which friction of bodies is smoothed
  float kf_rate = 0.0f;              // 1/s, symbol r of diff_soft_contact_trace.h, for particles
  float dt = 0.0f;
};

// One side of a contact: a body, a particle, or the world if neither index is set.
struct TouchSide {
  int32_t body = -1, particle = -1;
  bool responds = false;  // whether forces move this side
  Vec3d arm{};            // of a body: from its center of mass to the contact, world frame
  bool exists() const { return body >= 0 || particle >= 0; }
  bool is(const TouchSide& other) const {
    return exists() && body == other.body && particle == other.particle;
  }
};

// A contact. The force acts on side 1, its opposite on side 0. P_0, P_1 are the surface points of
// the sides, v_0, v_1 their velocities, and n is the normal. The gap is n . (P_0 - P_1), and u =
// v_0 - v_1.
struct TouchRow {
  int32_t first = 0, second = 0, point = 0;  // the pair as in ContactPair, and the point of the
                                             // pair
  int32_t row = 0;                           // row in Contacts
  std::array<TouchSide, 2> sides;
  Vec3d normal{}, force{};
  double gap = 0.0, speed = 0.0;  // m; m/s, n . u
  double inverse_mass = 0.0;      // 1/kg, along n
  double stiffness = 0.0;         // N/m
  double slip_taken = 0.0;        // fraction of the slip that friction below its cone removes in a
                                  // step
  double speed_taken = 0.0;       // fraction of the approach speed that damping removes in a step
  bool pushes = false;
  bool slides = false;   // friction is at the cone
  bool adheres = false;  // the force acts beyond the gap 0 too
  // Set within half a step of the gap 0. by_gap and by_velocity (by columns) are then the
  // derivatives of the force averaged over that step, minus those of the force itself. Both include
  // the jump of the force at the gap 0.
  bool ramp = false;
  Vec3d by_gap{};
  Columns3 by_velocity{};
};

// Finds the contacts of a state and replaces the contents of `rows` by them.
void find_touches(const Model& model, const StateFields& state, const ContactFields& contacts,
                  const TouchOptions& options, std::vector<TouchRow>& rows);

}  // namespace novaphy::diff::detail
