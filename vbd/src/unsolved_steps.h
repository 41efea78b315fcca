// The steps of implicit gradients that were not solved, for the label of a chain of steps or a
// tape.
#pragma once

#include <algorithm>
#include <cstdint>
#include <map>
#include <memory>

#include "novaphy/vbd/differentiable_vbd.h"

namespace novaphy::diff {

constexpr double kUnsolvedResidual = 1e-3;  // of a step, or of the linear system of its gradient

class UnsolvedSteps {
 public:
  // Takes the report of the last derivative of a step. A step whose residual is within the rounding
  // of its forces is solved. NaN is not.
  void note(int64_t step, const VbdGradientInfo& of) {
    const double step_residual = of.primal.relative, linear = of.linear_residual;
    if (of.converged || (step_residual <= kUnsolvedResidual && linear <= kUnsolvedResidual)) {
      residuals_.erase(step);
    } else {
      residuals_[step] = step_residual > linear ? step_residual : linear;
    }
  }
  int64_t count() const { return static_cast<int64_t>(residuals_.size()); }
  int64_t first() const { return residuals_.begin()->first; }
  double largest() const {
    double most = 0.0;
    for (const auto& [step, residual] : residuals_) most = std::max(residual, most);
    return most;
  }

 private:
  std::map<int64_t, double> residuals_;  // by the number of the step
};

// Where a step reports, with its number there.
struct StepReport {
  std::shared_ptr<UnsolvedSteps> of_chain, of_tape;
  int64_t in_chain = 0, in_tape = 0;

  void note(const VbdGradientInfo& of) const {
    if (of_chain != nullptr) of_chain->note(in_chain, of);
    if (of_tape != nullptr) of_tape->note(in_tape, of);
  }
};

}  // namespace novaphy::diff
