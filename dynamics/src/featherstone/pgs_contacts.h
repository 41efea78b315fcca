// The contacts and the dry friction of joints of a step of articulations, by projected Gauss-Seidel
// (articulation/pgs.h): island after island, each by one thread, its contacts in their order. So
// nothing depends on the number of threads.
#pragma once

#include <string>
#include <vector>

#include "articulation_kernels.h"
#include "contact_events.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/dynamics/articulation/active_rows.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/contact_branches.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "tree_steps.h"

namespace novaphy {

using articulation::ContactRows;
ContactRows contact_rows(const Contacts* contacts);  // host pointers; null: none

// The island of a step that is the farthest from converged (pgs.h); without sweeps none is far.
// `at` is its contact that pushes most, or -1 - that dof whose dry friction does.
struct FarIsland {
  int32_t sweeps = 0;
  float residual = 0.0f, largest = 0.0f;
  int32_t at = 0;
};
std::string describe(const FarIsland& of, const Model& model, const Articulations& articulations,
                     const ContactRows& contacts);

class PgsContacts : private TreeContacts {
 public:
  PgsContacts(const Model& model, const Articulations& articulations);

  // Whether a step has rows: contacts of bodies, or dry friction. `from`: the step's arguments, so
  // that contacts which cannot touch in it are left out; null: none is.
  bool prepare(const Model& model, const ContactRows& contacts, const ArticulationArguments* from);
  // Behind prepare: what articulation_step does for all rows, with contacts. `force` (null: not
  // asked for) {contacts}: on B, N. Where an articulation fails (`status`) before contacts, nothing
  // is written. `alone` (null: none) takes the articulations that touch nothing but the world, and
  // writes them in any case.
  void step(const ArticulationStepArguments& step, const Model& model, const ContactRows& contacts,
            const FeatherstoneOptions& options, Vec3f* force, TreeSteps* alone = nullptr);
  // The impulses {contacts} of the last step along n, t1 and t2, N s, those of dry friction {dofs}
  // (of the dofs that have it), and their branches.
  void write_impulses(Vec3f* impulses, float* friction) const;
  // `by_restitution`: for gradients by it, which an approach without any has none of: its law
  // jumps. `continues`: the step starts where the last one that was added ended.
  void add_branches(ContactBranches& to, const ContactRows& contacts,
                    const FeatherstoneOptions& options, bool by_restitution, bool continues);
  // Behind step, and before add_branches: the contacts that begin in it:
  // they approach by more than 1 mm/s, and than the forces of a step make, and did not push in the
  // step before. `qd` {dofs}: before the step.
  ContactEvents events(const ContactRows& contacts, const FeatherstoneOptions& options,
                       const float* qd, bool continues);
  // Where the links are and how they move, in the workspaces of all trees, and the poses and
  // velocities of their bodies (null: not asked for), from joint_q and joint_qd.
  void move_links(const ArticulationArguments& in, Transformf* body_q = nullptr,
                  SpatialVectorf* body_qd = nullptr);
  // The most sweeps that an island of the last step took, and the largest change of velocity (m/s)
  // of a last sweep.
  int32_t sweeps() const { return sweeps_; }
  float residual() const { return residual_; }
  FarIsland far_island() const { return far_; }  // of the last step
  // The largest force of a contact in the last step that had some, as text; empty: there was none.
  std::string largest_force(const Model& model) const;

 private:
  using Side = articulation::ContactSide;
  struct Row : articulation::IslandContact {
    int64_t numbers = 0;  // first of J and Y
  };
  struct Friction {
    int32_t tree = 0, dof = 0;  // of the tree
  };
  struct Step;

  int32_t count(int64_t tree) const override;
  int32_t fill(int64_t tree, int32_t i, float* numbers, int32_t stride) override;
  void take(int64_t tree, int32_t i, const float* impulses, int32_t stride) override;
  void solved(int64_t tree, const articulation::IslandResult& result) override;
  void split_trees(bool alone);
  bool renew_tree(const Step& step, int32_t tree, int32_t round);
  static Step make_step(const ArticulationArguments& in, const Model& model,
                        const ContactRows& contacts, const FeatherstoneOptions& options,
                        float warm_scale);
  void find_friction(const Model& model);
  void gather(const Model& model, const ContactRows& contacts, const ArticulationArguments* from);
  void find_islands();
  void build_row(const Step& step, Row& row);
  void push_impulses(float sign);               // of all rows, into the rates
  std::vector<float> free_slips();              // J_n v' of each row
  int32_t hardest_row(int64_t island) const;    // FarIsland::at
  void set_target(const Step& step, Row& row);  // behind it, at the rates without impulses
  void place_friction();
  void build_friction(const Step& step, int32_t row);
  const articulation::KeptContact* kept_of(size_t row) const;  // null: it starts from nothing
  float& kept_friction(int32_t row) {
    const Friction& f = friction_[static_cast<size_t>(row)];
    return kept_friction_[static_cast<size_t>(trees_[f.tree].first_dof + f.dof)];
  }
  void solve_island(const Step& step, int64_t island);
  void keep(const ContactRows& contacts, float dt, Vec3f* force);
  int32_t find_root(int32_t tree) {
    return articulation::find_root(
        [this](int32_t i) -> int32_t& { return root_[static_cast<size_t>(i)]; }, tree);
  }
  articulation::Workspace<float> workspace(const ArticulationRows& rows, int64_t tree);
  articulation::IslandTree island_tree(const ArticulationArguments& in, int32_t tree);
  int32_t width(int64_t tree) const { return articulation::padded_dofs(trees_[tree].dof_count); }

  const ArticulationRows* trees_;
  int64_t count_;
  std::vector<Side> of_body_;
  std::vector<uint64_t> memory_;       // workspaces
  std::vector<int64_t> memory_begin_;  // of each tree, in words
  std::vector<float> rates_;           // of each tree, padded, and shifts likewise
  std::vector<int64_t> rates_begin_;
  ArrayStamp friction_stamp_;
  std::vector<Friction> friction_;
  int64_t friction_begin_ = 0;  // of the numbers
  std::vector<Row> rows_;
  std::vector<float> numbers_;  // J and Y of the contacts, Y of the friction
  std::vector<articulation::PgsJointFriction<float>> friction_rows_;
  std::vector<int32_t> moved_by_;  // of each link: bits of the tree's dofs
  const Step* current_ = nullptr;  // while TreeSteps asks
  std::vector<int32_t> alone_, together_, islands_together_;  // trees, and islands of the latter
  std::vector<char> met_;            // trees that impulses do not move, in a row
  std::vector<char> tree_renewed_;   // in a round: its branches have changed
  std::vector<char> island_solved_;  // no tree of it has changed
  std::vector<char> island_joined_;  // more than one tree with the world, or what only we have
  std::vector<int32_t> root_, island_of_tree_, island_of_row_, island_of_friction_;
  IndexRows island_rows_, island_friction_;
  std::vector<articulation::IslandResult> island_results_;
  std::vector<articulation::KeptContact> kept_;  // of the step before
  std::vector<int32_t> warm_;                    // of each row, find_kept
  std::vector<float> kept_friction_;             // of the step before, of each dof
  float kept_dt_ = 0.0f;
  std::vector<SeenContact> seen_, seen_now_;
  int32_t sweeps_ = 0;
  float residual_ = 0.0f;
  FarIsland far_;
};

}  // namespace novaphy
