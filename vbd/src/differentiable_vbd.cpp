#include "novaphy/vbd/differentiable_vbd.h"

#include <cmath>
#include <utility>
#include <vector>

#include "launched_reverse.h"
#include "launched_solution.h"
#include "model_derivatives.h"
#include "novaphy/core/error.h"
#include "novaphy/core/exclusive_use.h"

namespace novaphy {
namespace {

void check_covered(const VbdOptions& o) {
  const auto refuse = [](bool given, const char* option) {
    require(!given, ErrorKind::NotImplemented, "DiffSolverVBD: ", option,
            ": its gradient is not there yet");
  };
  refuse(o.acceleration.has_value(), "acceleration");
  refuse(o.tolerance.has_value(), "tolerance");
  refuse(o.safeguard, "safeguard");
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

// What is told of implicit derivatives, and asked of them.
struct Solved {
  void see_step(const vbd::Solution& found) {
    primal = found.residual;
    const double allowed = std::max(static_cast<double>(gradient.tolerance), 2.0 * primal.floor);
    is_solved = found.is_minimum && primal.relative <= allowed;
    require(found.is_minimum || gradient.allow_unconverged, ErrorKind::Runtime,
            "DiffSolverVBD: the step was not solved: expected a minimum of its energy, got a "
            "saddle, where conjugate gradients met negative curvature; take shorter steps, raise "
            "iterations, or allow_unconverged");
    require(is_solved || gradient.allow_unconverged, ErrorKind::Runtime,
            "DiffSolverVBD: the step was not solved: expected a relative residual of at most ",
            allowed, ", got ", primal.relative, " after ", primal.iterations, " iterations and ",
            gradient.newton_iterations,
            " of Newton's method; raise iterations or newton_iterations, or allow_unconverged");
  }
  VbdGradientInfo see_linear(const vbd::KrylovResult& linear) const {
    const double allowed = static_cast<double>(gradient.tolerance);
    const bool solved = linear.residual <= allowed;
    require(solved || gradient.allow_unconverged, ErrorKind::Runtime,
            "DiffSolverVBD: the linear system of the gradient was not solved: expected a relative "
            "residual of at most ",
            allowed, ", got ", linear.residual, " after ", linear.iterations,
            " sweeps; raise gradient_sweeps, or allow_unconverged");
    return {"implicit", primal, linear.residual, linear.iterations, solved && is_solved};
  }

  VbdGradientOptions gradient;
  VbdResidual primal = {};
  bool is_solved = true;
};

}  // namespace

struct DifferentiableVbd::Work {
  Work(const Model& model, const VbdOptions& options, const VbdGradientOptions& gradient_options)
      : step(model, options, !gradient_options.implicit),
        reverse(step),
        tangent(step),
        gradient(gradient_options),
        solved{gradient_options},
        q_out(step.x.size()),
        qd_out(step.x.size()) {}

  void run(const VbdStepInputs& in, Vec3f* q, Vec3f* qd) {
    step.update(in.tri_activation, in.tet_activation, in.contacts, in.dt);
    step.run({in.particle_q, in.particle_qd, in.particle_f, q, qd, in.last_velocity}, in.targets);
    if (gradient.implicit)
      solved.see_step(tangent.solve_step(static_cast<double>(gradient.tolerance),
                                         gradient.newton_iterations, gradient.krylov_sweeps));
  }
  void run_again(const VbdStepInputs& in) {
    run(in, q_out.data(), qd_out.data());
    if (!gradient.implicit) solved.primal = step.residual();
  }
  void tell(const vbd::KrylovResult& linear) {
    info = solved.see_linear(linear);
    has_info = true;
  }
  void tell() {
    info = {"exact", solved.primal, 0.0, 0, true};
    has_info = true;
  }

  vbd::StepWork step;
  vbd::ReversePass reverse;
  vbd::TangentPass tangent;
  const VbdGradientOptions gradient;
  Solved solved;
  vbd::GradientMemory memory;
  std::vector<Vec3f> q_out, qd_out;
  bool has_info = false;
  VbdGradientInfo info;
  ExclusiveUse in_use;
};

struct DifferentiableVbd::Launched {
  Launched(const Model& model, const VbdOptions& options, const VbdGradientOptions& gradient)
      : step(model, options), reverse(step), solution(step, reverse), solved{gradient} {}

