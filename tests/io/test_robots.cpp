#include <gtest/gtest.h>

#include <string>

#include "novaphy/core/error.h"
#include "novaphy/io/robot.h"

namespace novaphy {
namespace {

constexpr const char* kInertial =
    R"(<inertial><mass value="2"/><inertia ixx=".3" iyy=".3" izz=".3" ixy="0" ixz="0" iyz="0"/></inertial>)";

std::string robot(const std::string& inside) {
  const std::string link = std::string(kInertial) + "</link>";
  return R"(<robot name="r"><link name="a">)" + link + R"(<link name="b">)" + link + inside +
         "</robot>";
}
std::string hinge(const std::string& type, const std::string& inside = "") {
  return R"(<joint name="j" type=")" + type +
         R"("><parent link="a"/><child link="b"/><origin xyz="0 0 1"/>)" + inside + "</joint>";
}

// What an error says; empty: there was none.
template <class Add>
std::string message(Add&& add) {
  try {
    add();
  } catch (const Error& error) {
    return error.what();
  }
  return {};
}

TEST(Robots, AUrdfFileBecomesBodiesAndJoints) {
  ModelBuilder builder;
  const RobotImport result =
      add_urdf(builder, robot(hinge("continuous", R"(<axis xyz="0 3 0"/>)")), {.floating = true});
  EXPECT_EQ(result.links.at("b"), 1);
  EXPECT_EQ(result.joint_dofs.at("j"), 6);
  EXPECT_EQ(builder.articulation_count(), 1);
  EXPECT_EQ(builder.body_q[1].p, (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_TRUE(result.warnings.empty());
}

TEST(Robots, FixedJointsAreMerged) {
  ModelBuilder builder;
  const RobotImport result =
      add_urdf(builder, robot(hinge("fixed")), {.collapse_fixed_joints = true});
  EXPECT_EQ(builder.body_count(), 1);
  EXPECT_EQ(result.links.at("b"), 0);
  EXPECT_EQ(result.joints.at("j"), -1);
  const auto model = builder.finalize();
  EXPECT_EQ(model->body_mass.to_host()[0], 4.0f);
  // Twice the inertia, and 2 kg half a metre away on either side.
  EXPECT_FLOAT_EQ(model->body_inertia.to_host()[0].m[0][0], 0.6f + 4.0f * 0.25f);
}

TEST(Robots, HostileFilesAreRefusedAndTheBuilderStays) {
  ModelBuilder builder;
  builder.add_body({.mass = 1.0f});
  std::string deep = "<robot name=\"r\">";
  for (int k = 0; k < 200000; ++k) deep += "<a>";
  for (const auto& [text, expected] : std::initializer_list<std::pair<std::string, const char*>>{
           {deep, "expected XML"},
           {"<!DOCTYPE r [<!ENTITY a \"b\">]>" + robot(hinge("fixed")), "entities"},
           {robot(hinge("fixed") + hinge("fixed")),
            "<text>:1: <joint name=\"j\">: expected different"},
           {robot(""), "expected one root"},
           {robot(hinge("revolute")), "expected a <limit>"},
           {robot(hinge("continuous", R"(<axis xyz="nan 0 0"/>)")), "expected finite numbers"}}) {
    const std::string said = message([&] { add_urdf(builder, text); });
    EXPECT_NE(said.find(expected), std::string::npos) << said;
    EXPECT_EQ(builder.body_count(), 1);
    EXPECT_EQ(builder.joint_count(), 1);
  }
}

TEST(Robots, OverlapsAreNamedOrLeftOut) {
  const std::string ball =
      R"(<collision><geometry><sphere radius="0.1"/></geometry></collision></link>)";
  std::string text = R"(<robot name="r">)";
  for (const char* name : {"a", "b", "c"})
    text += std::string("<link name=\"") + name + "\">" + kInertial + ball;
  const auto joint = [](const char* name, const char* parent, const char* child, const char* x) {
    return std::string("<joint name=\"") + name + "\" type=\"continuous\"><parent link=\"" +
           parent + "\"/><child link=\"" + child + "\"/><origin xyz=\"" + x + " 0 0\"/></joint>";
  };
  // The third ball is 0.17 m from the first: 0.03 m deep.
  text += joint("i", "a", "b", "0.1") + joint("j", "b", "c", "0.07") + "</robot>";
  ModelBuilder builder;
  builder.add_ground_plane();
  const RobotImport result = add_urdf(builder, text);
  ASSERT_EQ(result.warnings.size(), 1u);
  EXPECT_NE(result.warnings[0].find("1 pair of shapes overlaps at the start: \"a/collision_0\" and "
                                    "\"c/collision_0\" by 0.03"),
            std::string::npos)
      << result.warnings[0];
  const size_t pairs = builder.finalize()->shape_contact_pairs.rows();
  ModelBuilder other;
  other.add_ground_plane();
  EXPECT_TRUE(add_urdf(other, text, {.filter_overlaps = true}).warnings.empty());
  EXPECT_EQ(other.finalize()->shape_contact_pairs.rows(), pairs - 1);
}

TEST(Robots, AnMjcfFileBecomesBodiesAndMotors) {
  ModelBuilder builder;
  const RobotImport result = add_mjcf(builder, R"(<mujoco>
    <default><geom density="500"/></default>
    <worldbody><body name="a"><joint name="j" range="-90 90" armature="2"/>
      <geom type="box" size="0.5 0.5 0.5"/></body></worldbody>
    <actuator><motor joint="j" gear="7" ctrlrange="-1 2"/></actuator></mujoco>)");
  ASSERT_EQ(result.actuators.size(), 1u);
  EXPECT_EQ(result.actuators[0].gear, 7.0f);
  EXPECT_EQ(result.actuators[0].upper, 2.0f);
  EXPECT_EQ(builder.joint_armature[0], 2.0f);
  EXPECT_FLOAT_EQ(builder.joint_limit_upper[0], 1.57079633f);
  EXPECT_FLOAT_EQ(builder.finalize()->body_mass.to_host()[0], 500.0f);
  const std::string said =
      message([&] { add_mjcf(builder, "<mujoco>\n<worldbody/><tendon/></mujoco>"); });
  EXPECT_NE(said.find("<text>:2: <tendon>: this element is not read"), std::string::npos) << said;
}

}  // namespace
}  // namespace novaphy
