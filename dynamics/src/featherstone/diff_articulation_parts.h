// Declarations that the files of ArticulationStep share: the arrays of a step on the tape, its
// forward step, its adjoint and its tangent.
#pragma once

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "../step_sources.h"
#include "articulation_step.h"
#include "contact_steps.h"
#include "mimic_limits.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/featherstone/diff_articulation_step.h"
#include "novaphy/nova/launch_argument.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::detail {
const char* articulation_kernels_source();
}

namespace novaphy::diff {
namespace detail {

using nova::argument;
using nova::Tensor;
inline constexpr const char* kName = "articulation_step";
struct MotionNotes;
// Indices of the inputs after the arrays with a gradient (kAt). The inputs of shapes exist only
// with contacts.
enum MoreInputs : size_t {
  kJointFriction = kGradientArrays,
  kShapeInputs,
  kMu = kShapeInputs,
  kRestitution,
  kStiffness,
  kDamping,
  kInputs
};
// Indices of the arrays that a step reads without a gradient, in the order of
// ArticulationArguments.
enum Values : size_t { kFrameP, kFrameC, kAxis, kTargetMode, kRows, kLinks, kDofParent, kValues };

struct Named {
  const char* name;
  Tensor tensor;
};

// The contacts that a step stores for its adjoint. The memory has one array after the other,
// kContactNumbers floats per contact, with the impulses at the end. Indices are stored as the bits
// of floats. The count of contacts follows. The impulses of dry friction come last, one per dof. On
// the CPU a FarIsland precedes them.
inline constexpr int64_t kContactNumbers = 16, kFarNumbers = sizeof(FarIsland) / sizeof(float);
struct KeptContacts {
  static int64_t size(int64_t most, int64_t dofs) {
    return kContactNumbers * most + 1 + kFarNumbers + dofs;
  }
  KeptContacts(float* memory, int64_t most)
      : shape0(reinterpret_cast<int32_t*>(memory)),
        shape1(shape0 + most),
        point0(reinterpret_cast<Vec3f*>(memory + 2 * most)),
        point1(point0 + most),
        normal(point1 + most),
        impulses(normal + most),
        margin0(memory + 14 * most),
        margin1(margin0 + most),
        count(reinterpret_cast<int32_t*>(memory + kContactNumbers * most)),
        far(reinterpret_cast<FarIsland*>(count + 1)),
        friction(memory + kContactNumbers * most + 1 + kFarNumbers) {}
  articulation::ContactRows rows(bool found) const {
    return {*count, shape0, shape1, nullptr, point0, point1, normal, margin0, margin1, found};
  }
  int32_t *shape0, *shape1;
  Vec3f *point0, *point1, *normal, *impulses;
  float *margin0, *margin1;
  int32_t* count;
  FarIsland* far;
  float* friction;
};

// The arrays of contacts that a rollout finds again each time its steps run.
struct FoundRows {
  explicit FoundRows(const Contacts& c)
      : most(c.rigid_contact_max()),
        count(c.rigid_contact_count),
        shape0(c.rigid_contact_shape0),
        shape1(c.rigid_contact_shape1),
        point0(c.rigid_contact_point0),
        point1(c.rigid_contact_point1),
        normal(c.rigid_contact_normal),
        margin0(c.rigid_contact_margin0),
        margin1(c.rigid_contact_margin1) {}
  ContactArguments arguments() const {
    return {.at = {shape0, shape1, point0, point1, normal, margin0, margin1},
            .count = count,
            .most = most};
  }
  int32_t most;
  DeviceArray<int32_t> count, shape0, shape1;
  DeviceArray<Vec3f> point0, point1, normal;
  DeviceArray<float> margin0, margin1;
};

// The drives and wrenches of a step with actuators and gravity compensation, in the memory
// `scratch`. An active tape records their computation.
struct ActuatedInputs {
  StepDrives drives;
  nova::Operand body_f;
};
ActuatedInputs submit_actuation(const std::shared_ptr<const Actuators>& actuators, const Model& m,
                                const SimState& in, const SimState& out, const Control* control,
                                const nova::Operand& body_f, float dt, StepScratch scratch);

// The results of a step: q, qd, body_q, body_qd, and qdd and branch for its adjoint.
using StepOutputs = std::array<Tensor, 6>;
inline constexpr size_t kMostSteps = 8;  // steps per operation: a tape allows 32 outputs

}  // namespace detail

struct ArticulationStep::Shared {
  Shared(const Model& m, const FeatherstoneOptions& o, const char* user)
      : options(o),
        device(m.device()),
        articulations(m, user, Articulations::For::Steps),
        contacts(m, articulations),
        materials(unsupported_materials(o.contact, user)) {
    actuators = std::make_shared<Actuators>(m);
    const auto count = static_cast<size_t>(articulations.count());
    for (size_t i = 0; i < count; ++i) all.push_back(static_cast<int32_t>(i));
    if (device.is_cpu())
      trees.emplace(m, articulations);
    else
      contacts.read_polytopes();  // a capture cannot
    own_stride = step_workspace(articulations);
    status = DeviceArray<int32_t>(count, device);
  }
  // Allocates the memory of trees for a step and its adjoint. `solves`: with contacts or dry
  // friction.
  void reserve(bool solves) {
    const int64_t numbers = solves ? contacts.adjoint_tree_stride() : own_stride;
    if (numbers <= stride) return;
    stride = numbers;
    const UntrackedScope untracked;
    workspace = DeviceArray<float>(all.size() * static_cast<size_t>(stride), device);
  }
  // Returns whether the step runs at once without launches: on the CPU, and nothing records it.
  bool runs_on_host() const { return nova::host_can_read(device); }
  FeatherstoneOptions options;
  Device device;
  Articulations articulations;
  MimicLimits mimics;
  std::optional<TreeSteps> trees;  // on the CPU
  ContactSteps contacts;
  std::vector<int32_t> all;  // all articulations
  std::shared_ptr<Actuators> actuators;
  int64_t stride = 0, own_stride = 0;  // own_stride: for a step without contacts
  DeviceArray<int32_t> status;
  DeviceArray<float> workspace;
  ContactBranches branches;  // on the CPU
  UnsupportedMaterials materials;
  std::vector<float> between;   // gradients of states between the joined steps of one operation
  DeviceArray<float> wrenches;  // gradients by body_f, if that by gravity is requested
  DeviceArray<float> duals;     // dual numbers on devices
  std::string failure;          // the error of a replay
  bool dry = false;             // joints have dry friction, or its gradient is requested
  bool allow_unconverged = false;
  DerivativeOf contact_gradient = DerivativeOf::Auto;
  const char* without_motion = nullptr;  // MotionCounts::held of all steps
  bool is_auto() const { return contact_gradient == DerivativeOf::Auto; }
  // Returns whether times of events move, outside of captures.
  bool moves() const { return contact_gradient != DerivativeOf::Code && without_motion == nullptr; }
  // Returns the counts before the first step.
  MotionCounts no_motion() const {
    return {.held = without_motion, .drift = std::make_shared<AdjointDrift>()};
  }
  MotionCounts motion;
  struct Witness;
  std::weak_ptr<Witness> witness;
  std::weak_ptr<const Step> last;  // only with MotionNotes
  // The last step of each chain, by the memory of joint_q at its end. Loops that alternate have a
  // chain each.
  std::map<const void*, std::weak_ptr<const Step>> ends;
  int64_t moving_steps = 0;                   // recorded steps with MotionNotes
  int64_t chain = 0;                          // the newest chain
  const MotionEvents* last_listed = nullptr;  // events of the step under recording
  int64_t next_step = 0;                      // the number of the next recorded step
  // On devices: whether a step since the last check did not converge, and the number of such steps.
  std::shared_ptr<bool> far = std::make_shared<bool>(false);
  int64_t far_steps = 0;
  int64_t free_steps = 0;       // recorded steps without contacts and dry friction
  const void* ended = nullptr;  // joint_q of the last step with contacts
};

// The arrays of a step, as handles and as inputs and outputs of the tape. If an operation has
// several steps, `following` has the outputs of its other steps.
struct ArticulationStep::Step {
  std::shared_ptr<ArticulationStep::Shared> shared;
  std::shared_ptr<const Model> model;
  detail::Tensor contacts = {};                  // KeptContacts; undefined without contacts
  int64_t contact_max = 0;                       // the capacity of `contacts`
  std::optional<detail::FoundRows> found = {};   // copied each time the step runs
  bool follow = false;                           // contacts move with the state at the start of
                                                 // the step
  std::optional<DeviceArray<Vec3f>> force = {};  // the contact forces
  // Ids of the contact points, by which events are found between steps. Valid as long as the
  // contacts belong to the step.
  std::optional<DeviceArray<int32_t>> point_id = {};
  bool continues = false;       // starts at the end of the last step with contacts
  bool by_restitution = false;  // the gradient of the restitution is requested
  bool dry = false;             // Shared::dry
  std::array<detail::Named, detail::kInputs> inputs;  // at kAt and MoreInputs
  std::array<detail::Named, detail::kValues> values;
  std::array<detail::Named, 6> outputs;  // q, qd, body_q, body_qd, qdd, branch
  FeatherstoneOptions options;
  float dt = 0.0f;
  int64_t count = 0, stride = 0;
  DeviceArray<int32_t> status;
  DeviceArray<float> workspace;
  std::optional<ArticulationArguments> host = {};   // of the first step, if others follow it
  std::vector<detail::StepOutputs> following = {};  // each step starts at the end of the one before
  int64_t number = 0;
  std::shared_ptr<bool> far = {};                    // Shared::far
  std::shared_ptr<detail::MotionNotes> motion = {};  // null: the derivative is that of the code

