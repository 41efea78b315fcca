#include "novaphy/dynamics/featherstone/solver_featherstone.h"

#include <algorithm>
#include <cstring>
#include <initializer_list>
#include <utility>

#include "../semi_implicit/rigid_bodies.h"
#include "articulation_kernels.h"
#include "articulation_step.h"
#include "launched_articulations.h"
#include "novaphy/core/error.h"
#include "novaphy/core/storage.h"
#include "novaphy/core/warning.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"
#include "pgs_contacts.h"
#include "tree_steps.h"
#include "unrecorded_step.h"

namespace novaphy {
namespace {

constexpr const char* kName = "SolverFeatherstone.step";

}  // namespace

namespace {

// What a state had before a step, for one that fails.
class EarlierState {
 public:
  void keep(const SimState& state) {
    size_t at = 0;
    visit(state, [&](const Array& array) {
      const size_t bytes = array.range()->bytes();
      if (at + bytes > bytes_.size()) bytes_.resize(at + bytes);
      std::memcpy(bytes_.data() + at, array.range()->data(), bytes);
      at += bytes;
    });
  }
  void restore(SimState& state) const {
    size_t at = 0;
    visit(state, [&](const Array& array) {
      const size_t bytes = array.range()->bytes();
      std::memcpy(array.range()->data(), bytes_.data() + at, bytes);
      at += bytes;
    });
  }

 private:
  template <class Function>
  static void visit(const SimState& s, const Function& function) {
    for (const Array* array :
         std::initializer_list<const Array*>{&s.joint_q, &s.joint_qd, &s.body_q, &s.body_qd})
      if (array->rows() > 0) function(*array);
  }
  std::vector<unsigned char> bytes_;
};

}  // namespace

struct SolverFeatherstone::Cache {
  Cache(const Model& m, ArticulationContact contact)
      : articulations(m, "SolverFeatherstone", Articulations::For::Steps),
        trees(m, articulations),
        actuated(m),
        pgs(m, articulations),
        materials(unread_materials(contact, kName)) {
    watch.leave_out_friction();  // its law is huber
    const auto dofs = static_cast<size_t>(m.joint_dof_count());
    const auto count = static_cast<size_t>(articulations.count());
    qdd.resize(dofs);
    branch.resize(dofs);
    status.resize(count);
    free_bodies.assign(static_cast<size_t>(m.body_count()), 0);
    for (size_t i = 0; i < count; ++i) {
      all.push_back(static_cast<int32_t>(i));
      const articulation::Tree<float> tree = articulations.tree(m, static_cast<int64_t>(i));
      if (tree.link_count == 1 && tree.dof_count == 6)
        free_bodies[static_cast<size_t>(tree.links[0].body)] = 1;
    }
  }
  Articulations articulations;
  std::vector<float> qdd, branch;
  std::vector<int32_t> status;
  std::vector<int32_t> all;  // articulations
  TreeSteps trees;
  ActuatedStep actuated;
  EarlierState earlier;
  PgsContacts pgs;
  RigidBodies penalty;
  // Of bodies on FREE joints: those that others hold have more than their own mass.
  std::vector<uint8_t> free_bodies;
  bool warned = false;  // of the residual
  void warn_of_residual(const Model& m, const ContactRows& rows) {
    const FarIsland far = pgs.far_island();
    if (warned || far.sweeps == 0) return;
    warned = true;
    warn_of(kName, ": contacts and dry friction of joints have not converged: ",
            describe(far, m, articulations, rows),
            ". Loads may sink in or creep: raise pgs_iterations, shorten dt, or bring masses that "
            "touch nearer to each other. pgs_residual has it of every step, this warning of one");
  }
  ContactWatch watch{kName, "lower dt, ke or kd, or take contact=\"pgs\""};
  UnreadMaterials materials;
  std::vector<Transformf> body_q;
  std::vector<SpatialVectorf> body_qd, body_f;
};

namespace {

void check_contacts(const Contacts* contacts, ArticulationContact contact) {
  require(contacts == nullptr || contact != ArticulationContact::None, ErrorKind::Value, kName,
          ": contacts: expected none of a solver without a way of contact");
  require(contacts == nullptr || contact == ArticulationContact::Penalty ||
              !contacts->per_contact_shape_properties(),
          ErrorKind::NotImplemented, kName,
          ": contacts: expected none with per_contact_shape_properties, which contact=\"pgs\" does "
          "not read");
}

// Where the forces of contacts go, zero; null: nowhere.
Vec3f* cleared_forces(const Contacts* contacts, int32_t count) {
  if (contacts == nullptr) return nullptr;
  DeviceArray<Vec3f> forces = contacts->rigid_contact_force;
  Vec3f* const force = forces.mutable_data();
  std::fill_n(force, count, Vec3f{});
  return force;
}

}  // namespace

SolverFeatherstone::SolverFeatherstone(std::shared_ptr<const Model> model,
                                       const FeatherstoneOptions& options)
    : SolverBase(std::move(model)), options_(options) {
  check_featherstone_model(*this->model(), options, "SolverFeatherstone");
  make_cache();
}
SolverFeatherstone::~SolverFeatherstone() = default;

void SolverFeatherstone::make_cache() {
  if (device().is_cpu())
    cache_ = std::make_unique<Cache>(*model(), options_.contact);
  else
    launched_ = std::make_unique<LaunchedArticulations>(*model());
}

void SolverFeatherstone::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverFeatherstone.notify_model_changed");
  if (launched_) launched_->forget_impulses();  // captures keep what they were made with
  make_cache();
}

