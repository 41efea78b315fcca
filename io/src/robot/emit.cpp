// Adds a Robot to a ModelBuilder.
#include <algorithm>
#include <deque>
#include <numeric>
#include <set>
#include <unordered_map>

#include "robot.h"

namespace novaphy::detail {
namespace {

// Calls `add`. If the builder throws an error, its message gets the line of the file as a prefix.
template <class Add>
auto at(std::string_view function, const std::string& where, Add&& add) {
  try {
    return add();
  } catch (const Error& error) {
    fail(error.kind(), function, ": ", where, ": ", error.what());
  }
}

// Returns an rgba color as the color for display, without alpha.
Vec3f shown(const Vec4f& color) {
  const auto in_range = [](float x) { return x > 0.0f ? std::min(x, 1.0f) : 0.0f; };
  return {in_range(color.x), in_range(color.y), in_range(color.z)};
}

using Children = std::vector<std::vector<int32_t>>;  // child joints of each link; last: the world's

Children children_of(const Robot& robot) {
  Children children(robot.links.size() + 1);
  for (size_t j = 0; j < robot.joints.size(); ++j) {
    const int32_t parent = robot.joints[j].parent;
    children[parent < 0 ? robot.links.size() : static_cast<size_t>(parent)].push_back(
        static_cast<int32_t>(j));
  }
  return children;
}

// Returns the joints of the tree below `root`, a joint of the world, in the requested order.
std::vector<int32_t> tree_order(const Robot& robot, const Children& children, int32_t root,
                                JointOrdering ordering) {
  std::vector<int32_t> order;
  std::deque<int32_t> waiting = {root};
  while (!waiting.empty()) {
    const int32_t joint = waiting.front();
    waiting.pop_front();
    order.push_back(joint);
    const auto child = static_cast<size_t>(robot.joints[static_cast<size_t>(joint)].child);
    const auto& next = children[child];
    if (ordering == JointOrdering::DepthFirst)
      waiting.insert(waiting.begin(), next.begin(), next.end());
    else
      waiting.insert(waiting.end(), next.begin(), next.end());
  }
  if (ordering == JointOrdering::File) std::sort(order.begin() + 1, order.end());
  return order;
}

// Sets the initial coordinates of a joint: those of the file, or 0, clamped to the limits.
void start_within_limits(RobotJoint& joint) {
  if (!has_axes(joint.type)) return;
  joint.start.resize(joint.linear.size() + joint.angular.size(), 0.0);
  const auto within = [](double q, const JointDofConfig& dof) {
    const double lower = dof.limit_lower, upper = dof.limit_upper;
    return lower <= upper ? std::clamp(q, lower, upper) : q;  // the builder refuses reversed limits
  };
  size_t k = 0;
  for (const auto* axes : {&joint.linear, &joint.angular})
    for (const JointDofConfig& dof : *axes) {
      joint.start[k] = within(joint.start[k], dof);
      ++k;
    }
}

class Emitter {
 public:
  Emitter(const ModelBuilder& builder, Robot robot, const EmitOptions& options)
      : builder_(builder), robot_(std::move(robot)), options_(options) {}

  RobotImport run(ModelBuilder& target) {
    for (RobotJoint& joint : robot_.joints) start_within_limits(joint);
    start_mimics();
    const size_t old_links = robot_.links.size();
    shapes_of_.resize(old_links + 1);
    for (size_t k = 0; k < old_links; ++k)
      for (RobotShape& shape : robot_.links[k].shapes) shape.link = static_cast<int32_t>(k);
    find_parts();
    std::vector<std::string> link_names, joint_names;
    for (const RobotLink& link : robot_.links) link_names.push_back(link.name);
    for (const RobotJoint& joint : robot_.joints) joint_names.push_back(joint.name);
    std::vector<std::pair<int32_t, Posed>> place;
    std::vector<int32_t> joints(robot_.joints.size());
    std::iota(joints.begin(), joints.end(), 0);
    for (size_t k = 0; k < old_links; ++k)
      place.emplace_back(static_cast<int32_t>(k), identity_pose());
    check_links(robot_, options_.links_to_keep, options_.function);
    if (options_.collapse) place = collapse_links(robot_, options_.links_to_keep, joints);

    for (const auto& [a, b] : robot_.pairs) in_pairs_.insert({a, b});
    order();
    add_links();
    add_joints();
    add_mimics();
    filter();

    for (size_t k = 0; k < old_links; ++k) {
      result_.links[link_names[k]] = body_[static_cast<size_t>(place[k].first)];
      result_.link_poses[link_names[k]] = to_float(place[k].second);
    }
    for (size_t k = 0; k < joints.size(); ++k) {
      const auto of = [&](const std::vector<int32_t>& values) {
        return joints[k] < 0 ? -1 : values[static_cast<size_t>(joints[k])];
      };
      result_.joints[joint_names[k]] = of(joint_);
      result_.joint_dofs[joint_names[k]] = of(dof_);
      result_.joint_coords[joint_names[k]] = of(coord_);
    }
    target = std::move(builder_);
    return std::move(result_);
  }

