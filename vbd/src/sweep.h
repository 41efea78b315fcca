// The work of VBD on groups of particles, compiled for several instruction sets, and the tables
// that it reads.
//
// A group is `lanes` particles of one colour (the last one of a colour may be short); slots are
// those of slot_layout_law.h.
#pragma once

#include <cstdint>

#include "novaphy/vbd/slot_layout_law.h"

namespace novaphy::vbd {

struct SlotTable {
  const int64_t* begin = nullptr;  // groups + 1: the slots of a group
  const int32_t* ints = nullptr;
  float* floats = nullptr;
  bool damped = false;  // a coefficient kd is not 0
};

struct Sweep {
  const int32_t* particle = nullptr;  // of each lane of each group
  const int32_t* filled = nullptr;    // lanes of a group that are particles
  const float* mass_by_h2 = nullptr;  // of each lane; 1 where it is none
  SlotTable slots[kRoles];
  // Of the contacts of a step, in slot order for each particle; null without contacts.
  const int32_t* contact_begin = nullptr;  // particles + 1
  const float* contacts = nullptr;

  // Rows of 4 floats, one per particle.
  const float* start = nullptr;   // xn
  const float* target = nullptr;  // y
  float* moved = nullptr;         // x - xn
  float* x = nullptr;
  float* step = nullptr;  // where colours hold conflicts: the steps until all of a colour are there

  float regularization = 0.0f, slip = 0.0f;
  bool safeguard = false;
};

// What residuals are sums of, per particle: |f|^2, |M (y - xn)/h^2|^2, and the square of what
// one rounding of the positions changes f by.
struct ParticleResidual {
  float force = 0.0f, inertia = 0.0f, rounding = 0.0f;
};

// Derivatives of a scalar, called bars, as a sweep in reverse reads and makes them. Rows of 4
// floats per particle, and per slot rows of lanes. "Added to" unless said otherwise.
struct Adjoint {
  float* x =
      nullptr;  // by the positions: what u is solved from, and what particles add to their own
  const float* multiplier = nullptr;  // u itself, instead
  float* multiplier_sum = nullptr;    // of u; null: not wanted
  float* start = nullptr;             // by xn
  float* target = nullptr;            // by y
  float* mass_by_h2 = nullptr;        // per particle
  float* contacts = nullptr;          // kContactLawFloats for each contact of the step
  float* others[kRoles] = {};         // written: per slot, 3 rows for each other particle
  float* numbers[kRoles] = {};        // per slot, by all its numbers
  bool weights = false;               // the weights of slots are among what derivatives are by
  bool at_rest = false;  // at a solution, where f = 0: the derivative of f alone, with d = 0
};

// Derivatives along a direction, as a sweep forwards reads and makes them. Rows as in Adjoint;
// null: they are 0.
struct Tangents {
  const float* x = nullptr;
  const float* start = nullptr;
  const float* target = nullptr;
  const float* mass_by_h2 = nullptr;  // per particle
  const float* contacts = nullptr;    // kContactLawFloats for each contact of the step
  float* numbers[kRoles] = {};        // per slot, of all its numbers; read by `tangent`
  const float* load = nullptr;        // added to the derivative of f before it is solved with
  bool at_rest = false;               // as in Adjoint
  bool keeps_loads = false;           // of friction, as its energy does: f has a potential then
  // Written, where not null: f, its derivative, and that of the steps of the particles.
  float* force = nullptr;
  float* force_slope = nullptr;
  float* step_slope = nullptr;
};

struct SweepLevel {
  const char* name;
  int lanes;
  void (*prepare)(const Sweep&, int64_t group);  // the starts of the slots
  void (*move)(const Sweep&, int64_t group);     // one step of every particle of the group
  void (*residual)(const Sweep&, int64_t group, ParticleResidual* of_particles);
  // In reverse, at the positions before the colour: see differentiable_vbd.h.
  void (*adjoint)(const Sweep&, const Adjoint&, int64_t group);
  // What the slots have of the start: from their bars to those of xn (own and others).
  void (*adjoint_start)(const Sweep&, const Adjoint&, int64_t group);
  // Forwards, at the positions before the colour; and of what the slots have of the start.
  void (*tangent)(const Sweep&, const Tangents&, int64_t group);
  void (*tangent_start)(const Sweep&, const Tangents&, int64_t group);
};

// The level of NOVAPHY_CPU_ISA, else the best of this processor. ErrorKind::Runtime: the variable
// names none that this processor has.
const SweepLevel& sweep_level();
// That of groups of so many lanes.
const SweepLevel& sweep_level_of(int64_t lanes);

}  // namespace novaphy::vbd
