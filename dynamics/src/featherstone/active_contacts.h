// The contacts that push an articulation in a step of SolverFeatherstone, and the null space of
// their normals, for sensitivities with frozen dynamics: contact_rows.h, by islands.h.
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

  // Behind the step's free_rates of the tree: the contacts that push in the step that wrote
  // `contacts` (null: none) and `after`, with their rows. `user` starts the messages.
  // ErrorKind::Index: shapes that are not there; ErrorKind::NotImplemented: one pushes a dof of
  // another articulation too.
  void find(const Model& model, const Contacts* contacts, const SimState& after,
            const articulation::Tree<float>& tree, articulation::Workspace<float>& ws,
            const char* user);
  bool empty() const { return rows_.empty(); }
  // Behind find. What their impulses do to the rates of the tree's dofs (qd_next), and what they
  // push those with (given); the result is the largest sum of the sizes that a rate is made of.
  float push(float dt, articulation::Workspace<float>& ws);
  // v - M^-1 N^T (N M^-1 N^T)^-1 N v, N the normals' rows: the nearest change of rates (by M) that
  // opens and closes none. What normals make up of others counts once.
  void project(float* v);

 private:
  struct Place {
    int32_t link = -1;   // of the tree
    bool moves = false;  // with a dof of another articulation
  };
  std::vector<Place> of_body_;
  int32_t dofs_ = 0;
  std::vector<float> rates_;    // padded
  std::vector<float> numbers_;  // J and Y
  std::vector<double> system_;
  std::vector<articulation::IslandContact> rows_;
  std::vector<Vec3f> force_;  // of each row, on B, N
  // Of each row as build_contact reads it, with bodies that stay in the world as points of it.
  std::vector<Vec3f> point0_, point1_, normal_;
  std::vector<float> margin0_, margin1_;
};

}  // namespace novaphy
