#include "body_actuators.h"

#include <algorithm>

#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/dynamics/joint_coordinates.h"

namespace novaphy {
namespace detail {
const char* body_actuation_kernels_source();
}

BodyActuators::BodyActuators(const Model& m)
    : articulations_(m, "model.actuator_body", Articulations::For::Steps) {
  const UntrackedScope untracked;
  const OnHost<int32_t> dof(m.actuator_dof), joint_parent(m.joint_parent),
      joint_child(m.joint_child), tree_of_joint(m.joint_articulation),
      words(articulations_.links()), row_words(articulations_.rows());
  const OnHost<Vec2i> body(m.actuator_body);
  const auto* const rows = reinterpret_cast<const ArticulationRows*>(row_words.data());
  const auto* const links = reinterpret_cast<const articulation::Link*>(words.data());
  const auto bodies = static_cast<size_t>(m.body_count());
  std::vector<int32_t> link_of(bodies, -1), tree_of(bodies, -1), parent(bodies, -1);
  for (int64_t i = 0; i < articulations_.count(); ++i)
    for (int32_t k = 0; k < rows[i].link_count; ++k) {
      const int32_t b = links[rows[i].first_link + k].body;
      if (b < 0) continue;
      link_of[static_cast<size_t>(b)] = k;
      tree_of[static_cast<size_t>(b)] = static_cast<int32_t>(i);
    }
  for (size_t j = 0; j < joint_child.size(); ++j)
    if (tree_of_joint[j] >= 0) parent[static_cast<size_t>(joint_child[j])] = joint_parent[j];

  std::vector<int32_t> trees(dof.size(), -1), pushed(3 * dof.size(), -1);
  bodies_.assign(dof.size(), {{-1, -1, -1}});
  dofs_.assign(dof.size(), -1);
  for (size_t k = 0; k < dof.size(); ++k) {
    if (dof[k] >= 0) continue;
    const int32_t a = body[k].x, b = body[k].y;
    const auto tree = [&](int32_t of) { return tree_of[static_cast<size_t>(of)]; };
    require(a < 0 || b < 0 || tree(a) == tree(b), ErrorKind::NotImplemented, "model.actuator_body[",
            k, "] (\"", m.actuator_label[k],
            "\"): expected two bodies of one articulation, or the world, got ", a, " and ", b);
    trees[k] = tree(a < 0 ? b : a);
    dofs_[k] = rows[trees[k]].dof_count > 0 ? rows[trees[k]].first_dof : 0;
    std::vector<int32_t> above;
    for (int32_t of = a; of >= 0; of = parent[static_cast<size_t>(of)]) above.push_back(of);
    int32_t common = b;
    while (common >= 0 && std::find(above.begin(), above.end(), common) == above.end())
      common = parent[static_cast<size_t>(common)];
    bodies_[k] = {{a, b, common}};
    for (size_t i = 0; i < articulation::kPushed; ++i) {
      const int32_t of = bodies_[k].of[i];
      if (of >= 0) pushed[3 * k + i] = link_of[static_cast<size_t>(of)];
    }
  }
  IndexRows lists;
  lists.build(trees, static_cast<int32_t>(articulations_.count()));
  first_ = DeviceArray<int32_t>::from_host(lists.begins(), m.device());
  order_ = DeviceArray<int32_t>::from_host(lists.all(), m.device());
  pushed_ = DeviceArray<int32_t>::from_host(pushed, m.device());
  workspace_ = DeviceArray<float>(static_cast<size_t>(count() * stride<float>()), m.device());
  adjoint_memory_ = DeviceArray<float>(13 * bodies, m.device());
}

void BodyActuators::forces(const Model& m, const SimState& state, const Number& number,
                           std::vector<float>& all) const {
  const UntrackedScope untracked;
  SimState placed = m.state();
  eval_fk(m, state.joint_q, state.joint_qd, placed);
  const OnHost<Transformf> body_q(placed.body_q), frame(m.actuator_frame),
      reference(m.actuator_reference);
  const OnHost<SpatialVectorf> body_qd(placed.body_qd);
  const OnHost<Vec3f> com(m.body_com);
  const OnHost<int32_t> axes(m.actuator_axes), activation(m.actuator_state);
  for (size_t k = 0; k < dofs_.size(); ++k) {
    if (dofs_[k] < 0) continue;
    articulation::PushedBody bodies[articulation::kPushed];
    for (size_t i = 0; i < articulation::kPushed; ++i) {
      const auto b = static_cast<size_t>(bodies_[k].of[i]);
      if (bodies_[k].of[i] < 0) continue;
      const Transformf& x = body_q[b];
      const SpatialVectorf& v = body_qd[b];
      bodies[i] = articulation::pushed_body<float>({x.p, x.q}, v, com[b]);
    }
    const auto actuator = static_cast<int32_t>(k);
    all[k] = articulation::push_bodies(
                 bodies, frame[k], reference[k], axes[k], actuator,
                 articulation::actuator_input(actuator, activation[k], number), number,
                 [](int32_t, const SpatialVector<articulation::DualFloat>&) {})
                 .value;
  }
}

// The object is never destroyed, because recordings refer to the kernels.
const BodyActuationKernels& body_actuation_kernels() {
  static const auto& kernels =
      *new BodyActuationKernels{{body_actuation, detail::body_actuation_kernels_source},
                                {body_actuation_vjp, detail::body_actuation_kernels_source},
                                {body_actuation_jvp, detail::body_actuation_kernels_source}};
  return kernels;
}

}  // namespace novaphy
