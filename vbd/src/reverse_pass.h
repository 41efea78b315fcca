// A step of VBD in reverse: from the derivatives of a scalar by its results to those by the
// positions, targets and numbers that its sweeps read.
#pragma once

#include "krylov.h"
#include "receivers.h"
#include "rows.h"
#include "step_work.h"

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

  // By number k of the law of an element, over the corners that have it; by the weight of a
  // corner's slot: of its m-th other, component c.
  float law_bar(Role role, size_t element, int k) const;
  float weight_bar(Role role, size_t element, size_t corner, int number) const;

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
  void receive(size_t first_color, size_t last_color, Rows& rows);
  void clear_parameters();
  void finish(const Vec3f* qd_bar);
  bool is_held(size_t p) const { return step.slots.is_held(static_cast<int32_t>(p)); }

  Receivers receivers_;
  Adjoint bars_;
  Rows own_bar_, multiplier_;
  std::vector<float> others_[kRoles], numbers_[kRoles];
  uint64_t builds_ = 0;  // of the tables that the receivers were made from
};

}  // namespace novaphy::vbd
