// A step of VBD in reverse: from the derivatives of a scalar by its results to those by the
// positions, targets and numbers that its sweeps read.
#pragma once

#include "krylov.h"
#include "receivers.h"
#include "rows.h"
#include "step_work.h"
#include "vbd_gradient_kernels.h"

namespace novaphy::vbd {

class ReversePass {
 public:
  explicit ReversePass(StepWork& work) : step(work) {}

  // Clears all derivatives. `weights`: also by the weights of slots.
  void prepare(bool weights);
  // After a run that kept its iterates.
  void unrolled(const Vec3f* q_bar, const Vec3f* qd_bar);
  // At the solution. Returns how well the linear system was solved: the residual is the true one.
  KrylovResult implicit(const Vec3f* q_bar, const Vec3f* qd_bar, double tolerance, int32_t sweeps);

  // For solution.h.
  void reverse_sweep(const Rows& load, Rows& multipliers, Rows& left);
  const Rows& balance(const Rows& given, Rows& multipliers);
  bool is_held(size_t p) const { return step.slots.is_held(static_cast<int32_t>(p)); }

  // By the numbers of the slots of a role.
  VbdLawArguments law_bars(Role role) const {
    return {.places = direct(step.slots.table(role).places),
            .numbers = direct(numbers_[role]),
            .first = 0,
            .lanes = step.level.lanes};
  }

  StepWork& step;
  Rows x_bar;  // of the initial guess; of held particles: of where they are
  Rows start_bar, target_bar;
  std::vector<float> mass_bar;      // by mass/h^2
  std::vector<float> contact_bars;  // see Adjoint

 private:
  void begin(const Vec3f* q_bar, const Vec3f* qd_bar);
  void reverse_color(size_t color, const Rows& before);
  template <class Function>
  void for_groups(int64_t begin, int64_t end, Function&& function);
  void receive(size_t color, Rows& rows);
  void clear_parameters();
  void end(Row* guess, const Vec3f* qd_bar);

  Receivers receivers_;
  Adjoint bars_;
  std::vector<float> terms_, numbers_[kRoles];
  uint64_t builds_ = 0;  // of the tables that the receivers were made from
};

}  // namespace novaphy::vbd
