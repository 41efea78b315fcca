// Reads <worldbody> of MJCF files: bodies, frames, replicated copies, geoms, sites and inertials.
#include <algorithm>

#include "mjcf_attach.h"

namespace novaphy::detail {
namespace {

constexpr size_t kMostBodies = 10000;
constexpr int64_t kMostElements = 1000000;  // including copies of <replicate>

class BodiesReader {
 public:
  explicit BodiesReader(MjcfContext& context) : context_(context), file_(context.file) {}

  void run() {
    Robot& robot = context_.robot;
    const Element& top = file_.root();
    for (const Element* e = top.FirstChildElement("worldbody"); e != nullptr;
         e = e->NextSiblingElement("worldbody")) {
      const char* own = e->Attribute("childclass");
      BodyPart part{.link = kWorldLink, .childclass = own == nullptr ? "" : own};
      read_children(*e, part);
    }
    if (robot.links.empty() && robot.world_shapes.empty())
      file_.refuse(top, "expected a body or a geom in a <worldbody>, got none");
  }

  bool run_attached(const char* body, BodyPart& to) {
    bool found = body == nullptr;
    for (const Element* e = file_.root().FirstChildElement("worldbody"); e != nullptr;
         e = e->NextSiblingElement("worldbody")) {
      const char* const own = e->Attribute("childclass");
      to.childclass = own == nullptr ? "" : own;
      if (body == nullptr)
        read_children(*e, to);
      else
        found = found || find_body(*e, body, to);
    }
    return found;
  }

 private:
  // Reads the body with a given name at any depth of `e`.
  bool find_body(const Element& e, const char* name, const BodyPart& to) {
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
      const std::string_view kind = c->Name();
      if (kind != "body" && kind != "frame") continue;
      const char* const own = c->Attribute("name");
      if (kind == "body" && own != nullptr && std::string_view(own) == name) {
        read_body(*c, to);
        return true;
      }
      BodyPart inside = to;
      inside.childclass = class_in(*c, to);
      if (find_body(*c, name, inside)) return true;
    }
    return false;
  }
  void count(const Element& e) {
    if (++elements_ > kMostElements)
      file_.refuse(e, "expected at most 1000000 elements, copies of <replicate> included");
  }
  Posed pose_of(const Element& e, const std::string& childclass = {}) const {
    Posed pose = identity_pose();
    double v[3];
    if (context_.defaults.numbers(e, "pos", childclass, v)) pose.p = {v[0], v[1], v[2]};
    pose.q = context_.defaults.orientation(e, childclass, context_.settings.compiler);
    return pose;
  }
  static std::string class_in(const Element& e, const BodyPart& part) {
    const char* own = e.Attribute("childclass");
    return own == nullptr ? part.childclass : own;
  }

  void read_children(const Element& e, BodyPart& part) {
    for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement()) {
      count(*c);
      const std::string_view kind = c->Name();
      if (kind == "geom") {
        add_geom(*c, part);
      } else if (kind == "body") {
        read_body(*c, part);
      } else if (kind == "frame") {
        BodyPart inside = part;
        inside.frame = math::multiply(part.frame, pose_of(*c));
        inside.childclass = class_in(*c, part);
        read_children(*c, inside);
        part.geoms = inside.geoms;
      } else if (kind == "replicate") {
        replicate(*c, part);
      } else if (kind == "inertial" && part.link >= 0) {
        read_inertial(*c, context_.robot.links[static_cast<size_t>(part.link)]);
      } else if (kind == "site") {
        add_site(*c, part);
      } else if (kind == "camera" || kind == "light") {
        add_view(*c, part);
      } else if (kind == "attach") {
        attach(context_, *c, part);
      } else if (kind == "composite" || kind == "flexcomp" || kind == "plugin") {
        context_.notes.left_out(*c, "this element");
      } else if (!((kind == "joint" || kind == "freejoint") && part.link >= 0)) {
        context_.not_read(*c, "this element");
      }
    }
  }

