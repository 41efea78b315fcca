// Bodies of MJCF files and their joints.
#pragma once

#include "mjcf_context.h"

namespace novaphy::detail {

// The object to which the children of an element are added.
struct BodyPart {
  int32_t link = kWorldLink;
  Posed frame = identity_pose();  // frame of the element in the link
  std::string childclass = {};
  bool is_static = true;  // whether the element is fixed to the world
  Posed in_world = identity_pose();
  std::string prefix = {};  // prefix of names in an attached model
  std::string suffix = {};  // suffix of names in a copy
  bool with_mass = false;   // whether geoms add mass
  size_t geoms = 0;         // number of geoms so far

  // Returns the name with prefix and suffix, or an empty text if the element has no name.
  std::string name_of(const Element& e) const {
    const char* const given = e.Attribute("name");
    return given == nullptr || *given == '\0' ? std::string() : prefix + given + suffix;
  }
};

// The joints of one body. They become one joint with several degrees of freedom if that is
// equivalent, otherwise a chain of joints with massless links between them.
class BodyJoints {
 public:
  // `outer`: the object to which the body is added. `childclass`: the default class of its
  // children.
  BodyJoints(MjcfContext& context, const Element& body, const BodyPart& outer,
             std::string childclass, std::string name);
  // Adds links and joints. `pose` is the pose of the body in the outer link. Returns the link of
  // the body.
  int32_t add(const Posed& pose, bool is_mocap);
  bool moves() const { return moves_; }

 private:
  struct Found {
    const Element* element;
    Posed frame;  // frame of the enclosing element in the body
    std::string childclass;
  };
  struct BallForces {  // passive forces of a ball or free joint
    double damping = 0.0, friction = 0.0, armature = 0.0, stiffness = 0.0;
    bool operator==(const BallForces&) const = default;
  };
  struct Scalar {  // a hinge or slide
    MjcfJoint joint;
    std::string name;
    JointDofConfig dof;
    Vec3d axis, anchor;
    double ref;
    bool is_hinge;
  };
  void collect(const Element& e, const Posed& frame, const std::string& childclass);
  std::string new_name(const Element& e);
  Scalar read_scalar(const Found& found, bool is_hinge);
  void read_range(const Element& e, const std::string& childclass, double unit, bool is_ball,
                  MjcfJoint& to, JointDofConfig& dof) const;
  void add_ball(const Found& found, const std::string& type);
  static void set_forces(RobotJoint& joint, const BallForces& forces);
  void add_free(const Element& e, const std::string& name, const BallForces& forces);
  void add_group(std::span<const Scalar> group);
  // Adds a joint. Its child is the body, or a massless link if another joint follows.
  RobotJoint& add_joint(std::string name, const Element& e, JointType type, bool is_last);
  void note_joint(const std::string& name, MjcfJoint joint, int32_t dof);
  double passive(const Element& e, const char* name, const std::string& childclass,
                 bool acts) const;

  MjcfContext& context_;
  const Element& body_;
  const BodyPart& outer_;
  const std::string name_;
  std::vector<Found> found_;
  Posed pose_ = identity_pose();  // pose of the next joint in parent_
  int32_t parent_ = kWorldLink;
  size_t named_ = 0;
  bool moves_ = false, is_mocap_ = false;
};

// Reads the body with a given name below `to`, or all of <worldbody> if `body` is null. Returns
// false if the body does not exist.
bool read_attached(MjcfContext& context, const char* body, BodyPart& to);

}  // namespace novaphy::detail
