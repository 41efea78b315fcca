// BodiesAdjoint: the adjoint of the solution of a step of bodies (DifferentiableBodies), and its
// tangent.
#pragma once

#include <optional>
#include <vector>

#include "block_system.h"
#include "bodies_duals.h"
#include "krylov.h"

namespace novaphy::vbd {

// A step of bodies and its solution.
struct SolvedBodies {
  const Model& model;
  const VbdBodySolution& solution;
  const SimState& in;
  const Control* control;
  float dt;
};

class BodiesAdjoint {
 public:
  explicit BodiesAdjoint(const SolvedBodies& step);
  // Computes the derivatives. `sweeps`: maximum count of solutions with the factored matrix. The
  // result tells how exact the rows are solved.
  KrylovResult run(const VbdBodyDerivatives& adjoints, const VbdBodyDerivatives& gradients,
                   int32_t sweeps);
  // Computes the tangents {n, 7} and {n, 6} of the results along a direction of the inputs.
  KrylovResult tangent(const VbdBodyDerivatives& along, float* q_out, float* qd_out,
                       int32_t sweeps);

 private:
  // A joint or a contact, with the derivatives of its forces and rows. Columns and force rows are
  // those of body A, then of body B.
  template <class At>
  struct Pair {
    At at;
    int32_t body[2] = {-1, -1};
    size_t index = 0;                       // the joint of the model, or the contact of the step
    double by_lam[kMostRows][12] = {};      // force by multiplier
    double by_motion[kMostRows][12] = {};   // row by motion
    double compliance[kMostRows] = {}, penalty[kMostRows] = {};
    double nu[kMostRows] = {};     // adjoint of each row; in tangent(): tangent of its multiplier
    double along[kMostRows] = {};  // tangent(): of each row, with constant motions and multipliers
    double stiffness(int k) const { return 1.0 / (compliance[k] + 1.0 / penalty[k]); }
    // Adds the next row.
    void add(float multiplier, double compliance_of_row, float rho);
  };
  using Joint = Pair<DualJoint>;
  using Touch = Pair<DualContact>;
  // The sums of the derivatives with respect to one array. Empty: not asked for.
  struct Sums {
    Array to;
    std::vector<double> of;
    explicit Sums(const Array& array) : to(array), of(array.bytes() / sizeof(float)) {}
    void add(size_t k, double value) {
      if (!of.empty()) of[k] += value;
    }
    void write();
  };
  struct Gradients;

  static size_t index(int32_t k) { return static_cast<size_t>(k); }
  bool moves(int32_t body) const { return body >= 0 && row_[index(body)] >= 0; }
  size_t row(int32_t body) const { return index(row_[index(body)]); }
  DualBody body_at(int32_t body) const;
  Joint joint_at(size_t k) const;
  static void add_rows(const VbdBodyJoint& j, const JointErrors& e, Joint& to);
  void add_touch(size_t k);
  // Calls visit(pair) for each joint and each contact that pushes.
  template <class Visit>
  void for_pairs(const Visit& visit) {
    for (Joint& j : joint_) visit(j);
    for (Touch& t : touch_) visit(t);
  }
  template <class At>
  void put_derivatives(Pair<At>& j, BlockSystem& system) const;
  template <class At>
  void put_coupling(const Pair<At>& j, BlockSystem& system) const;
  double relative_change(const std::vector<Row6>& before, const std::vector<Row6>& after);
  bool is_solved(const std::vector<Row6>& before, const std::vector<Row6>& after,
                 KrylovResult& result);
  KrylovResult solve(int32_t sweeps);
  // Applies a direction to a copy of the joint or body. Returns minus the product of the adjoints
  // and the derivatives.
  template <class At, class Seed>
  double along(const Pair<At>& j, const Seed& seed) const;
  template <class Seed>
  double along(int32_t body, const DualBody& at, const Seed& seed) const;
  void take_results(const VbdBodyDerivatives& adjoints, Gradients& to);
  void pull_bodies(Gradients& to) const;
  void pull_mass(int32_t body, const DualBody& at, Gradients& to) const;
  template <class At>
  void pull_poses(const Pair<At>& j, Gradients& to);
  void pull_material(const Touch& t, Gradients& to) const;
  void pull_axis(const Joint& j, Gradients& to) const;
  void pull_kinematic(Gradients& to) const;
  // bodies_tangent.cpp
  struct Tangents;
  Tangents tangents_of(const VbdBodyDerivatives& along) const;
  template <class At>
  void put_poses(const Pair<At>& j, const Tangents& t, At& at) const;
  void put_inputs(const Joint& j, const Tangents& t, DualJoint& at) const;
  void put_inputs(const Touch& j, const Tangents& t, DualContact& at) const;
  void put_inputs(size_t b, const Tangents& t, BodyStart<DualFloat>& to) const;
  KrylovResult solve_tangent(const std::vector<Row6>& load, int32_t sweeps,
                             std::vector<Row6>& found);
  void put_results(const Tangents& t, float* q_out, float* qd_out) const;

  const SolvedBodies step_;
  std::vector<int32_t> row_;   // of each body: its row in the system, or -1: kinematic
  int32_t rows_ = 0;
  double largest_ = 0.0;  // see relative_change
  std::vector<Joint> joint_;
  std::vector<Touch> touch_;  // the contacts that push
  std::vector<Row6> load_;     // adjoint of the motion of each body
  std::vector<Row6> mu_;       // adjoint of the forces on each body; kinematic: 0
  std::optional<BlockSystem> system_;
};

}  // namespace novaphy::vbd
