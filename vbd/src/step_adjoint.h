// A step of VBD in reverse, as lists of launches. The step maps the adjoints of its results to the
// adjoints of its inputs.
#pragma once

#include <optional>
#include <vector>

#include "krylov.h"
#include "receivers.h"
#include "rows.h"
#include "step.h"

namespace novaphy::vbd {

// The adjoints of the results of a step. An array without rows means 0.
struct ResultAdjoints {
  const Array &q, &qd;
};

class StepAdjoint {
 public:
  explicit StepAdjoint(Step& step) : step_(step) {}

  // Computes the derivatives over the iterations of a run that stored its iterates.
  void unrolled(const StepInputs& in, const ResultAdjoints& adjoints, const StepDerivatives& to);
  // Computes the derivatives of the solution. Returns the true residual of the linear system.
  KrylovResult implicit(const StepInputs& in, const ResultAdjoints& adjoints,
                        const StepDerivatives& to, double tolerance, int32_t sweeps);

  // The functions that solution.h calls. See solve_transposed.
  void reverse_sweep(const Rows& load, Rows& multipliers, Rows& left);
  Rows balance(const Rows& given, const Rows& multipliers);
  Components components() const { return step_.components(); }

 private:
  using Rows4 = Step::Rows4;
  // Tables that depend on the slots. Launches of captures share them.
  struct Tables {
    uint64_t builds = 0;  // Step::builds() when the tables were made
    std::vector<int64_t> color_begin;
    DeviceArray<int32_t> particle, is_own, slot_particle;
    DeviceArray<uint64_t> begins;                  // of the roles: see VbdAdjointArguments
    DeviceArray<uint64_t> begin, others, entries;  // see Receivers
    DeviceArray<uint64_t> places[kRoles];
    DeviceArray<int32_t> world_begin, of_worlds;
  };
  // The properties of a run for which a list was made.
  struct Key {
    uint64_t version = 0;  // see Step::version
    int64_t block_groups = 0;
    bool with_contacts = false, damps = false;
    bool weights = false;  // also the adjoints of the weights of slots
    bool at_solution = false;
    bool operator==(const Key&) const = default;
  };

  void prepare(const StepInputs& in, const ResultAdjoints& adjoints, const StepDerivatives& to,
               bool at_solution);
  void build_tables();
  void reserve();
  VbdAdjointArguments arguments(const Rows4* before, int64_t first, int64_t end) const;
  void make_list(const VbdAdjointBeginArguments& begin, const VbdAdjointEndArguments& end);
  void add_groups(const VbdAdjointArguments& a, bool at_solution);
  // Adds the same launches for all groups at once, with the sums over receivers.
  void add_everywhere(const VbdAdjointArguments& a);
  void add_receive_all();
  // The launches of a coarse correction in reverse.
  void add_coarse_balance();
  void add_coarse_step(size_t iteration);
  void add_coarse_matrices();
  void add_receive(size_t color, const Rows4* own, const Rows4& rows,
                   int64_t parts = kVbdReceiveAll);
  void add_starts();
  // step_gradients.cpp
  void put(const StepInputs& in, const StepDerivatives& g) const;
  void put_state(const StepInputs& in, const StepDerivatives& g) const;
  void put_elements(const StepDerivatives& g) const;
  void put_contacts(const StepInputs& in, const StepDerivatives& g) const;

  Step& step_;
  Tables tables_;
  // The launches up to the adjoints of slots, targets and contacts. The list has five parts: clear
  // the memory; the adjoints of the positions; the sweeps in reverse; at a solution, the remainder
  // of the multipliers; the adjoints of the slots' values at the start of the step.
  std::optional<LaunchList> list_;
  LaunchList::Place<VbdAdjointBeginArguments> begin_;
  LaunchList::Place<VbdAdjointEndArguments> end_;
  size_t sweeps_ = 0, balance_ = 0;  // index of the first launch of these two parts
  Key key_;
  std::vector<Rows4> fields_;  // of the coarse steps: P A^-1 P^T times the adjoint
  Rows4 x_bar_, u_, d_, own_, start_bar_, target_bar_, gravity_bar_, multipliers_;
  DeviceArray<float> mass_adjoint_, terms_, numbers_, contact_adjoints_;
  DeviceArray<int32_t> shape_of_contact_, shape_begin_, of_shapes_;
};

}  // namespace novaphy::vbd