 private:
  void order() {
    const Children children = children_of(robot_);
    for (const int32_t root : children.back())
      trees_.push_back(tree_order(robot_, children, root, options_.ordering));
  }

  // Returns the frame in which the roots are placed: that of the world or of the parent body.
  Posed base() const {
    if (options_.parent_body < 0) return options_.xform;
    return math::multiply(to_double(builder_.body_q[static_cast<size_t>(options_.parent_body)]),
                          options_.xform);
  }

  void add_links() {
    const size_t count = robot_.links.size();
    std::vector<Posed> pose(count);
    std::vector<int32_t> links;
    for (const auto& tree : trees_) {
      // Parents come first, whatever the order of the joints in the model is.
      std::vector<int32_t> sorted = tree;
      if (options_.ordering == JointOrdering::File)
        sorted = tree_order(robot_, children_of(robot_), tree.front(), JointOrdering::DepthFirst);
      for (const int32_t j : sorted) {
        const RobotJoint& joint = robot_.joints[static_cast<size_t>(j)];
        const Posed parent = joint.parent < 0 ? base() : pose[static_cast<size_t>(joint.parent)];
        pose[static_cast<size_t>(joint.child)] = math::multiply(
            math::multiply(math::multiply(parent, joint.parent_pose), start_pose(joint)),
            math::inverse(joint.child_pose));
      }
      for (const int32_t j : tree) links.push_back(robot_.joints[static_cast<size_t>(j)].child);
    }
    if (!options_.bodies_follow) std::sort(links.begin(), links.end());
    body_.assign(count, -1);
    for (const int32_t index : links) {
      const RobotLink& link = robot_.links[static_cast<size_t>(index)];
      BodyArgs args{.xform = to_float(pose[static_cast<size_t>(index)]),
                    .com = to_float(link.com),
                    .mass = static_cast<float>(link.mass),
                    .label = link.name};
      Mat33f inertia;
      for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) inertia.m[i][k] = static_cast<float>(link.inertia.m[i][k]);
      if (inertia != Mat33f{}) args.inertia = inertia;
      args.is_kinematic = link.is_kinematic;
      args.gravcomp = static_cast<float>(link.gravcomp);
      if (link.axes) args.fluid_frame = to_float(Posed{{}, *link.axes}).q;
      body_[static_cast<size_t>(index)] =
          at(options_.function, link.where, [&] { return builder_.add_link(args); });
    }
    for (const int32_t index : links)
      add_shapes(index, robot_.links[static_cast<size_t>(index)].shapes);
    add_shapes(kWorldLink, robot_.world_shapes);
  }

