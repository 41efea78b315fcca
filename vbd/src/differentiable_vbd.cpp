#include "novaphy/vbd/differentiable_vbd.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "contact_forces.h"
#include "novaphy/core/error.h"
#include "novaphy/core/exclusive_use.h"
#include "step_adjoint.h"
#include "step_tangent.h"

namespace novaphy {
namespace {

using vbd::StepDerivatives;
using vbd::StepInputs;

// While an object of this class exists, no recorder and no tracker sees the work of this thread.
struct Unseen {
  const UntrackedScope untracked;
  const Unrecorded unrecorded;
};

void check_covered(const VbdOptions& o) {
  const auto refuse = [](bool given, const char* option) {
    require(!given, ErrorKind::NotImplemented, "DiffSolverVBD: ", option,
            ": the option is not supported, it has no gradient; use SolverVBD");
  };
  refuse(o.acceleration.has_value(), "acceleration");
  refuse(o.tolerance.has_value(), "tolerance");
  refuse(o.safeguard, "safeguard");
  refuse(o.converged, "solve \"converged\"");
}

void check_gradient_options(const VbdOptions& o, const VbdGradientOptions& g) {
  constexpr const char* name = "DiffSolverVBD: ";
  require(std::isfinite(g.tolerance) && g.tolerance > 0.0f, ErrorKind::Value, name,
          "gradient_tolerance: expected a finite number > 0, got ", g.tolerance);
  require(g.newton_iterations >= 0, ErrorKind::Value, name,
          "newton_iterations: expected >= 0, got ", g.newton_iterations);
  require(g.krylov_sweeps >= 1, ErrorKind::Value, name, "gradient_sweeps: expected >= 1, got ",
          g.krylov_sweeps);
  require(!g.implicit || o.iterations >= 1, ErrorKind::Value, name,
          "iterations: expected >= 1 with implicit gradients, got ", o.iterations);
}

// Checks whether the step and the linear system of implicit derivatives are solved, and makes their
// report.
struct Solved {
  void see_step(const vbd::Solution& found) {
    const auto tolerance = static_cast<double>(gradient.tolerance);
    primal = found.residual;
    is_solved = found.is_solved(tolerance);
    if (!gradient.allow_unconverged)
      found.check("DiffSolverVBD", tolerance, gradient.newton_iterations,
                  "iterations or newton_iterations, or allow_unconverged");
  }
  VbdGradientInfo see_linear(const vbd::KrylovResult& linear) const {
    const double allowed = linear.allowed(static_cast<double>(gradient.tolerance));
    const bool solved = linear.residual <= allowed;
    const bool is_cut = linear.iterations >= gradient.krylov_sweeps;
    require(solved || gradient.allow_unconverged, ErrorKind::Runtime,
            "DiffSolverVBD: the linear system of the gradient was not solved: expected a relative "
            "residual of at most ",
            allowed, ", got ", linear.residual, " after ", linear.iterations, " sweeps; ",
            is_cut ? "raise gradient_sweeps" : "more sweeps do not help: raise gradient_tolerance",
            ", or allow_unconverged");
    return {"implicit", primal, linear.residual, linear.iterations, solved && is_solved, 0};
  }

  VbdGradientOptions gradient;
  VbdResidual primal = {};
  bool is_solved = true;
};

}  // namespace

struct DifferentiableVbd::Work {
  Work(const Model& model, const VbdOptions& options, const VbdGradientOptions& gradient_options)
      : step(model, options, gradient_options.implicit),
        reverse(step),
        tangent(step),
        gradient(gradient_options),
        solved{gradient_options},
        q_out(step.x().rows(), model.device()),
        qd_out(step.x().rows(), model.device()) {}

  // The scope of one call of the solver. On the CPU the work of a call runs at once, without a
  // recorder.
  struct Call {
    Call(Work& work, const char* name, const std::shared_ptr<ExclusiveUse>& use)
        : scope(work.in_use, name, "the solver") {
      if (work.step.on_cpu()) unseen.emplace();
      work.in_use_of_caller = use;
    }
    const ExclusiveUse::Scope scope;
    std::optional<Unseen> unseen;
  };

  void run(const StepInputs& in, const vbd::StepResults& out, bool damps) {
    {
      const UntrackedScope of_the_model;
      step.model().update_derived();
    }
    step.update(in.dt, damps);
    step.run(in, out, in_use_of_caller);
    if (!gradient.implicit) return;
    step.check();
    solved.see_step(tangent.solve_step(static_cast<double>(gradient.tolerance),
                                       gradient.newton_iterations, gradient.krylov_sweeps));
  }
  // Runs the step once more, because derivatives read its intermediate values.
  void run_again(const StepInputs& in, bool damps) {
    run(in, {.q = q_out, .qd = qd_out, .keeps_iterates = !gradient.implicit}, damps);
    if (!gradient.implicit) step.find_residuals();
  }
  void tell(const vbd::KrylovResult& linear) {
    if (gradient.implicit) info = solved.see_linear(linear);
    has_info = true;
  }

