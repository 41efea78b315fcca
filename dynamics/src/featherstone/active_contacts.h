// ActiveContacts: the contacts that push one articulation in a step of SolverFeatherstone. The file
// also has the projection onto the rates that do not change the velocities along the contact
// normals. ControlSensitivity with frozen dynamics uses both.
#pragma once

#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/articulation/islands.h"
#include "novaphy/dynamics/featherstone/articulations.h"

namespace novaphy {

class ActiveContacts {
 public:
  ActiveContacts(const Model& model, const Articulations& articulations, int32_t articulation);

  // Finds the contacts with a positive normal force, after free_rates of the step. `contacts`
  // (null: none) and `after` are from that step of the solver. `user` starts the messages.
  // ErrorKind::Index: a shape does not exist. ErrorKind::NotImplemented: a contact also pushes
  // another articulation that can move.
  void find(const Model& model, const Contacts* contacts, const SimState& after,
            const articulation::Tree<float>& tree, articulation::Workspace<float>& ws,
            const char* user);
  bool empty() const { return rows_.empty(); }
  // Adds the contact impulses to the rates ws.qd_next, and writes the generalized impulses to
  // ws.given. Call this after find. Returns the largest intermediate rate, the scale of rounding
  // errors.
  float push(float dt, articulation::Workspace<float>& ws);
  // Projects the change v of the rates to v - M^-1 N^T (N M^-1 N^T)^-1 N v, where the rows of N
  // belong to the normals. The result is the nearest change (in the norm of M) that leaves every
  // normal velocity unchanged. Linearly dependent normals count once.
  void project(float* v);

 private:
  struct Place {
    int32_t link = -1;   // in the tree
    bool moves = false;  // belongs to another articulation, by a joint with dofs
  };
  std::vector<Place> of_body_;
  int32_t dofs_ = 0;
  std::vector<float> rates_;    // {padded dofs}
  std::vector<float> numbers_;  // the Jacobians J and the responses Y = M^-1 J^T
  std::vector<double> system_;
  std::vector<articulation::IslandContact> rows_;
  std::vector<Vec3f> force_;  // contact force of each row on body B, N
  // The contact rows in the form that build_contact reads. Points of bodies outside of the tree are
  // in the world frame.
  std::vector<Vec3f> point0_, point1_, normal_;
  std::vector<float> margin0_, margin1_;
};

}  // namespace novaphy