  // Reads the copies of <replicate>. Each copy is moved by `offset` and rotated by `euler` in the
  // frame of the previous copy.
  void replicate(const Element& e, BodyPart& part) {
    double n[1] = {0.0}, offset[3] = {0.0, 0.0, 0.0}, angles[3] = {0.0, 0.0, 0.0};
    if (!file_.numbers(e, "count", n) || n[0] < 1.0 || n[0] > kMostElements ||
        n[0] != std::floor(n[0]))
      file_.refuse(e, "count: expected a whole number from 1 to 1000000");
    file_.numbers(e, "offset", offset);
    file_.numbers(e, "euler", angles);
    const Posed step = {{offset[0], offset[1], offset[2]},
                        euler_turn({angles[0], angles[1], angles[2]}, context_.settings.compiler)};
    const char* separator = e.Attribute("sep");
    const auto copies = static_cast<int64_t>(n[0]);
    const size_t digits = std::to_string(copies).size();
    Posed at = identity_pose();
    for (int64_t k = 0; k < copies; ++k) {
      std::string number = std::to_string(k);
      number.insert(0, digits - number.size(), '0');
      BodyPart copy = part;
      copy.frame = math::multiply(part.frame, at);
      copy.childclass = class_in(e, part);
      copy.suffix = (separator == nullptr ? "" : separator) + number + part.suffix;
      count(e);
      read_children(e, copy);
      part.geoms = copy.geoms;
      at = math::multiply(at, step);
    }
  }

  void add_geom(const Element& e, BodyPart& part) {
    Robot& robot = context_.robot;
    const std::string owner =
        part.link < 0 ? "world" : robot.links[static_cast<size_t>(part.link)].name;
    const std::string given = part.name_of(e);
    if (!given.empty() && !context_.geoms.insert(given).second)
      file_.refuse(e, "name: expected different names, got \"" + given + "\" twice");
    const std::string label = given.empty() ? owner + "/geom_" + std::to_string(part.geoms) : given;
    ++part.geoms;
    const bool with_mass = part.with_mass && part.link >= 0;
    auto geom = read_geom(context_, e, part.childclass, label, with_mass);
    if (!geom) return;
    geom->shape.pose = math::multiply(part.frame, geom->shape.pose);
    if (part.link < 0) {
      robot.world_shapes.push_back(std::move(geom->shape));
      return;
    }
    if (geom->shape.type == GeoType::PLANE && part.is_static) {
      // The plane is static, so it becomes a shape of the world.
      geom->shape.pose = math::multiply(part.in_world, geom->shape.pose);
      geom->shape.link = part.link;
      robot.world_shapes.push_back(std::move(geom->shape));
      return;
    }
    RobotLink& link = robot.links[static_cast<size_t>(part.link)];
    if (with_mass) {
      const bool is_first = link.mass == 0.0 && geom->mass > 0.0;
      add_mass(link, geom->mass, math::transform_point(geom->shape.pose, geom->com),
               turned(geom->shape.pose.q, geom->inertia));
      if (is_first && geom->shape.type != GeoType::MESH) link.axes = geom->shape.pose.q;
    }
    link.shapes.push_back(std::move(geom->shape));
  }

  void add_site(const Element& e, const BodyPart& part) {
    context_.notes.read("site");
    const std::string name = part.name_of(e);
    if (name.empty()) return;
    Posed pose = pose_of(e, part.childclass);
    double v[6];
    if (context_.defaults.numbers(e, "fromto", part.childclass, v)) {
      const Vec3d from = {v[0], v[1], v[2]}, to = {v[3], v[4], v[5]}, way = from - to;
      if (!(math::dot(way, way) > 1e-18)) file_.refuse(e, "fromto: expected two different points");
      pose = {(from + to) * 0.5, turn_from_z(way)};
    }
    context_.sites[name] = {part.link, math::multiply(part.frame, pose)};
  }

  // Adds a camera or a light.
  void add_view(const Element& e, const BodyPart& part) {
    context_.notes.read(e.Name());
    const bool is_camera = std::string_view(e.Name()) == "camera";
    std::string name = part.name_of(e);
    if (name.empty())
      name = e.Name() +
             ("_" + std::to_string(is_camera ? context_.cameras.size() : context_.lights.size()));
    Posed pose = identity_pose();
    double v[3];
    const MjcfDefaults& defaults = context_.defaults;
    if (is_camera) {
      pose = pose_of(e, part.childclass);
      const double fovy = defaults.number(e, "fovy", part.childclass, 45.0);
      context_.cameras[name] = {{part.link, math::multiply(part.frame, pose)}, fovy * M_PI / 180.0};
      return;
    }
    if (defaults.numbers(e, "pos", part.childclass, v)) pose.p = {v[0], v[1], v[2]};
    Vec3d back = {0.0, 0.0, 1.0};
    if (defaults.numbers(e, "dir", part.childclass, v)) back = {-v[0], -v[1], -v[2]};
    if (!(math::dot(back, back) > 1e-12))
      file_.refuse(e, "dir: expected a vector that is not zero");
    pose.q = turn_from_z(back);
    context_.lights[name] = {part.link, math::multiply(part.frame, pose)};
  }

