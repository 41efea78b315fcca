#include "novaphy/dynamics/featherstone/articulations.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <iomanip>
#include <numeric>
#include <sstream>

#include "articulation_kernels.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/joint_args.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/dynamics/articulation/active_rows.h"
#include "novaphy/dynamics/articulation/joint_links.h"

namespace novaphy {
namespace {

using articulation::Link;
using articulation::LinkJoint;

static_assert(sizeof(Link) == 11 * sizeof(int32_t) && sizeof(ArticulationRows) == 8 * 4);

std::string joint_name(const Model& m, int64_t joint) {
  return "joint " + std::to_string(joint) + " ('" + m.joint_label[static_cast<size_t>(joint)] +
         "')";
}

// Throws if a joint is disabled. Trees have no coordinates for a disabled joint.
void check_enabled(const Model& m, int64_t joint, bool enabled, const char* user) {
  if (enabled) return;
  fail(ErrorKind::NotImplemented, user, ": model.joint_enabled[", joint, "], of ",
       joint_name(m, joint),
       ": joints that are not enabled are not supported: give the child a FREE joint in another "
       "model, "
       "or use SolverSemiImplicit");
}

// Throws for a joint outside of the articulations: a forgotten joint, or one that closes a loop.
void check_in_articulation(const Model& m, int32_t joint, const char* user) {
  const int32_t* const articulation = m.joint_articulation.data();
  if (articulation[joint] >= 0) return;
  const int32_t* const child = m.joint_child.data();
  bool closes_loop = false;
  for (int32_t j = 0; j < m.joint_count(); ++j)
    closes_loop = closes_loop || (j != joint && child[j] == child[joint]);
  fail(ErrorKind::NotImplemented, user, ": model: ", joint_name(m, joint),
       " belongs to no articulation: ",
       closes_loop
           ? "its child has another joint, and loops are not supported: leave one of them out, "
             "or use SolverSemiImplicit"
           : "name it in add_articulation");
}

// Builds the links of one articulation, joint by joint.
class TreeMaker {
 public:
  TreeMaker(const Model& model, const char* user, bool has_kinematic)
      : model_(model), user_(user), has_kinematic_(has_kinematic) {
    const auto bodies = static_cast<size_t>(model.body_count());
    link_of_body_.assign(bodies, -1);
  }

  void begin() { first_ = static_cast<int32_t>(links.size()); }
  // Returns the number of mimic joints in the articulation under construction.
  int32_t mimics() const {
    return static_cast<int32_t>(
        std::count_if(links.begin() + first_, links.end(), articulation::follows));
  }
  // Returns the largest number of moving joints on a path from the root to a leaf.
  int32_t joints_in_a_row() const {
    std::vector<int32_t> above(links.size() - static_cast<size_t>(first_), 0);
    int32_t most = 0;
    bool has_cones = false;
    for (size_t i = 0; i < above.size(); ++i) {
      const Link& link = links[static_cast<size_t>(first_) + i];
      above[i] =
          (link.parent < 0 ? 0 : above[static_cast<size_t>(link.parent)]) + (link.dofs > 0 ? 1 : 0);
      most = std::max(most, above[i]);
      has_cones = has_cones || (articulation::is_ball(link) &&
                                model_.joint_limit_upper.data()[link.dof] < kJointUnlimited);
    }
    // limits of BALL joints need a mass matrix (factor.h)
    return has_cones ? std::min(most, articulation::kMatrixJoints) : most;
  }
  int32_t link_count() const { return static_cast<int32_t>(links.size()) - first_; }

