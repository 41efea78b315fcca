// The solution of a step on a device, and the derivatives of a scalar by it (solution.h): sweeps
// and forces are launches; the host, which decides how far to go, has the rows.
#pragma once

#include <memory>

#include "launched_reverse.h"
#include "solution.h"

namespace novaphy::vbd {

class LaunchedSolution {
 public:
  LaunchedSolution(LaunchedStep& step, LaunchedReverse& reverse) : step_(step), reverse_(reverse) {}

  // Runs the step and moves it to its solution, as StepWork::run and TangentPass::solve_step.
  Solution run(const VbdLaunchInputs& in, const VbdLaunchResults& out,
               const VbdGradientOptions& options, const std::shared_ptr<ExclusiveUse>& in_use);
  // The same, for itself; and back, once `check` has seen how far it is solved.
  template <class Check>
  KrylovResult run_back(const VbdLaunchInputs& in, const Array& q_bar, const Array& qd_bar,
                        const VbdStepArrays& gradients, const VbdGradientOptions& options,
                        const std::shared_ptr<ExclusiveUse>& in_use, const Check& check) {
    reverse_.reserve(0);
    check(run(in, {reverse_.q_out_, reverse_.qd_out_, {}}, options, in_use));
    return reverse(in, q_bar, qd_bar, gradients, options);
  }

  // For solution.h.
  void sweep(const Rows& load, Rows& z, Rows& image);
  Rows force();
  void reverse_sweep(const Rows& load, Rows& multipliers, Rows& left);
  Rows balance(const Rows& given, const Rows& multipliers);
  Rows starts() const;
  Rows positions() const;
  Rows moves() const;
  void place(const Rows& x, const Rows& moved);
  VbdResidual residual();
  void iterate_again() { step_.iterate_again(with_contacts_); }
  void keep_loads(bool keep) { keeps_loads_ = keep; }
  bool is_held(size_t p) const { return step_.slots_.is_held(static_cast<int32_t>(p)); }

 private:
  KrylovResult reverse(const VbdLaunchInputs& in, const Array& q_bar, const Array& qd_bar,
                       const VbdStepArrays& gradients, const VbdGradientOptions& options);
  // See VbdTangentArguments.
  struct TangentRows {
    const DeviceArray<Vec4f>*x = nullptr, *load = nullptr, *force = nullptr, *force_slope = nullptr,
          *step_slope = nullptr;
  };
  // Of the groups of some colours.
  void tangent(size_t first_color, size_t last_color, const TangentRows& rows) const;

  LaunchedStep& step_;
  LaunchedReverse& reverse_;
  bool with_contacts_ = false, weights_ = false;  // of the step that runs
  bool keeps_loads_ = false;                      // see Tangents
  DeviceArray<Vec4f> x_, load_, result_, moved_;
};

}  // namespace novaphy::vbd
