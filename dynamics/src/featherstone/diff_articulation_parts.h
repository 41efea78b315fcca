// The parts that the files of ArticulationStep share: the arrays of a step for the tape, its
// forward, adjoint and tangent.
#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "../step_sources.h"
#include "articulation_step.h"
#include "contact_steps.h"
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
// Inputs behind the arrays with a gradient (kAt). Those of shapes only with contacts.
enum MoreInputs : size_t {
  kJointFriction = kGradientArrays,
  kShapeInputs,
  kMu = kShapeInputs,
  kRestitution,
  kStiffness,
  kDamping,
  kInputs
};
// What a step reads without a gradient, in the order of ArticulationArguments.
enum Values : size_t { kFrameP, kFrameC, kAxis, kTargetMode, kRows, kLinks, kDofParent, kValues };

struct Named {
  const char* name;
  Tensor tensor;
};

// The contacts of a step as it keeps them: numbers per contact, array after array, with the
// impulses behind; indices as the bits of floats. Then how many there are, and the impulses of
// joints' dry friction, a row per dof; on the cpu also the island that is far from converged,
// before the friction.
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

// The arrays of contacts that a rollout finds anew whenever its steps run.
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

// The drives and wrenches of a step, in its memory `scratch`: what its actuators and gravity
// compensation make of them. Recorded on an active tape.
struct ActuatedInputs {
  StepDrives drives;
  nova::Operand body_f;
};
ActuatedInputs submit_actuation(const std::shared_ptr<const Actuators>& actuators, const Model& m,
                                const SimState& in, const SimState& out, const Control* control,
                                const nova::Operand& body_f, float dt, StepScratch scratch);

// What a step gives: q, qd, body_q, body_qd, and for its adjoint qdd and branch.
using StepOutputs = std::array<Tensor, 6>;
inline constexpr size_t kMostSteps = 8;  // of an operation: a tape takes 32 outputs

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
    if (device.is_cpu()) trees.emplace(m, articulations);
    own_stride = step_workspace(articulations);
    status = DeviceArray<int32_t>(count, device);
  }
  // Memory of trees for a step and its adjoint; `solves`: with contacts or dry friction.
  void reserve(bool solves) {
    const int64_t numbers = solves ? contacts.adjoint_tree_stride() : own_stride;
    if (numbers <= stride) return;
    stride = numbers;
    const UntrackedScope untracked;
    workspace = DeviceArray<float>(all.size() * static_cast<size_t>(stride), device);
  }
  // Where nothing records on the cpu, which steps without launches.
  bool runs_on_host() const { return nova::host_can_read(device); }
  FeatherstoneOptions options;
  Device device;
  Articulations articulations;
  std::optional<TreeSteps> trees;  // on the cpu
  ContactSteps contacts;
  std::vector<int32_t> all;  // articulations
  std::shared_ptr<Actuators> actuators;
  int64_t stride = 0, own_stride = 0;  // of a step without contacts
  DeviceArray<int32_t> status;
  DeviceArray<float> workspace;
  ContactBranches branches;  // of steps of the cpu
  UnsupportedMaterials materials;
  std::vector<float> between;   // gradients of states between the steps of an operation
  DeviceArray<float> wrenches;  // gradients of body_f, where gravity's is asked for
  DeviceArray<float> duals;     // of tangents on devices
  std::string failure;          // of a replay
  bool dry = false;             // joints have dry friction, or its gradient is asked for
  bool allow_unconverged = false;
  DerivativeOf contact_gradient = DerivativeOf::Code;
  MotionCounts motion;
  struct Witness;
  std::weak_ptr<Witness> witness;
  std::weak_ptr<const Step> last;           // with MotionNotes
  int64_t chain = 0;                        // of `last`
  const MotionEvents* last_told = nullptr;  // of the step that is recorded
  int64_t next_step = 0;                    // number of the next step that is recorded
  // On devices, whether a step since the last check is far from converged, and how many were.
  std::shared_ptr<bool> far = std::make_shared<bool>(false);
  int64_t far_steps = 0;
  int64_t free_steps = 0;       // recorded without contacts and dry friction
  const void* ended = nullptr;  // where the last step with contacts left joint_q
};