  void add(int32_t joint) {
    const auto type = static_cast<JointType>(model_.joint_type.data()[joint]);
    const int32_t parent_body = model_.joint_parent.data()[joint];
    const int32_t child = model_.joint_child.data()[joint];
    if (type == JointType::DISTANCE)
      fail(ErrorKind::NotImplemented, user_, ": model: ", joint_name(model_, joint),
           ": DISTANCE joints are not supported: SolverSemiImplicit holds the distance by springs");
    if (type == JointType::ROD)
      fail(ErrorKind::NotImplemented, user_, ": model: ", joint_name(model_, joint),
           ": ROD joints are not supported: use SolverVBD");
    const bool kinematic = has_flag(model_.body_flags.data()[child], BodyFlags::KINEMATIC);
    if (kinematic) check_kinematic(child, type, parent_body);
    int32_t parent = parent_body < 0 ? -1 : link_of_body_[static_cast<size_t>(parent_body)];
    const int32_t dof = model_.joint_qd_start.data()[joint];
    const articulation::JointRows rows = {type,
                                          joint,
                                          child,
                                          model_.joint_q_start.data()[joint],
                                          dof,
                                          model_.joint_qd_start.data()[joint + 1] - dof,
                                          model_.joint_dof_dim.data()[joint].x};
    for (int32_t k = 0; k < articulation::link_count(rows); ++k) {
      links.push_back(articulation::joint_link(rows, k, parent));
      NOVAPHY_ASSERT(parent >= -1 && parent < link_count() - 1);  // parents precede children
      if (kinematic && type == JointType::FREE) links.back().joint = LinkJoint::Kinematic;
      parent = link_count() - 1;
    }
    link_of_body_[static_cast<size_t>(child)] = parent;
  }

  // Checks for bodies without a joint. Call this after all joints.
  void check_bodies() const {
    for (size_t b = 0; b < link_of_body_.size(); ++b)
      require(link_of_body_[b] >= 0, ErrorKind::NotImplemented, user_, ": model: body ", b, " ('",
              model_.body_label[b], "') has no joint: add_body gives it a FREE one");
  }

  // Sets the leader of a mimic joint's link. Leaders may be mimic joints too, so the leader is the
  // joint at the end of that chain.
  void follow(int32_t joint) {
    const int32_t* const leaders = model_.joint_mimic.data();
    if (leaders[joint] < 0) return;
    const Vec2f* const coefs = model_.joint_mimic_coef.data();
    const auto link_of = [&](int32_t j) {
      return link_of_body_[static_cast<size_t>(model_.joint_child.data()[j])];
    };
    int32_t leader = joint;
    float offset = 0.0f, multiplier = 1.0f;
    for (; leaders[leader] >= 0; leader = leaders[leader]) {
      offset += multiplier * coefs[leader].x;
      multiplier *= coefs[leader].y;
    }
    Link& link = links[static_cast<size_t>(first_ + link_of(joint))];
    link.leader = link_of(leader);
    NOVAPHY_ASSERT(link.leader >= 0 && link.leader < link_count());
    link.multiplier = multiplier;
    link.offset = offset;
  }

  // Ends an articulation: finds the parent of each degree of freedom, counted from the first one.
  void end(int32_t first_dof) {
    for (size_t i = static_cast<size_t>(first_); i < links.size(); ++i) {
      int32_t above = -1;
      for (int32_t p = links[i].parent; p >= 0 && above < 0;) {
        const Link& link = links[static_cast<size_t>(first_ + p)];
        if (link.dofs > 0) above = link.dof - first_dof + link.dofs - 1;
        p = link.parent;
      }
      NOVAPHY_ASSERT(links[i].dofs == 0 ||
                     // in ascending order
                     links[i].dof == static_cast<int32_t>(dof_parent.size()));
      for (int32_t k = 0; k < links[i].dofs; ++k) {
        dof_parent.push_back(k == 0 ? above : links[i].dof - first_dof + k - 1);
        joint_of_dof.push_back(links[i].joint);
      }
    }
  }

  std::vector<Link> links;
  std::vector<int32_t> dof_parent;
  std::vector<LinkJoint> joint_of_dof;

 private:
  void check_kinematic(int32_t body, JointType type, int32_t parent) const {
    const std::string name = "body " + std::to_string(body) + " ('" +
                             model_.body_label[static_cast<size_t>(body)] + "')";
    require(has_kinematic_, ErrorKind::NotImplemented, user_, ": model: ", name,
            ": kinematic bodies are not supported");
    require(parent < 0 && (type == JointType::FREE || type == JointType::FIXED),
            ErrorKind::NotImplemented, user_, ": model: ", name,
            ": expected a kinematic body to have a joint FREE or FIXED to the world, got ",
            joint_type_name(type), parent < 0 ? "" : " to another body",
            "; motions of other joints are prescribed by a stiff drive (target_ke, target_kd)");
  }