  void add_shapes(int32_t link, const std::vector<RobotShape>& shapes) {
    const int32_t body = link < 0 ? -1 : body_[static_cast<size_t>(link)];
    for (const RobotShape& shape : shapes) {
      const Posed pose = link < 0 ? math::multiply(options_.xform, shape.pose) : shape.pose;
      ShapeConfig cfg = shape.cfg;
      if (shape.color) cfg.color = shown(*shape.color);
      const bool is_paired = in_pairs_.contains(shape.label);
      if (is_paired) cfg.has_shape_collision = true;
      const int32_t index = at(options_.function, shape.where, [&] {
        if (shape.type != GeoType::MESH)
          return builder_.add_shape({.body = body,
                                     .type = shape.type,
                                     .xform = to_float(pose),
                                     .scale = to_float(shape.scale),
                                     .cfg = cfg,
                                     .label = shape.label});
        const Mesh& surface = *shape.surface;
        if (shape.hull_vertices && options_.pairs_of_mujoco && cfg.is_visible) {
          show_mesh(body, pose, shape, cfg);
          cfg.is_visible = false;
        }
        if (shape.hull_vertices)
          return builder_.add_shape_convex_hull(body, {.xform = to_float(pose),
                                                       .vertices = surface.vertices,
                                                       .scale = to_float(shape.scale),
                                                       .max_vertices = *shape.hull_vertices,
                                                       .cfg = cfg,
                                                       .label = shape.label});
        return builder_.add_shape_mesh(body, {.xform = to_float(pose),
                                              .vertices = surface.vertices,
                                              .indices = surface.indices,
                                              .scale = to_float(shape.scale),
                                              .cfg = cfg,
                                              .label = shape.label});
      });
      result_.shapes.push_back(index);
      if (shape.color) result_.shape_colors[index] = *shape.color;
      shapes_of_[row_of(shape.link)].emplace_back(index, &shape);
      if (is_paired) named_shapes_[shape.label] = index;
    }
  }

  // Adds the visible surface of a mesh of which only the convex hull collides.
  void show_mesh(int32_t body, const Posed& pose, const RobotShape& shape, ShapeConfig cfg) {
    cfg.has_shape_collision = cfg.has_particle_collision = false;
    cfg.density = 0.0f;
    const int32_t index = builder_.add_shape_mesh(body, {.xform = to_float(pose),
                                                         .vertices = shape.surface->vertices,
                                                         .indices = shape.surface->indices,
                                                         .scale = to_float(shape.scale),
                                                         .cfg = cfg,
                                                         .label = shape.label + "/mesh"});
    result_.shapes.push_back(index);
    if (shape.color) result_.shape_colors[index] = *shape.color;
  }

  void add_joints() {
    joint_.assign(robot_.joints.size(), -1);
    dof_ = coord_ = joint_;
    for (const auto& tree : trees_) {
      std::vector<int32_t> added;
      for (const int32_t j : tree) added.push_back(add_joint(j));
      if (options_.parent_body >= 0) continue;
      const RobotJoint& root = robot_.joints[static_cast<size_t>(tree.front())];
      const std::string& label = trees_.size() == 1 && !robot_.name.empty()
                                     ? robot_.name
                                     : robot_.links[static_cast<size_t>(root.child)].name;
      result_.articulations.push_back(at(options_.function, root.where,
                                         [&] { return builder_.add_articulation(added, label); }));
    }
  }

  // Returns the joint that `joint` mimics (its leader), or null.
  const RobotJoint* leader_of(const RobotJoint& joint) const {
    const auto found = std::find_if(robot_.joints.begin(), robot_.joints.end(),
                                    [&](const RobotJoint& j) { return j.name == joint.leader; });
    return joint.leader.empty() || found == robot_.joints.end() ? nullptr : &*found;
  }

  // Sets the initial coordinates of mimic joints from their leaders.
  void start_mimics() {
    for (RobotJoint& joint : robot_.joints) {
      double offset = 0.0, ratio = 1.0;
      const RobotJoint* end = &joint;
      // a loop that is too long means a cycle, which is refused later
      for (size_t steps = 0; steps <= robot_.joints.size(); ++steps) {
        const RobotJoint* const next = leader_of(*end);
        if (next == nullptr) break;
        offset += ratio * end->coef0;
        ratio *= end->coef1;
        end = next;
      }
      if (end == &joint || joint.start.size() != 1 || end->start.size() != 1) continue;
      joint.start[0] = offset + ratio * end->start[0];
    }
  }

