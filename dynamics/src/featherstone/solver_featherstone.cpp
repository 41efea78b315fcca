#include "novaphy/dynamics/featherstone/solver_featherstone.h"

#include <algorithm>
#include <cstring>
#include <initializer_list>
#include <optional>
#include <span>
#include <utility>

#include "../semi_implicit/rigid_bodies.h"
#include "articulation_kernels.h"
#include "articulation_sleep.h"
#include "articulation_step.h"
#include "contact_steps.h"
#include "mimic_limits.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/storage.h"
#include "novaphy/core/warning.h"
#include "novaphy/dynamics/semi_implicit/contact_stability.h"
#include "tree_steps.h"
#include "unrecorded_step.h"

namespace novaphy {
namespace {

constexpr const char* kName = "SolverFeatherstone.step";

// Copies of a state's rows before a step, to restore them if an articulation fails.
class EarlierState {
 public:
  void keep(const SimState& state) {
    size_t at = 0;
    visit(state, [&](const Array& array) {
      const size_t bytes = array.range()->bytes();
      if (at + bytes > bytes_.size()) bytes_.resize(at + bytes);
      const auto* const from = static_cast<const unsigned char*>(array.range()->data());
      for_chunks(static_cast<int64_t>(bytes), kCopiedAtOnce,
                 [to = bytes_.data() + at, from](int64_t begin, int64_t end, int64_t) {
                   std::memcpy(to + begin, from + begin, static_cast<size_t>(end - begin));
                 });
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
  static constexpr int64_t kCopiedAtOnce = 1 << 16;  // bytes
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
  Cache(const Model& m, ArticulationContact contact, const std::optional<SleepConfig>& of_sleep)
      : articulations(m, "SolverFeatherstone", Articulations::For::Steps),
        actuated(m),
        contacts(m, articulations),
        materials(unsupported_materials(contact, kName)) {
    watch.leave_out_friction();  // its friction law is huber, whose slope at zero slip is below kf
    const Device device = m.device();
    const auto dofs = static_cast<size_t>(m.joint_dof_count());
    const auto count = static_cast<size_t>(articulations.count());
    qdd = DeviceArray<float>(dofs, device);
    branch = DeviceArray<float>(dofs, device);
    status = DeviceArray<int32_t>(count, device);
    for (size_t i = 0; i < count; ++i) all.push_back(static_cast<int32_t>(i));
    if (!device.is_cpu()) {
      stride = device_workspace(articulations);
      workspace = DeviceArray<float>(count * static_cast<size_t>(stride), device);
      return;
    }
    trees.emplace(m, articulations);
    if (of_sleep) sleep.emplace(m, articulations, *of_sleep);
    free_bodies.assign(static_cast<size_t>(m.body_count()), 0);
    for (size_t i = 0; i < count; ++i) {
      const articulation::Tree<float> tree = articulations.tree(m, static_cast<int64_t>(i));
      if (tree.link_count == 1 && tree.dof_count == 6)
        free_bodies[static_cast<size_t>(tree.links[0].body)] = 1;
    }
  }
  void check_values(const Model& m, const Control* control, const FeatherstoneOptions& options) {
    articulations.check_values(m, control, true, kName);
    mimics.check(m, options, kName);
  }
  Articulations articulations;
  MimicLimits mimics;
  DeviceArray<float> qdd, branch, workspace;
  DeviceArray<int32_t> status;
  int64_t stride = 0;              // floats of the workspace per articulation
  std::vector<int32_t> all;        // all articulations
  std::optional<TreeSteps> trees;  // only on the CPU, where a step runs at once
  std::optional<ArticulationSleep> sleep;
  ActuatedStep actuated;
  EarlierState earlier;
  bool keeps_earlier = false;  // whether the current step uses `earlier`
  ContactSteps contacts;
  RigidBodies penalty;
  // Bodies that form an articulation alone, on a FREE joint. `watch` checks only these bodies: in a
  // longer tree the effective mass at a contact exceeds the body's mass.
  std::vector<uint8_t> free_bodies;
  const SleepingTrees* begin_sleep(const Model& m, const SimState& in, const Contacts* of,
                                   const Control* control, const ArticulationStepArguments& step) {
    if (!sleep) return nullptr;
    return sleep->begin(m, in, of, control, in_memory(step).in, step.in.dt);
  }
  bool warned = false;  // whether the warning about the residual was given
  void warn_of_residual(const Model& m, const Contacts* of, float tolerance) {
    if (warned) return;
    const FarIsland far = contacts.far_island(tolerance);
    if (far.sweeps == 0) return;
    warned = true;
    const articulation::ContactRows rows = contact_rows(of);
    warn_of(kName, ": contacts and dry friction of joints have not converged: ",
            describe(far, m, articulations, rows.shape0, rows.shape1),
            ". Loads may sink in or creep: raise pgs_iterations, shorten dt, or bring masses that "
            "touch nearer to each other. pgs_residual has it of every step, this warning of one");
  }
  ContactWatch watch{kName, "lower dt, ke or kd, or take contact=\"pgs\""};
  UnsupportedMaterials materials;
  std::vector<Transformf> body_q;
  std::vector<SpatialVectorf> body_qd, body_f;
};

namespace {

void check_contacts(const Contacts* contacts, const FeatherstoneOptions& options) {
  check_not_on_tape(options.sleep, kName);
  const ArticulationContact contact = options.contact;
  require(contacts == nullptr || contact != ArticulationContact::None, ErrorKind::Value, kName,
          ": contacts: expected none of a solver without a way of contact");
  require(contacts == nullptr || contact == ArticulationContact::Penalty ||
              !contacts->per_contact_shape_properties(),
          ErrorKind::NotImplemented, kName,
          ": contacts: expected none with per_contact_shape_properties, which contact=\"pgs\" does "
          "not read");
}

}  // namespace

SolverFeatherstone::SolverFeatherstone(std::shared_ptr<const Model> model,
                                       const FeatherstoneOptions& options)
    : SolverBase(std::move(model)), options_(options) {
  check_featherstone_model(*this->model(), options, "SolverFeatherstone");
  if (options.sleep) {
    check_sleep("SolverFeatherstone", *options.sleep);
    require_cpu(this->model()->device(), "SolverFeatherstone: sleep");
    require(options.contact != ArticulationContact::Penalty, ErrorKind::NotImplemented,
            "SolverFeatherstone: sleep: expected None with contact \"penalty\", got a SleepConfig; "
            "use \"pgs\"");
  }
  make_cache();
}
SolverFeatherstone::~SolverFeatherstone() = default;

void SolverFeatherstone::make_cache() {
  cache_ = std::make_unique<Cache>(*model(), options_.contact, options_.sleep);
}

void SolverFeatherstone::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverFeatherstone.notify_model_changed");
  cache_->contacts.forget_impulses();  // captures still use the old cache
  make_cache();
}

int32_t SolverFeatherstone::pgs_sweeps() const { return cache_->contacts.sweeps(); }
float SolverFeatherstone::pgs_residual() const { return cache_->contacts.residual(); }

void SolverFeatherstone::check_last_step() const {
  const ExclusiveUse::Scope scope = use("SolverFeatherstone.check_last_step");
  const Cache& c = *cache_;
  if (c.trees) return;  // on the CPU, step has already reported its errors
  const std::vector<int32_t> status = c.status.to_host();
  check_contact_status(status, kName);
  check_status(*model(), c.articulations, status, kName);
}

// Adds the wrenches of penalty contacts to body_f, with the bodies at the poses and velocities of
// joint_q and joint_qd.
void SolverFeatherstone::add_penalties(const Contacts& contacts, ArticulationStepArguments& a) {
  const Model& m = *model();
  Cache& c = *cache_;
  const auto bodies = static_cast<size_t>(m.body_count());
  c.body_q.resize(bodies);
  c.body_qd.resize(bodies);
  const ArticulationArguments in = in_memory(a).in;
  const SpatialVectorf* const body_f = in.arrays.body_f;
  c.body_f.assign(body_f, body_f + bodies);
  place_bodies(c.articulations, in, c.body_q.data(), c.body_qd.data());
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
  Cache& c = *cache_;
  ArrayObserver* const observer = array_observer();
  if (observer != nullptr && c.trees) observer->host_read(kName);
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  check_step(kName, state_in, state_out, control, contacts, dt);
  check_contacts(contacts, options_);
  m.check_numbers(kName);
  m.check_structure(kName);
  const bool penalty = options_.contact == ArticulationContact::Penalty;
  require(c.trees || !penalty || contacts == nullptr || contacts->rigid_contact_max() == 0,
          ErrorKind::NotImplemented, kName, ": contacts: expected none of contact \"penalty\" on ",
          device().str(), " (there it is on the cpu only)");
  if (c.trees) m.update_derived();
  c.check_values(m, control, options_);
  if (contacts != nullptr) c.materials.check(m);
  if (LaunchRecorder* recorder = launch_recorder()) recorder->uses(in_use());
  depend_on_values(m, control);
  if (contacts != nullptr)
    depend_on({&m.shape_material_ka, &m.shape_material_mu_torsional, &m.shape_material_mu_rolling});
  const ActuatedStep::Read read = c.actuated.begin(m, state_in, state_out, control, dt, kName);
  ArticulationStepArguments a = {
      .in = articulation_arguments(m, c.articulations, state_in, read.drives, read.body_f, options_,
                                   dt),
      .q_next = state_out.joint_q,
      .qd_next = state_out.joint_qd,
      .body_q = state_out.body_q,
      .body_qd = state_out.body_qd,
      .qdd = c.qdd,
      .branch = c.branch,
      .status = c.status,
      .workspace = c.workspace,
      .stride = c.stride};
  if (penalty && contacts != nullptr && c.trees) {
    add_penalties(*contacts, a);
    if (c.watch.is_due(false)) c.watch.look(m, state_in, *contacts, dt, true, &c.free_bodies);
  }
  const Contacts* const touching = penalty ? nullptr : contacts;
  const auto* const sleeping = c.begin_sleep(m, state_in, touching, control, a);
  const bool has_rows = c.contacts.has_rows(touching);
  // With a single tree no copy is needed: a tree that fails writes nothing.
  c.keeps_earlier = c.trees && (has_rows || c.all.size() > 1);
  if (c.keeps_earlier) c.earlier.keep(state_out);
  if (has_rows)
    c.contacts.step(a, touching == nullptr ? c.contacts.none() : contact_arguments(*touching),
                    options_, {}, c.trees ? &*c.trees : nullptr, sleeping);
  else if (c.trees)
    c.trees->step(in_memory(a), m, sleeping != nullptr ? sleeping->awake : c.all, options_,
                  nullptr);
  else
    run(tree_step_kernel(), c.articulations.count(), a);
  if (c.trees) finish(touching, control, state_in, state_out, dt);
  mark_unrecorded_step(m, state_in, state_out, control);
}

// Finishes a step that ran at once. A failed articulation gets the rows back that `to` had before.
void SolverFeatherstone::finish(const Contacts* contacts, const Control* control,
                                const SimState& from, SimState& to, float dt) {
  Cache& c = *cache_;
  if (c.sleep) c.sleep->keep(*model(), from, to, c.status);
  const std::span<const int32_t> status = {c.status.data(), c.status.rows()};
  if (std::all_of(status.begin(), status.end(), [](int32_t s) { return s == 0; })) {
    if (c.sleep) c.sleep->end(*model(), from, to, dt);
    c.warn_of_residual(*model(), contacts, options_.pgs_tolerance);
    return c.actuated.finish(to);
  }
  if (c.keeps_earlier) c.earlier.restore(to);
  const articulation::ContactRows rows = contact_rows(contacts);
  check_contact_status(status, kName, model().get(), rows.shape0, rows.shape1);
  check_actuator_inputs(*model(), from, control, kName);
  check_exploded(*model(), c.articulations, status, from, dt, c.contacts.largest_force(), kName);
}

}  // namespace novaphy