int32_t SolverFeatherstone::pgs_sweeps() const {
  return cache_ ? cache_->pgs.sweeps() : launched_->sweeps();
}
float SolverFeatherstone::pgs_residual() const {
  return cache_ ? cache_->pgs.residual() : launched_->residual();
}

void SolverFeatherstone::check_last_step() const {
  const ExclusiveUse::Scope scope = use("SolverFeatherstone.check_last_step");
  if (launched_) launched_->check();
}

// The wrenches of contacts of the bodies where joint_q and joint_qd have them, beside body_f.
void SolverFeatherstone::add_penalties(const Contacts& contacts, ArticulationStepArguments& a) {
  const Model& m = *model();
  Cache& c = *cache_;
  const auto bodies = static_cast<size_t>(m.body_count());
  c.body_q.resize(bodies);
  c.body_qd.resize(bodies);
  const SpatialVectorf* const body_f = a.in.arrays.body_f;
  c.body_f.assign(body_f, body_f + bodies);
  c.pgs.move_links(a.in, c.body_q.data(), c.body_qd.data());
  c.penalty.prepare(m, &contacts);
  const RigidStep how = {FrictionLaw::Huber, options_.friction_smoothing, 0.0f, a.in.dt.value};
  c.penalty.add_contact_wrenches(m, c.body_q.data(), c.body_qd.data(), contacts, how,
                                 c.body_f.data());
  a.in.arrays.body_f = direct(c.body_f);
}

void SolverFeatherstone::step(SimState& state_in, SimState& state_out, const Control* control,
                              const Contacts* contacts, float dt) {
  if (&state_in == &state_out) {
    step(state_in, next_state(kName), control, contacts, dt);
    return take_next(state_in);
  }
  ArrayObserver* const observer = array_observer();
  if (observer != nullptr && !launched_) observer->host_read(kName);
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  check_step(kName, state_in, state_out, control, contacts, dt);
  check_contacts(contacts, options_.contact);
  m.check_numbers(kName);
  m.check_structure(kName);
  if (launched_) {
    const bool penalty = options_.contact == ArticulationContact::Penalty;
    require(contacts == nullptr || !penalty || contacts->rigid_contact_max() == 0,
            ErrorKind::NotImplemented, kName,
            ": contacts: expected none of contact \"penalty\" on ", device().str(),
            " (there it is on the cpu only)");
    launched_->step(state_in, state_out, control, penalty ? nullptr : contacts, options_, dt,
                    in_use());
    return mark_unrecorded_step(m, state_in, state_out, control);
  }
  m.update_derived();
  Cache& c = *cache_;
  c.articulations.check_values(m, control, true, kName);
  if (contacts != nullptr) c.materials.check(m);
  const ActuatedStep::Read read = c.actuated.begin(m, state_in, state_out, control, dt, kName);
  ArticulationStepArguments a = in_memory(ArticulationStepArguments{
      .in = articulation_arguments(m, c.articulations, state_in, read.drives, read.body_f, options_,
                                   dt),
      .q_next = state_out.joint_q,
      .qd_next = state_out.joint_qd,
      .body_q = state_out.body_q,
      .body_qd = state_out.body_qd,
      .qdd = direct(c.qdd),
      .branch = direct(c.branch),
      .status = direct(c.status),
      .workspace = Untyped(nullptr),
      .stride = 0});
  const bool penalty = options_.contact == ArticulationContact::Penalty;
  if (penalty && contacts != nullptr) {
    add_penalties(*contacts, a);
    if (c.watch.is_due(false)) c.watch.look(m, state_in, *contacts, dt, true, &c.free_bodies);
  }
  const ContactRows rows = contact_rows(penalty ? nullptr : contacts);
  Vec3f* const force = penalty ? nullptr : cleared_forces(contacts, rows.count);
  // One articulation that fails writes nothing; the others have written theirs by then.
  const bool several = c.all.size() > 1;
  if (several) c.earlier.keep(state_out);
  if (c.pgs.prepare(m, rows, &a.in)) {
    c.pgs.step(a, m, rows, options_, force, &c.trees);
    c.warn_of_residual(m, rows);
  } else {
    c.trees.step(a, m, c.all, options_, nullptr);
  }
  const bool failed =
      std::any_of(c.status.begin(), c.status.end(), [](int32_t s) { return s != 0; });
  if (failed && several) c.earlier.restore(state_out);
  if (failed)
    check_exploded(m, c.articulations, c.status, state_in, dt, c.pgs.largest_force(m), kName);
  c.actuated.finish(state_out);
  mark_unrecorded_step(m, state_in, state_out, control);
}

}  // namespace novaphy