  // Adds the mimic constraints. The velocity limit of a mimic joint becomes a limit of its leader.
  void add_mimics() {
    for (size_t j = 0; j < robot_.joints.size(); ++j) {
      const RobotJoint& joint = robot_.joints[j];
      const RobotJoint* const leader = leader_of(joint);
      if (leader == nullptr) continue;
      const auto l = static_cast<size_t>(leader - robot_.joints.data());
      at(options_.function, joint.where, [&] {
        builder_.add_constraint_mimic(joint_[j], joint_[l], static_cast<float>(joint.coef0),
                                      static_cast<float>(joint.coef1));
      });
    }
    for (size_t j = 0; j < robot_.joints.size(); ++j) {
      double ratio = 1.0;
      const RobotJoint* end = &robot_.joints[j];
      for (const RobotJoint* next; (next = leader_of(*end)) != nullptr; end = next)
        ratio *= end->coef1;
      const auto l = static_cast<size_t>(end - robot_.joints.data());
      if (l == j || ratio == 0.0) continue;
      std::vector<float>& limits = builder_.joint_velocity_limit;
      float& limit = limits[static_cast<size_t>(dof_[l])];
      limit = std::min(limit,
                       limits[static_cast<size_t>(dof_[j])] / static_cast<float>(std::abs(ratio)));
    }
  }

  int32_t add_joint(int32_t j) {
    const RobotJoint& joint = robot_.joints[static_cast<size_t>(j)];
    JointArgs args{.parent_xform = to_float(joint.parent_pose),
                   .child_xform = to_float(joint.child_pose),
                   .linear_axes = joint.linear,
                   .angular_axes = joint.angular,
                   .collision_filter_parent = !options_.pairs_of_mujoco && !joint.meets_parent,
                   .label = joint.name};
    int32_t parent =
        joint.parent < 0 ? options_.parent_body : body_[static_cast<size_t>(joint.parent)];
    if (joint.parent < 0) {
      args.parent_xform = to_float(math::multiply(options_.xform, joint.parent_pose));
      if (joint.type == JointType::FREE)  // coordinates are the pose of the link
        args.parent_xform = args.child_xform = Transformf::identity();
    }
    dof_[static_cast<size_t>(j)] = builder_.joint_dof_count();
    coord_[static_cast<size_t>(j)] = builder_.joint_coord_count();
    const int32_t index = at(options_.function, joint.where, [&] {
      return builder_.add_joint(joint.type, parent, body_[static_cast<size_t>(joint.child)], args);
    });
    joint_[static_cast<size_t>(j)] = index;
    const auto coords = static_cast<size_t>(joint.coordinates());
    for (size_t k = 0; k < joint.start.size() && k < coords; ++k)
      builder_.joint_q[builder_.joint_q.size() - coords + k] = static_cast<float>(joint.start[k]);
    set_ball(joint, builder_);
    return index;
  }

  // Returns the row of a link of the file, or the last row for the world.
  size_t row_of(int32_t link) const {
    return link < 0 ? shapes_of_.size() - 1 : static_cast<size_t>(link);
  }

  // Groups links that fixed joints connect into parts, which move as one body. Finds pairs of parts
  // that joints connect, and joints whose parent part is the world.
  void find_parts() {
    const size_t world = row_of(kWorldLink);
    part_.resize(world + 1);
    std::iota(part_.begin(), part_.end(), size_t{0});
    const auto part_of = [&](int32_t link) { return part_[row_of(link)]; };
    const auto is_one_part = [&](const RobotJoint& joint) {
      if (joint.parent >= 0 && robot_.links[static_cast<size_t>(joint.parent)].is_between)
        return true;
      return !can_move(joint.type) && (joint.parent >= 0 || options_.pairs_of_mujoco);
    };
    for (const RobotJoint& joint : robot_.joints)
      if (is_one_part(joint)) {
        // The world keeps the largest number, whatever the order of the joints is.
        const size_t to = part_of(joint.parent), from = part_of(joint.child);
        std::replace(part_.begin(), part_.end(), std::min(to, from), std::max(to, from));
      }
    for (size_t k = 0; k < robot_.links.size(); ++k)
      if (robot_.links[k].is_kinematic) kinematic_.push_back(part_[k]);
    for (RobotJoint& joint : robot_.joints) {
      joint.meets_parent = joint.parent >= 0 && part_of(joint.parent) == world;
      if (part_of(joint.parent) != world && options_.filter_parent)
        neighbors_.insert(std::minmax(part_of(joint.parent), part_of(joint.child)));
    }
  }

