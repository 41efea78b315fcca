#include "novaphy/vbd/differentiable_bodies.h"

#include <utility>

#include "bodies_adjoint.h"
#include "novaphy/core/error.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/contacts.h"
#include "solution.h"

namespace novaphy {
namespace {

constexpr const char* kName = "DiffSolverVBD";

void check_covered(const Model& m, const VbdGradientOptions& g) {
  require(m.particle_count() == 0, ErrorKind::NotImplemented, kName,
          ": model: expected no particles beside bodies, got particle_count ", m.particle_count(),
          ", because steps of both have no gradient; use SolverVBD");
  require(g.implicit, ErrorKind::NotImplemented, kName,
          ": gradient: expected \"implicit\" for a model with bodies, got \"unrolled\"");
}

}  // namespace

struct DifferentiableBodies::Work {
  Work(const Model& model, const VbdOptions& of_step, const VbdGradientOptions& of_gradient)
      : bodies(model, of_step), options(of_step), gradient(of_gradient) {}

  // Iterates to the solution of the step that bodies.begin() started.
  void solve() {
    const auto tolerance = static_cast<double>(gradient.tolerance);
    vbd::Solution found;
    bodies.couple(nullptr, {});
    for (int32_t k = 0; k < options.iterations; ++k) bodies.iterate_to_solution();
    found.residual = bodies.residual();
    constexpr int32_t kPatience = 3;  // iterations without a fall
    int32_t more = 0, last_fall = 0;
    double before = found.residual.relative, least = before;
    while (more < gradient.newton_iterations && before > tolerance) {
      bodies.iterate_to_solution();
      ++more;
      found.residual = bodies.residual();
      // Rounding may let the residual fall no further.
      if (found.is_solved(tolerance) && found.residual.relative > 0.5 * before) break;
      before = found.residual.relative;
      if (before < 0.5 * least) {
        least = before;
        last_fall = more;
      } else if (more - last_fall >= kPatience) {
        bodies.soften_rows();
        last_fall = more;
      }
    }
    bodies.check_result();
    found.residual.iterations = options.iterations;
    if (!gradient.allow_unconverged)
      found.check(kName, tolerance, gradient.newton_iterations,
                  "iterations or newton_iterations, or allow_unconverged");
    solution = std::make_shared<VbdBodySolution>(bodies.solution());
    solution->residual = found.residual;
    solution->residual.iterations += more;
    solution->is_solved = found.is_solved(tolerance);
  }

  // Checks whether the linear system of a derivative is solved, and keeps the report.
  void tell(const vbd::KrylovResult& linear, const VbdBodySolution& of) {
    const auto allowed = static_cast<double>(gradient.tolerance);
    const bool solved = linear.residual <= allowed;
    require(solved || gradient.allow_unconverged, ErrorKind::Runtime, kName,
            ": the linear system of the gradient was not solved: expected a relative residual of "
            "at most ",
            allowed, ", got ", linear.residual, " after ", linear.iterations,
            " sweeps; raise gradient_sweeps, or allow_unconverged");
    info = {"implicit",         of.residual,           linear.residual,
            linear.iterations, solved && of.is_solved, 0};
    has_info = true;
  }

  vbd::Bodies bodies;
  const VbdOptions options;
  const VbdGradientOptions gradient;
  std::shared_ptr<VbdBodySolution> solution;  // of the last step
  bool has_info = false;
  VbdGradientInfo info;
  ExclusiveUse in_use;
};

DifferentiableBodies::DifferentiableBodies(std::shared_ptr<const Model> model,
                                           const VbdOptions& options,
                                           const VbdGradientOptions& gradient_options)
    : model_(std::move(model)) {
  check_covered(*model_, gradient_options);
  SolverVBD(model_, options);  // checks the model and the options
  work_ = std::make_unique<Work>(*model_, options, gradient_options);
}

DifferentiableBodies::~DifferentiableBodies() = default;

std::shared_ptr<const VbdBodySolution> DifferentiableBodies::forward(const SimState& in,
                                                                     const SimState& out,
                                                                     const Control* control,
                                                                     const Contacts* contacts,
                                                                     float dt,
                                                                     bool contacts_follow) {
  Work& w = *work_;
  const ExclusiveUse::Scope scope(w.in_use, "DifferentiableBodies.forward", "the solver");
  const UntrackedScope untracked;
  const Unrecorded unrecorded;
  if (contacts != nullptr) w.bodies.reserve(contacts->rigid_contact_max());
  model_->update_derived();
  model_->check_structure(kName);
  w.bodies.begin(in, control, contacts, dt);
  w.solve();
  w.bodies.finish(in, out, contacts);
  w.solution->contacts_follow = contacts_follow;
  return std::exchange(w.solution, {});
}

void DifferentiableBodies::backward(const VbdBodySolution& solution, const SimState& in,
                                    const Control* control, float dt,
                                    const VbdBodyDerivatives& adjoints,
                                    const VbdBodyDerivatives& gradients) {
  Work& w = *work_;
  const ExclusiveUse::Scope scope(w.in_use, "DifferentiableBodies.backward", "the solver");
  const UntrackedScope untracked;
  const Unrecorded unrecorded;
  model_->update_derived();
  vbd::BodiesAdjoint adjoint({*model_, solution, in, control, dt});
  w.tell(adjoint.run(adjoints, gradients, w.gradient.krylov_sweeps), solution);
}

void DifferentiableBodies::tangent(const VbdBodySolution& solution, const SimState& in,
                                   const Control* control, float dt,
                                   const VbdBodyDerivatives& direction, Array q_out,
                                   Array qd_out) {
  Work& w = *work_;
  const ExclusiveUse::Scope scope(w.in_use, "DifferentiableBodies.tangent", "the solver");
  const UntrackedScope untracked;
  const Unrecorded unrecorded;
  model_->update_derived();
  vbd::BodiesAdjoint step({*model_, solution, in, control, dt});
  w.tell(step.tangent(direction, static_cast<float*>(q_out.raw_mutable()),
                      static_cast<float*>(qd_out.raw_mutable()), w.gradient.krylov_sweeps),
         solution);
}

bool DifferentiableBodies::has_frozen_contacts(const VbdBodySolution& solution) const {
  for (size_t k = 0; k < solution.contact.size(); ++k) {
    const int32_t(&shape)[2] = solution.contact_origin[k].shape;
    const VbdBodyContact& c = solution.contact[k];
    const bool is_exact =
        solution.contacts_follow && (vbd::is_world_plane(*model_, shape[0]) ||
                                     vbd::is_world_plane(*model_, shape[1]));
    if (c.lam_n > 0.0f && (!is_exact || c.ignored > 0.0f)) return true;
  }
  return false;
}

VbdGradientInfo DifferentiableBodies::info() const {
  require(work_->has_info, ErrorKind::Runtime, kName,
          ".gradient_info: expected a backward before");
  return work_->info;
}

void DifferentiableBodies::reset() { work_->bodies.reset(); }

}  // namespace novaphy