  vbd::LaunchedStep step;
  vbd::LaunchedReverse reverse;
  vbd::LaunchedSolution solution;
  Solved solved;
  bool has_info = false;
  VbdGradientInfo info;  // implicit
  ExclusiveUse in_use;
};

DifferentiableVbd::DifferentiableVbd(std::shared_ptr<const Model> model, const VbdOptions& options,
                                     const VbdGradientOptions& gradient_options)
    : model_(std::move(model)) {
  check_covered(options);
  check_gradient_options(options, gradient_options);
  SolverVBD(model_, options);  // makes its checks
  if (!model_->device().is_cpu()) {
    launched_ = std::make_unique<Launched>(*model_, options, gradient_options);
    return;
  }
  work_ = std::make_unique<Work>(*model_, options, gradient_options);
}

DifferentiableVbd::~DifferentiableVbd() = default;

int32_t DifferentiableVbd::held_count() const {
  return launched_ != nullptr ? launched_->step.held_count()
                              : static_cast<int32_t>(work_->step.slots.held().size());
}

VbdGradientInfo DifferentiableVbd::info() const {
  if (launched_ != nullptr) launched_->step.check();
  require(launched_ != nullptr ? launched_->has_info : work_->has_info, ErrorKind::Runtime,
          "DiffSolverVBD.gradient_info: expected a backward before");
  if (launched_ != nullptr && !launched_->solved.gradient.implicit)
    return {"exact", launched_->step.last_residual(), 0.0, 0, true};
  if (launched_ != nullptr) return launched_->info;
  return work_->info;
}

void DifferentiableVbd::forward(const VbdStepInputs& in, Vec3f* q_out, Vec3f* qd_out) {
  const ExclusiveUse::Scope scope(work_->in_use, "DifferentiableVbd.forward", "the solver");
  model_->update_derived();
  work_->step.damps = false;
  work_->run(in, q_out, qd_out);
}

void DifferentiableVbd::backward(const VbdStepInputs& in, const Vec3f* q_out_bar,
                                 const Vec3f* qd_out_bar, const VbdStepGradients& gradients) {
  const ExclusiveUse::Scope scope(work_->in_use, "DifferentiableVbd.backward", "the solver");
  Work& w = *work_;
  model_->update_derived();
  w.step.damps = vbd::wants_damping(gradients);
  w.run_again(in);
  w.reverse.prepare(vbd::wants_weights(gradients));
  if (w.gradient.implicit) {
    w.tell(w.reverse.implicit(q_out_bar, qd_out_bar, static_cast<double>(w.gradient.tolerance),
                              w.gradient.krylov_sweeps));
  } else {
    w.reverse.unrolled(q_out_bar, qd_out_bar);
    w.tell();
  }
  vbd::put_gradients(w.reverse, in, gradients, w.gradient.implicit, w.memory);
}

void DifferentiableVbd::forward(const VbdLaunchInputs& in, const DeviceArray<Vec3f>& q_out,
                                const DeviceArray<Vec3f>& qd_out,
                                const std::shared_ptr<ExclusiveUse>& in_use) {
  const ExclusiveUse::Scope scope(launched_->in_use, "DifferentiableVbd.forward", "the solver");
  {
    const Unobserved of_the_model;
    model_->update_derived();
  }
  Launched& w = *launched_;
  w.step.update(in.dt);
  w.step.set_damps(in.trains_elements);
  if (w.solved.gradient.implicit) {
    w.solved.see_step(w.solution.run(in, {q_out, qd_out, {}}, w.solved.gradient, in_use));
  } else {
    w.step.run(in, {q_out, qd_out, {}}, in_use);
  }
}

void DifferentiableVbd::backward(const VbdLaunchInputs& in, const Array& q_out_bar,
                                 const Array& qd_out_bar, const VbdStepArrays& gradients,
                                 const std::shared_ptr<ExclusiveUse>& in_use) {
  const ExclusiveUse::Scope scope(launched_->in_use, "DifferentiableVbd.backward", "the solver");
  {
    const Unobserved of_the_model;
    model_->update_derived();
  }
  Launched& w = *launched_;
  w.step.update(in.dt);
  w.step.set_damps(in.trains_elements || vbd::wants_damping(gradients));
  if (w.solved.gradient.implicit) {
    w.info = w.solved.see_linear(
        w.solution.run_back(in, q_out_bar, qd_out_bar, gradients, w.solved.gradient, in_use,
                            [&w](const vbd::Solution& found) { w.solved.see_step(found); }));
  } else {
    w.reverse.run(in, q_out_bar, qd_out_bar, gradients, in_use);
  }
  w.has_info = true;
}

void DifferentiableVbd::tangent(const VbdStepInputs& in, const VbdStepTangents& direction,
                                Vec3f* q_out_slope, Vec3f* qd_out_slope) {
  const ExclusiveUse::Scope scope(work_->in_use, "DifferentiableVbd.tangent", "the solver");
  Work& w = *work_;
  model_->update_derived();
  w.step.damps = vbd::wants_damping(direction);
  w.run_again(in);
  w.tangent.prepare();
  vbd::set_direction(w.tangent, in, direction);
  if (w.gradient.implicit) {
    w.tell(w.tangent.implicit(static_cast<double>(w.gradient.tolerance), w.gradient.krylov_sweeps));
  } else {
    w.tangent.unrolled();
    w.tell();
  }
  for (size_t p = 0; p < w.q_out.size(); ++p) {
    const Vec3f x = w.tangent.x_slope[p];
    q_out_slope[p] = x;
    qd_out_slope[p] = (x - Vec3f(w.tangent.start_slope[p])) / in.dt;
  }
}

}  // namespace novaphy
