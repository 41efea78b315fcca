// The way back through a step of VBD as launches (core/device_kernel.h), on devices: reverse_pass.h
// with the same laws, and the same order of sums.
#pragma once

#include <memory>
#include <vector>

#include "launched_step.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "receivers.h"
#include "vbd_adjoint_kernels.h"
#include "vbd_gradient_kernels.h"

namespace novaphy::vbd {

class LaunchedReverse {
 public:
  explicit LaunchedReverse(LaunchedStep& step) : step_(step) {}

  // Runs the step once more, keeps its iterates and goes back through them. Bars without rows: 0.
  // Call LaunchedStep::update before.
  void run(const VbdLaunchInputs& in, const Array& q_bar, const Array& qd_bar,
           const VbdStepArrays& gradients, const std::shared_ptr<ExclusiveUse>& in_use);

 private:
  friend class LaunchedSolution;
  // At a solution: given multipliers, or the sum of those that are found.
  struct AtRest {
    const DeviceArray<Vec4f>* multipliers = nullptr;
    const DeviceArray<Vec4f>* sum = nullptr;
  };
  // Made of the slots. Launches of captures keep them.
  struct Tables {
    uint64_t builds = 0;  // of the slots
    std::vector<int64_t> numbers_begin, color_begin;
    DeviceArray<int32_t> particle, is_own, slot_particle;
    DeviceArray<uint64_t> begins;                  // of roles: see VbdAdjointArguments
    DeviceArray<uint64_t> begin, others, entries;  // see Receivers
    DeviceArray<uint64_t> places[kRoles];
    std::vector<int64_t> slots[kRoles];  // of the groups before each of them, and of all
    DeviceArray<int32_t> world_begin, of_worlds;
  };

  void build_tables();
  void reserve(int32_t iterates);
  void reserve_contacts();
  using Rows4 = DeviceArray<Vec4f>;
  void clear(const Array& values) const;
  VbdAdjointArguments arguments(bool with_contacts, const Rows4* before, int64_t first, int64_t end,
                                const AtRest* rest) const;
  void receive(size_t color, const Rows4* own, const DeviceArray<Vec4f>& rows,
               int64_t parts = kVbdReceiveAll) const;
  void clear_parameters(bool with_contacts) const;
  void begin(bool with_contacts, const Array& q_bar, const Array& qd_bar);
  void reverse_groups(bool with_contacts, bool weights, const Rows4* before, int64_t first,
                      int64_t end, const AtRest* rest) const;
  void reverse_colors(bool with_contacts, bool weights) const;
  void end(bool with_contacts, bool weights, const Rows4* guess, const Array& qd_bar) const;
  static bool wants_weights(const VbdStepArrays& g);
  // `at_solution`: the derivatives of the solution, which does not depend on the guess.
  void put(const VbdLaunchInputs& in, const VbdStepArrays& g, bool at_solution);
  void put_state(const VbdLaunchInputs& in, const VbdStepArrays& g, bool at_solution) const;
  void put_elements(const VbdStepArrays& g) const;
  void put_contacts(const VbdLaunchInputs& in, const VbdStepArrays& g);
  VbdLawArguments law_bars(Role role) const;

  LaunchedStep& step_;
  Tables tables_;
  std::vector<DeviceArray<Vec4f>> iterates_;
  DeviceArray<Vec3f> q_out_, qd_out_;
  DeviceArray<Vec4f> x_bar_, u_, d_, own_, start_bar_, target_bar_, gravity_bar_;
  DeviceArray<float> mass_bar_, terms_, numbers_, contact_bars_;
  DeviceArray<int32_t> shape_of_contact_, shape_begin_, of_shapes_;
};

}  // namespace novaphy::vbd