  const Model& model_;
  const char* user_;
  bool has_kinematic_;
  std::vector<int32_t> link_of_body_;
  int32_t first_ = 0;
};

// Returns the condition number of T^T M T (the mass matrix reduced by mimic joints): its largest
// eigenvalue over its smallest, by power iteration with the matrix and its inverse.
double matrix_condition(const articulation::Tree<float>& tree, const float* q,
                        const float* armature) {
  const int64_t n = tree.dof_count, width = n + 1;
  std::vector<uint64_t> memory(static_cast<size_t>(
      articulation::workspace_bytes<float>(tree.link_count, tree.dof_count) / 8 + 1));
  articulation::Workspace<float> ws =
      articulation::make_workspace<float>(memory.data(), tree.link_count, tree.dof_count);
  articulation::kinematics(tree, q, ws);
  articulation::mass_matrix(tree, ws);
  for (int64_t k = 0; k < n; ++k) ws.matrix[k * n + k] += armature[k];
  articulation::reduce_matrix(tree, ws.matrix);
  std::vector<double> system(static_cast<size_t>(n * width));
  double sizes[2];  // largest eigenvalue of the matrix, then of its inverse
  for (int inverse = 0; inverse < 2; ++inverse) {
    std::vector<double> x(static_cast<size_t>(n), 1.0);
    articulation::for_mimics(tree,
                             [&](int32_t f, int32_t, float) { x[static_cast<size_t>(f)] = 0.0; });
    for (int turn = 0; turn < 20; ++turn) {
      const double length = std::sqrt(std::inner_product(x.begin(), x.end(), x.begin(), 0.0));
      for (int64_t i = 0; i < n; ++i) {
        double* const to = system.data() + i * width;
        for (int64_t j = 0; j < n; ++j) to[j] = ws.matrix[i > j ? i * n + j : j * n + i];
        to[n] = x[static_cast<size_t>(i)] / length;
      }
      if (inverse != 0) articulation::solve_dense(system.data(), n);
      sizes[inverse] = 0.0;
      for (int64_t i = 0; i < n; ++i) {
        const double* const from = system.data() + i * width;
        double& to = x[static_cast<size_t>(i)] = from[n];
        if (inverse == 0) {
          to = 0.0;
          for (int64_t j = 0; j < n; ++j)
            to += from[j] * system[static_cast<size_t>(j * width + n)];
        }
        sizes[inverse] += to * to;
      }
    }
  }
  return std::sqrt(sizes[0] * sizes[1]);
}

}  // namespace

Articulations::Articulations(const Model& model, const char* user, For purpose) : values_(user) {
  model.check_structure(user);
  const Device device = model.device();
  const std::shared_ptr<const Model> host = model.on_host();
  const Model& m = *host;
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    check_in_articulation(m, j, user);
    if (purpose == For::Steps) check_enabled(m, j, m.joint_enabled.data()[j] != 0, user);
  }
  for (int32_t b = 0; b < m.body_count(); ++b)
    kinematic_.push_back(has_flag(m.body_flags.data()[b], BodyFlags::KINEMATIC) ? 1 : 0);
  TreeMaker trees(m, user, purpose == For::Steps);
  std::vector<int32_t> rows;
  for (int32_t i = 0; i < m.articulation_count(); ++i) {
    const int32_t start = m.articulation_start.data()[i], end = m.articulation_end.data()[i];
    const int32_t first_dof = m.joint_qd_start.data()[start];
    const int32_t dofs = m.joint_qd_start.data()[end] - first_dof;
    trees.begin();
    const auto first_link = static_cast<int32_t>(trees.links.size());
    for (int32_t j = start; j < end; ++j) trees.add(j);
    for (int32_t j = start; j < end; ++j) trees.follow(j);
    trees.end(first_dof);
    const int32_t world = m.joint_world.data()[start];
    const bool moves = std::any_of(
        trees.links.begin() + first_link, trees.links.end(),
        [](const Link& link) { return link.dofs > 0 && !articulation::is_kinematic(link); });
    const int32_t in_a_row = trees.joints_in_a_row();
    for (const int32_t value :
         {first_link, trees.link_count(), first_dof, dofs, world < 0 ? m.world_count() - 1 : world,
          moves ? 1 : 0, trees.mimics(), in_a_row})
      rows.push_back(value);
    in_long_tree_.insert(in_long_tree_.end(), static_cast<size_t>(dofs),
                         in_a_row > articulation::kMatrixJoints ? 1 : 0);
    max_links_ = std::max(max_links_, trees.link_count());
    max_dofs_ = std::max(max_dofs_, dofs);
  }
  trees.check_bodies();
  const auto* words = reinterpret_cast<const int32_t*>(trees.links.data());
  rows_ = DeviceArray<int32_t>::from_host(rows, device, 8);
  links_ = DeviceArray<int32_t>::from_host({words, 11 * trees.links.size()}, device, 11);
  dof_parent_ = DeviceArray<int32_t>::from_host(trees.dof_parent, device);
  joint_of_dof_ = std::move(trees.joint_of_dof);
}