// The arrays of a step, and of those behind it that are one operation with it: handles, and what
// they are for the tape.
struct ArticulationStep::Step {
  std::shared_ptr<ArticulationStep::Shared> shared;
  std::shared_ptr<const Model> model;
  detail::Tensor contacts = {};                  // KeptContacts; undefined without
  int64_t contact_max = 0;                       // of them
  std::optional<detail::FoundRows> found = {};   // copied whenever the step runs
  bool follow = false;                           // they are of the state that it starts from
  std::optional<DeviceArray<Vec3f>> force = {};  // of the contacts
  // Of the contacts, as long as they are those of the step: for the events between steps.
  std::optional<DeviceArray<int32_t>> point_id = {};
  bool continues = false;       // it starts where the last one with contacts ended
  bool by_restitution = false;  // its gradient is asked for
  bool dry = false;             // Shared::dry
  std::array<detail::Named, detail::kInputs> inputs;  // at kAt and MoreInputs
  std::array<detail::Named, detail::kValues> values;
  std::array<detail::Named, 6> outputs;  // q, qd, body_q, body_qd, qdd, branch
  FeatherstoneOptions options;
  float dt = 0.0f;
  int64_t count = 0, stride = 0;
  DeviceArray<int32_t> status;
  DeviceArray<float> workspace;
  std::optional<ArticulationArguments> host = {};   // of the first step, where others follow
  std::vector<detail::StepOutputs> following = {};  // each starts where the one before ended
  int64_t number = 0;
  std::shared_ptr<bool> far = {};                    // Shared::far
  std::shared_ptr<detail::MotionNotes> motion = {};  // null: gradients are of the code

  // Whether its forward fills `contacts` anew, so that nobody minds who wrote there.
  bool copies_contacts() const { return found.has_value() || contact_max == 0; }
  const detail::Tensor& in(size_t member) const { return inputs[member].tensor; }
};

namespace detail {

using Step = ArticulationStep::Step;

inline const ArticulationRows* rows_of_step(const Step& s) {
  return static_cast<const ArticulationRows*>(s.values[kRows].tensor.range()->data());
}
// Also of an array that may not be written through this handle.
Tensor tensor_of(const Array& array);
inline float* numbers(const Tensor& tensor) {
  return tensor.defined() ? static_cast<float*>(tensor.range()->data()) : nullptr;
}
// Whether a capture records the step as work of the host.
bool works_on_host(const Step& s);
// Of launches: the arguments of the contacts that the step keeps, and of its impulses.
ContactArguments kept_arguments(const Step& s);
ContactRecord contact_record(const Step& s);
inline KeptContacts kept_contacts(const Step& s) { return {numbers(s.contacts), s.contact_max}; }
inline articulation::ContactRows contact_rows_of(const Step& s) {
  return kept_contacts(s).rows(s.follow);
}
// ErrorKind::Runtime where the step is far from converged and nobody allows it. `what`: backward or
// jvp.
void require_converged(const Step& s, const char* what);
// In a capture of the host: its replays fail there, and these results are NaN.
void watch_convergence(const std::shared_ptr<const Step>& step, std::span<const Tensor> results,
                       const char* what);
// Whether a step has contacts or dry friction, as far as the host sees at once; or somebody asks
// for the gradient of friction.
bool acts(const Step& s, const Tensor& joint_friction);
StepOutputs outputs_of(const Step& s);
// What a replay of the step or of its adjoint reads and others may write.
std::vector<Tensor> reads_of(const Step& s);

// The arguments of the first step of an operation; take(values, place) gives those of an array.
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
// The step from the state `from`, or the first one's, into `to`.
void run_host(const Step& s, const ArticulationArguments& in, const StepOutputs* from,
              const StepOutputs& to);
// The step now, or in the replays of a capture. `tell`: counts its branches and writes the forces
// of its contacts.
void submit_forward(const std::shared_ptr<const Step>& step, bool tell);
// All steps of the operation again.
void run_all(const std::shared_ptr<const Step>& step);
// The adjoint of a step now, or in the replays of a capture.
void submit_vjp(const std::shared_ptr<const Step>& step, std::span<const Tensor> outputs,
                std::span<const nova::InputGradient> gradients);
// The adjoint of some steps, from the last on. The gradients of the states between them stay here.
void run_vjp_of_steps(const Step& s, std::span<const Tensor> outputs,
                      std::span<const nova::InputGradient> gradients);
// The tangents of all steps of the operation now, or in the replays of a capture.
void submit_jvp(const std::shared_ptr<const Step>& step, std::span<const Tensor> inputs,
                std::span<const Tensor> outputs);

}  // namespace detail
}  // namespace novaphy::diff
