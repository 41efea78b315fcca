// The derivative of a step of VBD along a direction, and Newton's method with it.
#pragma once

#include "krylov.h"
#include "rows.h"
#include "solution.h"
#include "step_work.h"

namespace novaphy::vbd {

class TangentPass {
 public:
  explicit TangentPass(StepWork& work) : step(work) {}

  // Clears the direction.
  void prepare();
  // After a run that kept its iterates.
  void unrolled();
  // At the solution. Returns how well the linear system was solved: the residual is the true one.
  KrylovResult implicit(double tolerance, int32_t sweeps);
  // Moves a step that was run to its solution: until its relative residual is at most the
  // tolerance, or twice what rounding allows, or `iterations` are over.
  Solution solve_step(double tolerance, int32_t iterations, int32_t sweeps);

  // For solution.h.
  void sweep(const Rows& load, Rows& z, Rows& image);
  Rows force();
  const Rows& starts() const { return step.start; }
  const Rows& positions() const { return step.x; }
  const Rows& moves() const { return step.moved; }
  void place(const Rows& x, const Rows& moved) const {
    step.x = x;
    step.moved = moved;
  }
  VbdResidual residual() const { return step.residual(); }
  void iterate_again() const { step.iterate_again(); }
  void keep_loads(bool keep) { tangents_.keeps_loads = keep; }
  bool is_held(size_t p) const { return step.slots.is_held(static_cast<int32_t>(p)); }

  StepWork& step;
  Rows x_slope;  // of held particles the direction; of the others the result
  Rows start_slope, target_slope;
  Rows guess_slope;  // of where iterations began
  std::vector<float> mass_slope, contact_slopes, number_slopes[kRoles];  // see Tangents

 private:
  template <class Function>
  void for_groups(size_t first_color, size_t last_color, Function&& function);
  template <class Function>
  void for_particles(size_t color, Function&& function);
  void tangent_start();

  Tangents tangents_;
};

}  // namespace novaphy::vbd