articulation::Tree<float> Articulations::tree(const Model& m, int64_t i) const {
  const auto& rows = reinterpret_cast<const ArticulationRows*>(rows_.data())[i];
  return {rows.link_count,
          rows.dof_count,
          reinterpret_cast<const Link*>(links_.data()) + rows.first_link,
          dof_parent_.data() + rows.first_dof,
          rows.first_dof,
          m.joint_X_p.data(),
          m.joint_X_c.data(),
          m.joint_axis.data(),
          m.body_mass.data(),
          m.body_com.data(),
          m.body_inertia.data(),
          m.gravity.data()[rows.world],
          rows.mimics,
          rows.joints_in_a_row};
}

std::string Articulations::dof_name(const Model& m, int32_t dof) const {
  const OnHost<int32_t> starts(m.joint_qd_start);
  const int32_t* const start = starts.data();
  const auto joint = std::upper_bound(start, start + m.joint_count(), dof) - start - 1;
  std::string name = "dof " + std::to_string(dof) + " (joint '" +
                     m.joint_label[static_cast<size_t>(joint)] + "'";
  if (m.world_count() > 1)
    name += " of world " + std::to_string(OnHost<int32_t>(m.joint_world).data()[joint]);
  return name + ")";
}

std::string Articulations::matrix_name(const Model& m, int32_t dof, const SimState* state) const {
  const std::string name = "the mass matrix";
  if (state == nullptr || !m.device().is_cpu()) return name;
  int64_t row = 0;
  articulation::Tree<float> tree = this->tree(m, row);
  while (dof >= tree.first_dof + tree.dof_count) tree = this->tree(m, ++row);
  if (tree.mimics == 0) return name;
  const double condition =
      matrix_condition(tree, state->joint_q.data(), m.joint_armature.data() + tree.first_dof);
  if (!(condition > 1e5)) return name;
  std::ostringstream text;
  text << name << ", whose condition is " << std::setprecision(1) << std::scientific << condition
       << " (mimic joints need it; float32 holds 1e7),";
  return text.str();
}

