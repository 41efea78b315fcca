#include "novaphy/core/sim/solver_base.h"

#include <array>
#include <bit>
#include <cmath>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/sim/input_checks.h"
#include "novaphy/core/sim/named_step.h"
#include "novaphy/core/warning.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {

// A list of the arrays of a state that have rows.
struct StateArrays {
  struct Item {
    std::string_view name;
    const Array* array;
  };
  std::array<Item, StateFields::kFieldCount> items;
  size_t count = 0;

  void add(const FieldInfo& info, const Array& array) {
    if (array.bytes() != 0) items[count++] = {info.name, &array};
  }
  std::span<const Item> all() const { return std::span(items).first(count); }
};

void check_rows(const char* name, const char* which, const SimState& state, const Model& model) {
  StateFields::visit_rows(
      state, model.counts(), [&](const FieldInfo& info, const Array& array, size_t rows) {
        if (array.rows() != rows || (rows != 0 && array.device() != model.device())) [[unlikely]]
          fail(ErrorKind::Value, name, ": ", which, ".", info.name, ": expected ", rows,
               " rows on ", model.device().str(), ", got ", array.rows(), " rows on ",
               array.device().str());
      });
}

void check_apart(const char* name, const SimState& state_in, const SimState& state_out) {
  StateArrays in, out;
  StateFields::visit(state_in, [&](const FieldInfo& info, const Array& array) {
    in.add(info, array);
    if (info.role == FieldRole::Applied) array.require_writable(name);
  });
  StateFields::visit(state_out, [&](const FieldInfo& info, const Array& array) {
    if (info.role == FieldRole::Carried) out.add(info, array);
  });
  const auto check = [&](const StateArrays::Item& target, const Array& other, const char* whose) {
    if (target.array->range()->overlaps(*other.range())) [[unlikely]]
      fail(ErrorKind::Value, name, ": state_out.", target.name,
           ": expected memory of its own, got memory of ", whose);
  };
  for (size_t k = 0; k < out.count; ++k) {
    for (const StateArrays::Item& source : in.all()) check(out.items[k], *source.array, "state_in");
    for (size_t other = 0; other < k; ++other)
      check(out.items[k], *out.items[other].array, "another array of it");
  }
}

// Runs the solver's step over the states of a trajectory. A step adds to the forces of its state,
// so the step works on copies of the forces.
class ForwardSteps {
 public:
  using StepToTargets = std::function<void(SimState&, SimState&, const Control*, const Contacts*,
                                           float, const DeviceArray<Vec3f>&)>;

  ForwardSteps(SolverBase& solver, const Trajectory& trajectory, const RolloutInputs& inputs,
               StepToTargets step_to_targets)
      : solver_(solver),
        step_to_targets_(std::move(step_to_targets)),
        inputs_(inputs),
        shared_(trajectory.fields()),
        now_(*solver.model()),
        own_(static_cast<const StateFields&>(now_)),
        fields_(detail::mutable_fields<StateFields>(now_)),
        shared_fields_(detail::const_fields(shared_)),
        own_fields_(detail::mutable_fields(own_)) {
    if (inputs.targets().any())
      targets_ = DeviceArray<Vec3f>(inputs.targets().count, solver.device());
    if (inputs.pipeline() != nullptr) found_.emplace(inputs.pipeline()->contacts());
  }
  ForwardSteps(const ForwardSteps&) = delete;  // fields_ points to members
  ForwardSteps& operator=(const ForwardSteps&) = delete;

  void run(int32_t t, const SimState& from, SimState& to) {
    static_cast<StateFields&>(now_) = from;  // copies the handles
    for (size_t k = 0; k < fields_.size(); ++k) {
      if (fields_[k].info.role != FieldRole::Applied) continue;
      own_fields_[k].array->assign(*shared_fields_[k].array);
      *fields_[k].array = *own_fields_[k].array;
    }
    add_forces<Vec3f>(inputs_.forces(), t, now_.particle_f);
    add_forces<SpatialVectorf>(inputs_.body_forces(), t, now_.body_f);
    const Contacts* contacts = inputs_.contacts();
    if (found_) {
      inputs_.pipeline()->collide(from, *found_, {}, inputs_.dt());
      contacts = &*found_;
    }
    const RolloutInputs::Forces& targets = inputs_.targets();
    if (!targets.any()) return solver_.step(now_, to, inputs_.control(t), contacts, inputs_.dt());
    const Range& all = *targets.rows.range();
    targets_.assign(Array(DType::vec3, targets.count, 1,
                          all.storage().range(all.offset() + targets.first(t) * sizeof(Vec3f),
                                              targets.count * sizeof(Vec3f))));
    step_to_targets_(now_, to, inputs_.control(t), contacts, inputs_.dt(), targets_);
  }

