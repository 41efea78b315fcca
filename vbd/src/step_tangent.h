// The tangent of a step of VBD along a direction, and Newton's method that uses the tangent
// (solution.h). Sweeps and forces are launches. The host decides how many iterations run, and holds
// the vectors.
#pragma once

#include <vector>

#include "krylov.h"
#include "rows.h"
#include "solution.h"
#include "step.h"

namespace novaphy::vbd {

// The tangents of the inputs of a sweep (see VbdTangentArguments).
struct SweepTangents {
  Rows x;  // tangents of kinematic particles
  Rows start, target;
  Rows guess;  // tangent of the initial guess
  std::vector<float> mass, contacts, numbers;
  std::vector<int32_t> held;  // see VbdTangentArguments; empty: none
};
SweepTangents tangents_along(const Step& step, const StepInputs& in,
                             const StepDerivatives& direction);

class StepTangent {
 public:
  explicit StepTangent(Step& step) : step_(step) {}

  // Returns the tangents of the positions over the iterations of a run that stored its iterates.
  Rows unrolled(const SweepTangents& along);
  // Returns the tangents of the solution. `found` receives the true residual of the linear system.
  Rows implicit(const SweepTangents& along, double tolerance, int32_t sweeps, KrylovResult& found);
  // Iterates a step that has run to its solution. The iteration ends when the relative residual is
  // at most the tolerance or twice the rounding floor, or after `iterations`.
  Solution solve_step(double tolerance, int32_t iterations, int32_t sweeps);

  // The functions that solution.h calls. sweep: see solve_linear.
  void sweep(const Rows& load, Rows& z, Rows& image);
  Rows force();
  Rows starts() const { return download(step_.start()); }
  Rows positions() const { return download(step_.x()); }
  Rows moves() const { return download(step_.moved()); }
  void place(const Rows& x, const Rows& moved) { step_.place(x, moved); }
  VbdResidual residual() { return step_.residual(); }
  Flags solved(double tolerance) { return step_.solved(tolerance); }
  void iterate_again() { step_.iterate_again(); }
  // Holds the friction loads of the current positions constant, so that the forces have an energy.
  void keep_loads(bool keep);
  Components components() const { return step_.components(); }

 private:
  using Rows4 = Step::Rows4;

  void reserve();
  void put(const SweepTangents& along);
  // Returns the arguments for the groups of some colors. `along`: with the tangents that put() set.
  VbdTangentArguments arguments(size_t first_color, size_t last_color, bool along) const;
  void launch(const VbdTangentArguments& arguments) const;
  void move(size_t color, const Rows4& x) const;
  // Compute the tangent of a coarse correction: of the step of an iteration, and of the balance.
  void correct(size_t iteration, const Rows4& swept);
  void balance();
  Rows force_tangent(const Rows& x);

  Step& step_;
  bool keeps_loads_ = false;  // see keep_loads
  Rows4 x_, load_, result_, moved_, loads_at_, start_, target_;
  DeviceArray<float> mass_, contacts_, numbers_;
  DeviceArray<int32_t> held_;
};

}  // namespace novaphy::vbd