void Articulations::check_drives(const Model& m, const char* user) const {
  const OnHost<float> ke(m.joint_target_ke), kd(m.joint_target_kd), damping(m.joint_damping),
      effort(m.joint_effort_limit), lower(m.joint_limit_lower), upper(m.joint_limit_upper);
  const auto refuse = [&](size_t k, const char* array, const char* why, float got) {
    const char* const type = joint_of_dof_[k] == LinkJoint::Ball ? "BALL" : "FREE";
    fail(ErrorKind::NotImplemented, user, ": model.", array, "[", k,
         "]: ", dof_name(m, static_cast<int32_t>(k)), " is of a ", type, " joint, ", why, "; got ",
         got);
  };
  int32_t of_joint = 0;  // earlier degrees of freedom of the same BALL joint
  for (size_t k = 0; k < joint_of_dof_.size(); ++k) {
    const LinkJoint joint = joint_of_dof_[k];
    if (joint == LinkJoint::Prismatic || joint == LinkJoint::Revolute) continue;
    const bool ball = joint == LinkJoint::Ball;
    of_joint = k > 0 && joint_of_dof_[k - 1] == joint ? (of_joint + 1) % 3 : 0;
    if (!ball && ke[k] != 0.0f) refuse(k, "joint_target_ke", "which has none", ke[k]);
    if (!ball && kd[k] != 0.0f) refuse(k, "joint_target_kd", "which has none", kd[k]);
    if (!ball && damping[k] != 0.0f) refuse(k, "joint_damping", "which has none", damping[k]);
    if (ball && (ke[k] != 0.0f || kd[k] != 0.0f) && effort[k] < JointDofConfig{}.effort_limit)
      refuse(k, "joint_effort_limit", "whose drives have no effort limit", effort[k]);
    if (lower[k] > -kJointUnlimited)
      refuse(k, "joint_limit_lower", "which has no lower limit", lower[k]);
    if (upper[k] >= kJointUnlimited) continue;
    if (!ball) refuse(k, "joint_limit_upper", "which has no limits", upper[k]);
    if (of_joint != 0)
      refuse(k, "joint_limit_upper", "whose limit is that of its first dof", upper[k]);
    if (upper[k] <= 0.0f)
      refuse(k, "joint_limit_upper", "whose limit is an angle above 0", upper[k]);
    if (in_long_tree_[k] != 0)
      refuse(k, "joint_limit_upper",
             "whose tree has more than nine joints in a row and had no such limit when the solver "
             "was made: make another",
             upper[k]);
  }
}

void Articulations::check_values(const Model& m, const Control* control, bool friction,
                                 const char* user) {
  const DeviceArray<float>& joint_act = control ? control->joint_act : m.joint_act;
  const Array* const arrays[] = {&m.joint_enabled,     &m.joint_friction,    &joint_act,
                                 &m.joint_target_ke,   &m.joint_target_kd,   &m.joint_damping,
                                 &m.joint_limit_lower, &m.joint_limit_upper, &m.body_flags,
                                 &m.joint_effort_limit};
  values_.check_joints(m);
  checked_.resize(std::size(arrays));
  bool same = true;
  for (size_t i = 0; i < std::size(arrays); ++i) same = same && checked_[i].matches(*arrays[i]);
  if (same) return;
  const UntrackedScope untracked;
  const OnHost<uint8_t> enabled(m.joint_enabled);
  const OnHost<float> dry(m.joint_friction), act(joint_act);
  const OnHost<int32_t> flags(m.body_flags);
  for (size_t b = 0; b < flags.size(); ++b)
    require(has_flag(flags[b], BodyFlags::KINEMATIC) == (kinematic_[b] != 0),
            ErrorKind::NotImplemented, user, ": model.body_flags[", b,
            "]: expected a body that is ", kinematic_[b] != 0 ? "" : "not ",
            "kinematic, as it was when the solver was made; call its notify_model_changed, or make "
            "another, got ",
            flags[b]);
  for (size_t j = 0; j < enabled.size(); ++j)
    check_enabled(m, static_cast<int64_t>(j), enabled[j] != 0, user);
  for (size_t k = 0; k < dry.size(); ++k) {
    require(friction || dry[k] == 0.0f, ErrorKind::NotImplemented, user, ": model.joint_friction[",
            k, "]: expected 0 (dry friction is not supported here), got ", dry[k]);
    require(act[k] == 0.0f, ErrorKind::NotImplemented, user, ": joint_act[", k,
            "]: expected 0 (there are no actuators; joint_f takes forces), got ", act[k]);
  }
  check_drives(m, user);
  for (size_t i = 0; i < std::size(arrays); ++i) checked_[i].set(*arrays[i]);
}

}  // namespace novaphy
