// Reads sections of MJCF files other than bodies and actuators.
#include <algorithm>
#include <cmath>

#include "mjcf_context.h"

namespace novaphy::detail {
namespace {

template <class Visit>
void each(const MjcfContext& context, const char* section, Visit&& visit) {
  for (const Element* all = context.file.root().FirstChildElement(section); all != nullptr;
       all = all->NextSiblingElement(section))
    for (const Element* e = all->FirstChildElement(); e != nullptr; e = e->NextSiblingElement())
      visit(*e);
}

std::string needed(const MjcfContext& context, const Element& e, const char* name) {
  const auto text = context.defaults.text(e, name, {});
  if (!text) context.file.refuse(e, std::string(name) + ": missing");
  return *text;
}

void read_exclude(MjcfContext& context, const Element& e) {
  int32_t ends[2];
  const char* const names[] = {"body1", "body2"};
  for (int k = 0; k < 2; ++k) {
    const std::string body = needed(context, e, names[k]);
    const auto found = context.bodies.find(context.named(body));
    if (found == context.bodies.end() && body != "world") {
      if (context.is_part) return;
      context.file.refuse(e, "there is no body \"" + body + "\"");
    }
    ends[k] = body == "world" ? kWorldLink : found->second;
  }
  context.robot.excluded.emplace_back(ends[0], ends[1]);
}

void read_pair(MjcfContext& context, const Element& e) {
  const std::string a = context.named(needed(context, e, "geom1")),
                    b = context.named(needed(context, e, "geom2"));
  for (const std::string& geom : {a, b}) {
    if (context.geoms.contains(geom)) continue;
    if (context.is_part) return;
    context.file.refuse(e, "there is no geom \"" + geom + "\"");
  }
  context.robot.pairs.emplace_back(a, b);
  for (const char* own :
       {"friction", "condim", "margin", "gap", "solref", "solimp", "solreffriction"})
    if (context.defaults.text(e, own, {}))
      return context.notes.ignored(e, "numbers of a pair: its geoms have those of their own");
}

// Returns whether a tendon exerts forces of its own.
bool acts(const MjcfContext& context, const Element& e) {
  const MjcfDefaults& d = context.defaults;
  const auto has = [&](const char* name) {
    const std::vector<double> values = d.list(e, name, {});
    return std::any_of(values.begin(), values.end(), [](double v) { return v != 0.0; });
  };
  const MjcfOption& o = context.settings.option;
  const std::string limited = d.text(e, "limited", {}).value_or("auto");
  const bool has_range =
      limited == "true" ||
      (limited == "auto" && context.settings.compiler.auto_limits && has("range"));
  return (o.spring && has("stiffness")) || (o.damper && has("damping")) || has("armature") ||
         (o.friction && has("frictionloss")) || (o.limit && has_range);
}

}  // namespace

void read_contacts(MjcfContext& context) {
  each(context, "contact", [&](const Element& e) {
    const std::string_view kind = e.Name();
    if (kind == "exclude") return read_exclude(context, e);
    if (kind == "pair") return read_pair(context, e);
    context.not_read(e, "this element");
  });
}

void read_others(MjcfContext& context) {
  each(context, "equality", [&](const Element& e) {
    context.notes.read("equality");
    const auto active = context.defaults.text(e, "active", {}).value_or("true");
    context.equalities.push_back(read_part(context, e));
    if (read_flag(context.file, e, "active", active) && context.settings.option.equality)
      context.refuse_at_finalize(e, std::string("an equality of the kind ") + e.Name());
  });
  each(context, "tendon", [&](const Element& e) {
    context.notes.read("tendon");
    context.tendons.push_back(read_part(context, e));
    if (acts(context, e)) context.refuse_at_finalize(e, "a tendon that has forces");
  });
  each(context, "asset", [&](const Element& e) {
    if (std::string_view(e.Name()) == "hfield")
      context.height_fields.push_back(read_height_field(context, e));
  });
  each(context, "sensor", [&](const Element& e) {
    context.notes.read("sensor");
    context.sensors.push_back(read_part(context, e));
  });
  each(context, "deformable", [&](const Element& e) {
    if (std::string_view(e.Name()) != "skin") context.notes.left_out(e, "this element");
  });
  for (const Element* e = context.file.root().FirstChildElement(); e != nullptr;
       e = e->NextSiblingElement()) {
    constexpr std::string_view known[] = {
        "compiler", "option",    "size",     "visual",    "statistic", "default",
        "custom",   "extension", "asset",    "contact",   "equality",  "tendon",
        "actuator", "sensor",    "keyframe", "worldbody", "deformable"};
    if (std::find(std::begin(known), std::end(known), e->Name()) == std::end(known))
      context.not_read(*e, "this element");
  }
}

std::vector<double> coordinates_of(const MjcfContext& context, const Element& e,
                                   std::span<const double> qpos) {
  std::vector<double> q;
  size_t at = 0;
  const auto next = [&] { return at < qpos.size() ? qpos[at++] : (++at, 0.0); };
  const auto pose = [&](const Posed& p) {
    for (const double v : {p.p.x, p.p.y, p.p.z, p.q.x, p.q.y, p.q.z, p.q.w}) q.push_back(v);
  };
  const auto quaternion = [&] {
    Quatd v;
    v.w = next(), v.x = next(), v.y = next(), v.z = next();
    const double norm = std::sqrt(v.w * v.w + v.x * v.x + v.y * v.y + v.z * v.z);
    if (at <= qpos.size() && !(norm > 1e-10))
      context.file.refuse(e, "expected a quaternion that is not zero");
    return Quatd{v.x / norm, v.y / norm, v.z / norm, v.w / norm};
  };
  for (const RobotJoint& joint : context.robot.joints) {
    const RobotLink& link = context.robot.links[static_cast<size_t>(joint.child)];
    if (link.is_kinematic) {
      pose(joint.parent_pose);
    } else if (joint.type == JointType::FREE) {
      Posed p;
      p.p.x = next(), p.p.y = next(), p.p.z = next();
      p.q = quaternion();
      pose(p);
    } else if (quaternion_at(joint.type) == 0) {
      const Quatd v = quaternion();
      for (const double each : {v.x, v.y, v.z, v.w}) q.push_back(each);
    }
    for (size_t k = 0; k < joint.linear.size() + joint.angular.size(); ++k) q.push_back(next());
  }
  return at == qpos.size() ? q : std::vector<double>{};
}

}  // namespace novaphy::detail