  void read_inertial(const Element& e, RobotLink& link) {
    if (context_.settings.compiler.inertia_from_geom == MjcfCompiler::Inertia::Always) return;
    if (link.mass != 0.0) file_.refuse(e, "expected one <inertial>, got two");
    double v[6] = {};
    if (!file_.numbers(e, "mass", std::span(v).first(1))) file_.refuse(e, "mass: missing");
    link.mass = v[0];
    if (!(link.mass >= 0.0)) file_.refuse(e, "mass: expected >= 0");
    const Posed pose = pose_of(e);
    link.com = pose.p;
    if (file_.numbers(e, "fullinertia", v)) {
      link.inertia = {{{v[0], v[3], v[4]}, {v[3], v[1], v[5]}, {v[4], v[5], v[2]}}};
    } else if (file_.numbers(e, "diaginertia", std::span(v).first(3))) {
      link.inertia = {{{v[0], 0.0, 0.0}, {0.0, v[1], 0.0}, {0.0, 0.0, v[2]}}};
      link.axes = pose.q;
    } else {
      file_.refuse(e, "diaginertia, fullinertia: missing");
    }
    link.inertia = turned(pose.q, link.inertia);
    constexpr std::string_view known[] = {"pos",    "mass",      "diaginertia", "fullinertia",
                                          "quat",   "axisangle", "euler",       "zaxis",
                                          "xyaxes", "class"};
    context_.defaults.check_known(e, {}, known, {});
  }

  void read_body(const Element& e, const BodyPart& outer) {
    constexpr std::string_view known[] = {"name",  "pos",   "quat",     "axisangle",
                                          "euler", "zaxis", "xyaxes",   "childclass",
                                          "user",  "mocap", "gravcomp", "sleep"};
    for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next())
      if (std::find(std::begin(known), std::end(known), a->Name()) == std::end(known))
        context_.not_read(e, std::string("the attribute ") + a->Name());
    double gravcomp[1] = {0.0};
    file_.numbers(e, "gravcomp", gravcomp);
    Robot& robot = context_.robot;
    std::string name = outer.name_of(e);
    if (name.empty()) name = outer.prefix + "body_" + std::to_string(robot.links.size());
    BodyJoints joints(context_, e, outer, class_in(e, outer), name);
    const char* const mocap = e.Attribute("mocap");
    const bool is_mocap = mocap != nullptr && read_flag(file_, e, "mocap", mocap);
    const Posed pose = math::multiply(outer.frame, pose_of(e));
    const int32_t index = joints.add(pose, is_mocap);
    robot.links[static_cast<size_t>(index)].gravcomp = gravcomp[0];
    if (robot.links.size() > kMostBodies) file_.refuse(e, "expected at most 10000 bodies");
    if (!context_.bodies.emplace(name, index).second)
      file_.refuse(e, "name: expected different names, got \"" + name + "\" twice");
    context_.notes.read("body");
    const auto how = context_.settings.compiler.inertia_from_geom;
    BodyPart part{.link = index,
                  .childclass = class_in(e, outer),
                  .is_static = outer.is_static && !joints.moves(),
                  .in_world = math::multiply(outer.in_world, pose),
                  .prefix = outer.prefix,
                  .suffix = outer.suffix,
                  .with_mass = how == MjcfCompiler::Inertia::Always ||
                               (how == MjcfCompiler::Inertia::Auto &&
                                e.FirstChildElement("inertial") == nullptr)};
    read_children(e, part);
    const RobotLink& link = robot.links[static_cast<size_t>(index)];
    if (link.mass == 0.0 && joints.moves() && !is_mocap && e.FirstChildElement("body") == nullptr &&
        !(context_.settings.compiler.bound_mass > 0.0))
      file_.refuse(e, "expected a mass: an <inertial>, or a geom with a density");
  }

  MjcfContext& context_;
  const XmlFile& file_;
  int64_t elements_ = 0;
};

}  // namespace

void read_bodies(MjcfContext& context) { BodiesReader(context).run(); }
bool read_attached(MjcfContext& context, const char* body, BodyPart& to) {
  return BodiesReader(context).run_attached(body, to);
}

}  // namespace novaphy::detail