  // Returns whether the forward step fills `contacts` each time, so that later writes to the source
  // arrays do no harm.
  bool copies_contacts() const { return found.has_value() || contact_max == 0; }
  const detail::Tensor& in(size_t member) const { return inputs[member].tensor; }
};

namespace detail {

using Step = ArticulationStep::Step;

inline const ArticulationRows* rows_of_step(const Step& s) {
  return static_cast<const ArticulationRows*>(s.values[kRows].tensor.range()->data());
}
// Returns the tensor of an array, even if this handle is read-only.
Tensor tensor_of(const Array& array);
inline float* numbers(const Tensor& tensor) {
  return tensor.defined() ? static_cast<float*>(tensor.range()->data()) : nullptr;
}
// Returns whether a capture records the step as work of the host.
bool works_on_host(const Step& s);
// Return arguments of launches: the contacts that the step stores, and its impulses.
ContactArguments kept_arguments(const Step& s);
ContactRecord contact_record(const Step& s);
inline KeptContacts kept_contacts(const Step& s) { return {numbers(s.contacts), s.contact_max}; }
inline articulation::ContactRows contact_rows_of(const Step& s) {
  return kept_contacts(s).rows(s.follow);
}
// Throws ErrorKind::Runtime if the step did not converge and the options do not allow this. `what`:
// backward or jvp, for the message.
void require_converged(const Step& s, const char* what);
// Inside a capture on the host: makes replays of an unconverged step fail and set `results` to NaN.
void watch_convergence(const std::shared_ptr<const Step>& step, std::span<const Tensor> results,
                       const char* what);
// Returns whether a step has contacts or dry friction, as far as the host knows without waiting, or
// whether the gradient by friction is requested.
bool acts(const Step& s, const Tensor& joint_friction);
StepOutputs outputs_of(const Step& s);
// Returns the arrays that a replay of the step or of its adjoint reads, and that others may write.
std::vector<Tensor> reads_of(const Step& s);

// Returns the arguments of the first step of an operation. take(values, place): the argument of an
// array.
template <class T, class Take>
ArticulationArgumentsOf<T> step_arguments_of(const Step& s, const Take& take) {
  const auto table = [&](Values i) { return argument(s.values[i].tensor); };
  return arguments_of<T>(
      [&](int32_t place) {
        const auto i = static_cast<size_t>(place);
        const Named& of = i < kGradientArrays ? s.inputs[i] : s.values[i - kGradientArrays];
        return take(of.tensor, place);
      },
      {table(kTargetMode), table(kRows), table(kLinks), table(kDofParent)}, s.options, s.dt);
}
ArticulationArguments step_arguments_of(const Step& s);
inline ArticulationArguments host_arguments(const Step& s) {
  return in_memory(step_arguments_of(s));
}
// Runs a step from the state `from` (null: the state of the first step) into `to`.
void run_host(const Step& s, const ArticulationArguments& in, const StepOutputs* from,
              const StepOutputs& to);
// Runs the step now, or in the replays of a capture. `reports`: also counts its branches and writes
// the contact forces.
void submit_forward(const std::shared_ptr<const Step>& step, bool reports);
// Runs all steps of the operation again.
void run_all(const std::shared_ptr<const Step>& step);
// Runs the adjoint of a step now, or in the replays of a capture.
void submit_vjp(const std::shared_ptr<const Step>& step, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients);
// Runs the adjoints of several steps, from the last to the first. The gradients of the states
// between the steps are in Shared::between.
void run_vjp_of_steps(const Step& s, std::span<const Tensor> outputs,
                      std::span<const nova::InputGradient> gradients);
// Computes the tangents of all steps of the operation now, or in the replays of a capture.
void submit_jvp(const std::shared_ptr<const Step>& step, std::span<const Tensor> inputs,
                std::span<const Tensor> outputs);

}  // namespace detail
}  // namespace novaphy::diff