  void filter_links(size_t a, size_t b) {
    for (const auto& [i, unused_i] : shapes_of_[a])
      for (const auto& [k, unused_k] : shapes_of_[b])
        if (i != k) filter_shapes(i, k);
  }
  void filter_shapes(int32_t a, int32_t b) {
    if (!kept_.contains(std::minmax(a, b))) builder_.add_shape_collision_filter_pair(a, b);
  }

  // Adds collision filters: links of a part do not collide with each other or neighboring parts.
  void filter() {
    for (const auto& [a, b] : robot_.pairs)
      if (named_shapes_.contains(a) && named_shapes_.contains(b))
        kept_.insert(std::minmax(named_shapes_.at(a), named_shapes_.at(b)));
    std::vector<std::vector<size_t>> members(part_.size());
    for (size_t k = 0; k < part_.size(); ++k) members[part_[k]].push_back(k);
    const auto meet = [&](size_t a, size_t b) {
      for (const size_t i : members[a])
        for (const size_t k : members[b]) filter_links(i, k);
    };
    for (size_t a = 0; a < members.size(); ++a)
      if (members[a].size() > 1) meet(a, a);
    for (const auto& [a, b] : neighbors_)
      if (a != b) meet(a, b);
    // Kinematic parts never collide with each other, and in MJCF not with the world.
    for (size_t k = 0; k < kinematic_.size(); ++k) {
      if (options_.pairs_of_mujoco) meet(kinematic_[k], row_of(kWorldLink));
      for (size_t l = 0; l < k; ++l) meet(kinematic_[l], kinematic_[k]);
    }
    for (const auto& [a, b] : robot_.excluded) filter_links(row_of(a), row_of(b));
    if (!options_.self_collisions)
      for (size_t a = 0; a + 1 < shapes_of_.size(); ++a)
        for (size_t b = a; b + 1 < shapes_of_.size(); ++b) filter_links(a, b);
    if (options_.pairs_of_mujoco) filter_by_bits();
  }

  void filter_by_bits() {
    std::vector<std::pair<int32_t, const RobotShape*>> all;
    for (const auto& shapes : shapes_of_)
      for (const auto& shape : shapes)
        if (shape.second->cfg.has_shape_collision || in_pairs_.contains(shape.second->label))
          all.push_back(shape);
    for (size_t a = 0; a < all.size(); ++a)
      for (size_t b = a + 1; b < all.size(); ++b) {
        const RobotShape &x = *all[a].second, &y = *all[b].second;
        if ((x.contype & y.conaffinity) == 0 && (y.contype & x.conaffinity) == 0)
          filter_shapes(all[a].first, all[b].first);
      }
  }

  ModelBuilder builder_;  // a copy of the builder, which replaces it when no error is possible
  Robot robot_;
  const EmitOptions& options_;
  RobotImport result_;
  std::vector<std::vector<int32_t>> trees_;  // joints of each tree, in the order of the model
  std::vector<int32_t> body_, joint_;        // index of each link and joint in the builder
  std::vector<int32_t> dof_, coord_;         // first rows of each joint
  std::vector<size_t> part_;                 // part of each link, and of the world (last)
  std::set<std::pair<size_t, size_t>> neighbors_;  // pairs of parts that a joint connects
  std::vector<size_t> kinematic_;                  // kinematic parts
  // Shapes of each link of the file, and of the world (last).
  std::vector<std::vector<std::pair<int32_t, const RobotShape*>>> shapes_of_;
  std::set<std::string> in_pairs_;                         // labels of shapes in explicit pairs
  std::unordered_map<std::string, int32_t> named_shapes_;  // index of these shapes
  std::set<std::pair<int32_t, int32_t>> kept_;             // pairs of shapes that must collide
};

}  // namespace

RobotImport emit_robot(ModelBuilder& builder, Robot robot, const EmitOptions& options) {
  return Emitter(builder, std::move(robot), options).run(builder);
}

}  // namespace novaphy::detail