 private:
  template <class T>
  static void add_forces(const RolloutInputs::Forces& forces, int32_t t, DeviceArray<T>& to) {
    if (!forces.any()) return;
    const T* const more = static_cast<const T*>(forces.rows.raw()) + forces.first(t);
    T* const f = to.mutable_data();
    for_chunks(static_cast<int64_t>(to.rows()), 4096, [&](int64_t begin, int64_t end, int64_t) {
      for (int64_t k = begin; k < end; ++k) f[k] = f[k] + more[k];
    });
  }

  SolverBase& solver_;
  StepToTargets step_to_targets_;
  RolloutInputs inputs_;
  StateFields shared_;  // arrays of the trajectory
  SimState now_;
  StateFields own_;  // the arrays allocated with now_
  std::vector<detail::MutableField> fields_;
  std::vector<detail::ConstField> shared_fields_;
  std::vector<detail::MutableField> own_fields_;
  DeviceArray<Vec3f> targets_;     // kinematic targets of one step
  std::optional<Contacts> found_;  // contacts that the pipeline finds in each step
};

// Copies of the memory that a solver carries from step to step besides the state. A trajectory with
// checkpoints keeps a copy with each kept state. Trajectory::recompute steps from these copies and
// leaves the solver's memory unchanged.
class KeptCarried {
 public:
  KeptCarried(Array carried, int32_t interval) : now_(std::move(carried)), interval_(interval) {}

  void keep(int32_t t) {
    if (is_needed() && t % interval_ == 0) at_[t] = now_.clone();
  }
  template <class Step>
  void recompute(int32_t t, const Step& step) {
    if (!is_needed()) return step();
    struct Restored {
      Array now, before = now.clone();
      explicit Restored(const Array& carried) : now(carried) {}
      ~Restored() { now.assign(before); }
    } const restored(now_);
    now_.assign(t % interval_ == 0 ? at_.at(t) : again_);
    step();
    again_ = now_.clone();
  }

 private:
  bool is_needed() const { return interval_ > 1 && now_.rows() != 0; }

  Array now_, again_;
  int32_t interval_;
  std::map<int32_t, Array> at_;
};

}  // namespace

SolverBase::SolverBase(std::shared_ptr<const Model> model) : model_(std::move(model)) {
  require(model_ != nullptr, ErrorKind::Value, "solver: model: expected a model, got null");
}

SolverBase::~SolverBase() = default;

void SolverBase::notify_model_changed(ModelFlags) {}

void SolverBase::check_step(const char* name, const SimState& state_in, const SimState& state_out,
                            const Control* control, const Contacts* contacts, float dt) const {
  require(dt > 0.0f && dt <= kLongestStep, ErrorKind::Value, name,
          ": dt: expected a finite number > 0 and at most ", kLongestStep, " s, got ", dt);
  const auto check_model = [&](const char* which, uint64_t id) {
    require(id == model_->id(), ErrorKind::Value, name, ": ", which,
            ": expected one of the solver's model, got one of another model");
  };
  check_model("state_in", state_in.model_id());
  check_model("state_out", state_out.model_id());
  if (control != nullptr) check_model("control", control->model_id());
  if (contacts != nullptr) check_model("contacts", contacts->model_id());

  check_rows(name, "state_in", state_in, *model_);
  check_rows(name, "state_out", state_out, *model_);
  check_apart(name, state_in, state_out);
  if (contacts == nullptr) return;
  ContactFields::visit_rows(
      static_cast<const ContactFields&>(*contacts), contacts->counts(),
      [&](const FieldInfo& info, const Array& array, size_t rows) {
        if (array.rows() != rows || (rows != 0 && array.device() != device())) [[unlikely]]
          fail(ErrorKind::Value, name, ": contacts.", info.name, ": expected ", rows, " rows on ",
               device().str(), ", got ", array.rows(), " rows on ", array.device().str());
      });
  check_normals(name, *contacts);
  watch_overflow(name, *contacts);
}

