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

// Returns the message of an error; empty without an error.
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
  // Twice the inertia, and 2 kg half a meter away on either side.
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
           {robot(hinge("screw")), "type: expected revolute"},
           {robot(hinge("continuous", R"(<axis xyz="nan 0 0"/>)")), "expected finite numbers"}}) {
    const std::string said = message([&] { add_urdf(builder, text); });
    EXPECT_NE(said.find(expected), std::string::npos) << said;
    EXPECT_EQ(builder.body_count(), 1);
    EXPECT_EQ(builder.joint_count(), 1);
  }
}

TEST(Robots, AnMjcfFileBecomesBodiesAndMotors) {
  ModelBuilder builder;
  const RobotImport result = add_mjcf(builder, R"(<mujoco>
    <default><geom density="500"/></default>
    <worldbody><body name="a"><joint name="j" range="-90 90" armature="2"/>
      <geom type="box" size="0.5 0.5 0.5"/></body></worldbody>
    <actuator><motor joint="j" gear="7" ctrlrange="-1 2"/></actuator></mujoco>)");
  ASSERT_EQ(result.actuators.size(), 1u);
  EXPECT_EQ(result.actuators.at("j_motor"), 0);
  EXPECT_EQ(builder.joint_armature[0], 2.0f);
  EXPECT_FLOAT_EQ(builder.joint_limit_upper[0], 1.57079633f);
  const auto model = builder.finalize();
  EXPECT_FLOAT_EQ(model->body_mass.to_host()[0], 500.0f);
  EXPECT_EQ(model->actuator_gear.to_host()[0], 7.0f);
  EXPECT_EQ(model->actuator_ctrl_range.to_host()[0].y, 2.0f);
  const std::string text =
      "<mujoco>\n<worldbody><geom size='1'/></worldbody><equality>\n<weld/></equality></mujoco>";
  ModelBuilder welded;
  add_mjcf(welded, text);
  const std::string said = message([&] { welded.finalize(); });
  EXPECT_NE(said.find("<text>:3: <weld>: an equality of the kind weld"), std::string::npos) << said;
  const RobotImport rest = add_mjcf(builder, text, {.unsupported = Unsupported::Warn});
  ASSERT_EQ(rest.report.left_out.size(), 1u);
  EXPECT_EQ(rest.report.left_out[0].line, 3);
  EXPECT_EQ(rest.report.read.at("geom"), 1);
  EXPECT_EQ(rest.warnings.size(), 1u);
}

}  // namespace
}  // namespace novaphy