  void forward(const StepInputs& in, const vbd::StepResults& out) {
    run(in, out, in.trains_elements);
  }
  void backward(const StepInputs& in, const vbd::ResultAdjoints& adjoints,
                const StepDerivatives& to) {
    along.reset();
    run_again(in, in.trains_elements || vbd::wants(to, vbd::kMaterial));
    if (!gradient.implicit) {
      reverse.unrolled(in, adjoints, to);
      return tell({});
    }
    const UntrackedScope untracked;
    tell(reverse.implicit(in, adjoints, to, static_cast<double>(gradient.tolerance),
                          gradient.krylov_sweeps));
  }
  // Returns the tangents of the positions and of the velocities after the step.
  std::array<vbd::Rows, 2> tangents(const StepInputs& in, const StepDerivatives& direction,
                                    std::span<const int32_t> held) {
    run_again(in, vbd::wants(direction, vbd::kMaterial));
    step.check();
    along = vbd::tangents_along(step, in, direction);
    along->held = vbd::held_contacts(step, held);
    vbd::KrylovResult found;
    std::array<vbd::Rows, 2> all;
    all[0] = gradient.implicit ? tangent.implicit(*along, static_cast<double>(gradient.tolerance),
                                                  gradient.krylov_sweeps, found)
                               : tangent.unrolled(*along);
    tell(found);
    for (size_t p = 0; p < all[0].size(); ++p)
      all[1].emplace_back((Vec3f(all[0][p]) - Vec3f(along->start[p])) / in.dt);
    moved = all[0];
    return all;
  }

  vbd::Step step;
  vbd::StepAdjoint reverse;
  vbd::StepTangent tangent;
  const VbdGradientOptions gradient;
  Solved solved;
  DeviceArray<Vec3f> q_out, qd_out;
  std::optional<vbd::SweepTangents> along;  // of the last tangent; none after a backward
  vbd::Rows moved;                          // tangents of the positions along it
  bool has_info = false;
  VbdGradientInfo info;  // set only with implicit gradients
  ExclusiveUse in_use;
  std::shared_ptr<ExclusiveUse> in_use_of_caller;  // a recording keeps it
};

DifferentiableVbd::DifferentiableVbd(std::shared_ptr<const Model> model, const VbdOptions& options,
                                     const VbdGradientOptions& gradient_options)
    : model_(std::move(model)) {
  check_covered(options);
  check_gradient_options(options, gradient_options);
  require(model_->body_count() == 0, ErrorKind::NotImplemented,
          "DiffSolverVBD: model: expected body_count 0, got ", model_->body_count(),
          ", because steps of bodies have no gradient; use SolverVBD");
  SolverVBD(model_, options);  // checks the model and the options
  work_ = std::make_unique<Work>(*model_, options, gradient_options);
}

DifferentiableVbd::~DifferentiableVbd() = default;

int32_t DifferentiableVbd::kinematic_count() const { return work_->step.kinematic_count(); }

VbdGradientInfo DifferentiableVbd::info() const {
  work_->step.check();
  require(work_->has_info, ErrorKind::Runtime,
          "DiffSolverVBD.gradient_info: expected a backward before");
  if (work_->gradient.implicit) return work_->info;
  return {"exact", work_->step.last_residual(), 0.0, 0, true, work_->step.halvings()};
}

void DifferentiableVbd::forward(const VbdStepInputs& in, const DeviceArray<Vec3f>& q_out,
                                const DeviceArray<Vec3f>& qd_out,
                                const std::shared_ptr<ExclusiveUse>& in_use) {
  const Work::Call call(*work_, "DifferentiableVbd.forward", in_use);
  work_->forward(in, {.q = q_out, .qd = qd_out});
}

void DifferentiableVbd::backward(const VbdStepInputs& in, const Array& q_out_adjoint,
                                 const Array& qd_out_adjoint, const VbdStepDerivatives& gradients,
                                 const std::shared_ptr<ExclusiveUse>& in_use) {
  const Work::Call call(*work_, "DifferentiableVbd.backward", in_use);
  work_->backward(in, {q_out_adjoint, qd_out_adjoint}, gradients);
}

void DifferentiableVbd::tangent(const VbdStepInputs& in, const VbdStepDerivatives& direction,
                                DeviceArray<Vec3f> q_out_tangent, DeviceArray<Vec3f> qd_out_tangent,
                                std::span<const int32_t> held) {
  const Work::Call call(*work_, "DifferentiableVbd.tangent", {});
  const Unseen unseen;
  const auto tangents = work_->tangents(in, direction, held);
  q_out_tangent.copy_from_host(std::vector<Vec3f>(tangents[0].begin(), tangents[0].end()));
  qd_out_tangent.copy_from_host(std::vector<Vec3f>(tangents[1].begin(), tangents[1].end()));
}

std::vector<VbdContactForce> DifferentiableVbd::contact_forces(const VbdStepInputs& in) const {
  return vbd::contact_forces(work_->step, in, work_->q_out.to_host(),
                             work_->along ? &*work_->along : nullptr, work_->moved);
}

}  // namespace novaphy