void SolverBase::watch_overflow(const char* name, const Contacts& contacts) const {
  if (warned_of_overflow_) return;
  if (!device().is_cpu() &&
      (launch_recorder() != nullptr || !std::has_single_bit(++overflow_checks_)))
    return;
  const UntrackedScope untracked;
  const auto found = [&](const DeviceArray<int32_t>& count) {
    return device().is_cpu() ? *count.data() : count.to_host()[0];
  };
  const auto warn_if_over = [&](int32_t wanted, int32_t slots, const char* kind,
                                const char* left_out) {
    if (wanted <= slots) return;
    warned_of_overflow_ = true;
    warn_of(name, ": contacts: ", wanted, " ", kind, " contacts were found for ", slots, " slots (",
            kind, "_contact_max), ", left_out, "; make the pipeline with a larger ", kind,
            "_contact_max, or search within less");
  };
  warn_if_over(found(contacts.rigid_contact_count), contacts.rigid_contact_max(), "rigid",
               "and those farthest apart act on nothing");
  warn_if_over(found(contacts.soft_contact_count), contacts.soft_contact_max(), "soft",
               "and the last act on nothing");
}

SimState& SolverBase::next_state(const char* name) {
  const LaunchRecorder* const recorder = launch_recorder();
  require(recorder == nullptr || !recorder->has_tape(), ErrorKind::Runtime, name,
          " on an active Tape: state_out: expected another state than state_in, whose values the "
          "gradient needs; take two states, rollout of a Trajectory, or nova.no_grad()");
  if (next_ == nullptr) {
    const UntrackedScope fresh;  // a capture does not know this memory yet
    next_ = std::make_unique<SimState>(*model_);
  }
  size_t k = 0;
  StateFields::visit(
      *next_, [&](const FieldInfo&, const Array& array) { next_versions_[k++] = array.version(); });
  return *next_;
}

void SolverBase::take_next(SimState& state) {
  std::array<const Array*, StateFields::kFieldCount> written{};
  size_t k = 0;
  StateFields::visit(*next_, [&](const FieldInfo& info, const Array& array) {
    const bool is_written = array.rows() != 0 && array.version() != next_versions_[k];
    written[k++] = info.role == FieldRole::Carried && is_written ? &array : nullptr;
  });
  k = 0;
  StateFields::visit(state, [&](const FieldInfo&, Array& array) {
    if (const Array* const source = written[k++]) array.assign(*source);
  });
}

void SolverBase::step_to_targets(SimState&, SimState&, const Control*, const Contacts*, float,
                                 const DeviceArray<Vec3f>&) {
  fail(ErrorKind::NotImplemented,
       "rollout, targets: expected none, this solver moves no kinematic particles");
}

void SolverBase::rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts,
                         float dt, const RolloutOptions& options) {
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation("rollout");
  const RolloutInputs inputs(*model_, trajectory, control, contacts, dt, options, target_count());
  require((!inputs.forces().any() && !inputs.body_forces().any()) || device().is_cpu(),
          ErrorKind::NotImplemented, "rollout, forces: this solver covers them on the cpu");
  const auto steps = std::make_shared<ForwardSteps>(
      *this, trajectory, inputs,
      [this](SimState& in, SimState& out, const Control* of_step, const Contacts* found, float h,
             const DeviceArray<Vec3f>& targets) {
        step_to_targets(in, out, of_step, found, h, targets);
      });
  const auto kept = std::make_shared<KeptCarried>(carried(), trajectory.checkpoint_interval());
  constexpr int32_t kStepsPerInterruptCheck = 32;
  for (int32_t t = inputs.start(); t < inputs.stop(); ++t) {
    if (t % kStepsPerInterruptCheck == 0) check_interrupt();
    kept->keep(t);
    named_step(t, [&] { steps->run(t, trajectory.any_state(t), trajectory.any_state(t + 1)); });
  }
  trajectory.set_last_rollout(inputs.start(), inputs.stop(),
                              [steps, kept](int32_t t, const SimState& from, SimState& to) {
                                kept->recompute(t, [&] { steps->run(t, from, to); });
                              });
}

}  // namespace novaphy
