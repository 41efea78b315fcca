#include "urdf_mend.h"

#include <algorithm>
#include <charconv>
#include <cmath>

namespace novaphy::detail {
namespace {

class Mender {
 public:
  Mender(XmlFile& file, Notes& notes) : file_(file), notes_(notes) {}

  MendedUrdf run() {
    Element& robot = file_.root();
    name(robot, "robot");
    collect_materials(robot);
    for (const Element* e = robot.FirstChildElement("joint"); e != nullptr;
         e = e->NextSiblingElement("joint"))
      if (const char* given = e->Attribute("name")) joints_.insert(given);
    for (Element* e = robot.FirstChildElement(); e != nullptr;) {
      Element* const next = e->NextSiblingElement();
      const std::string_view kind = e->Name();
      if (kind == "link") mend_link(*e);
      if (kind == "joint") mend_joint(*e);
      if (kind == "material") mend_material(*e, true);
      e = next;
    }
    return std::move(mended_);
  }

 private:
  static void drop(Element& e) { e.Parent()->DeleteChild(&e); }
  void drop(Element& e, const char* why) {
    notes_.mended(e, why);
    drop(e);
  }
  void name(Element& e, const char* by_default) {
    const char* const given = e.Attribute("name");
    if (given != nullptr && *given != '\0') return;
    e.SetAttribute("name", by_default);
    notes_.mended(e, "it had no name");
  }
  // Removes all but the first of several elements with one name, as urdfdom does.
  void keep_first(Element& parent, std::initializer_list<const char*> names) {
    for (const char* each : names)
      if (Element* first = parent.FirstChildElement(each))
        while (Element* other = first->NextSiblingElement(each))
          drop(*other, "there is one before it, which counts");
  }
  // Removes elements that the reader ignores and that urdfdom may refuse.
  void pass_over(Element& parent, std::initializer_list<const char*> names) {
    for (const char* each : names)
      while (Element* e = parent.FirstChildElement(each)) {
        notes_.ignored(*e, std::string("not read: <") + each + ">");
        drop(*e);
      }
  }

  // Returns an attribute of a child element, or null if it is missing.
  static const char* of_child(const Element& e, const char* child, const char* attribute) {
    const Element* const found = e.FirstChildElement(child);
    return found == nullptr ? nullptr : found->Attribute(attribute);
  }
  static bool is_defined(const Element& material) {
    return of_child(material, "color", "rgba") != nullptr ||
           of_child(material, "texture", "filename") != nullptr;
  }
  // Collects the materials of the whole file by name. A material of a link may be used by other
  // links too.
  void collect_materials(const Element& robot) {
    const auto add = [&](const Element* e) {
      const char* const given = e->Attribute("name");
      const char* const rgba = of_child(*e, "color", "rgba");
      const char* const file = of_child(*e, "texture", "filename");
      if (given != nullptr && is_defined(*e))
        materials_.try_emplace(given, rgba == nullptr ? "" : rgba, file == nullptr ? "" : file);
    };
    for (const Element* e = robot.FirstChildElement("material"); e != nullptr;
         e = e->NextSiblingElement("material"))
      add(e);
    for (const Element* link = robot.FirstChildElement("link"); link != nullptr;
         link = link->NextSiblingElement("link"))
      for (const Element* v = link->FirstChildElement("visual"); v != nullptr;
           v = v->NextSiblingElement("visual"))
        for (const Element* m = v->FirstChildElement("material"); m != nullptr;
             m = m->NextSiblingElement("material"))
          add(m);
  }
  void mend_material(Element& e, bool is_global) {
    name(e, ("material_" + std::to_string(++unnamed_)).c_str());
    const std::string own = e.Attribute("name");
    keep_first(e, {"color", "texture"});
    if (Element* color = e.FirstChildElement("color"))
      if (color->Attribute("rgba") == nullptr) drop(*color, "it has no rgba");
    if (Element* texture = e.FirstChildElement("texture"))
      if (texture->Attribute("filename") == nullptr) drop(*texture, "it has no filename");
    if (is_global) {
      // Only the first definition of a material is kept. A material without a definition is
      // removed.
      if (!is_defined(e)) return drop(e);
      if (!global_.insert(own).second) drop(e, "there is one of that name, which counts");
      return;
    }
    if (is_defined(e)) return;
    const auto found = materials_.find(own);
    if (found == materials_.end()) return drop(e, "there is no material of that name with a color");
    const auto& [rgba, texture] = found->second;
    if (!rgba.empty()) e.InsertNewChildElement("color")->SetAttribute("rgba", rgba.c_str());
    if (!texture.empty())
      e.InsertNewChildElement("texture")->SetAttribute("filename", texture.c_str());
  }

  void mend_link(Element& link) {
    keep_first(link, {"inertial"});
    if (Element* inertial = link.FirstChildElement("inertial")) mend_inertial(*inertial);
    for (const char* kind : {"visual", "collision"})
      for (Element* e = link.FirstChildElement(kind); e != nullptr;) {
        Element* const next = e->NextSiblingElement(kind);
        mend_shape(*e);
        e = next;
      }
  }

  void mend_inertial(Element& e) {
    keep_first(e, {"origin", "mass", "inertia"});
    const Element* const mass = e.FirstChildElement("mass");
    if (mass == nullptr || mass->Attribute("value") == nullptr)
      return drop(e, "an <inertial> without a mass: it does not count");
    Element* inertia = e.FirstChildElement("inertia");
    if (inertia == nullptr) {
      inertia = file_.root().GetDocument()->NewElement("inertia");
      e.InsertEndChild(inertia);
    }
    bool is_whole = true;
    for (const char* entry : {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"})
      if (inertia->Attribute(entry) == nullptr) {
        inertia->SetAttribute(entry, "0");
        is_whole = false;
      }
    if (!is_whole) notes_.mended(e, "the missing entries of its <inertia> are 0");
  }

  void mend_shape(Element& e) {
    keep_first(e, {"origin", "material", "geometry"});
    if (Element* material = e.FirstChildElement("material")) mend_material(*material, false);
    Element* const geometry = e.FirstChildElement("geometry");
    if (geometry == nullptr || geometry->FirstChildElement() == nullptr)
      return drop(e, "it has no shape");
    Element& shape = *geometry->FirstChildElement();
    while (Element* other = shape.NextSiblingElement())
      drop(*other, "there is a shape before it, which counts");
    std::string_view kind = shape.Name();
    if (kind == "capsule") {
      shape.SetName("cylinder");
      kind = shape.Name();
      mended_.capsules.insert(&shape);
    }
    if (kind != "box" && kind != "cylinder" && kind != "sphere" && kind != "mesh") {
      constexpr const char* kWhat =
          "a shape other than <box>, <cylinder>, <sphere>, <capsule> and <mesh>";
      if (std::string_view(e.Name()) == "visual")
        notes_.missing(shape, kWhat);
      else
        notes_.left_out(shape, kWhat);
      return drop(e);
    }
    const auto is_empty = [&](const char* name, size_t count, bool all) {
      double v[3] = {1.0, 1.0, 1.0};
      if (shape.Attribute(name) == nullptr ||
          !file_.numbers(shape, name, std::span(v).first(count)))
        return false;
      const auto zero = [](double x) { return static_cast<float>(x) == 0.0f; };
      return all ? std::all_of(v, v + count, zero) : std::any_of(v, v + count, zero);
    };
    if ((kind == "sphere" && is_empty("radius", 1, true)) ||
        (kind == "box" && is_empty("size", 3, false)) ||
        (kind == "cylinder" && (is_empty("radius", 1, true) || is_empty("length", 1, true))) ||
        (kind == "mesh" && is_empty("scale", 3, false)))
      drop(e, "a shape of size 0: it is left out");
  }

  // Returns whether a text is a number of the sign of `instead` that is infinite or that float32
  // cannot hold.
  static bool is_out_of_range(const char* text, std::string_view instead) {
    std::string_view given = text == nullptr ? "" : text;
    while (given.ends_with(' ')) given.remove_suffix(1);
    while (given.starts_with(' ')) given.remove_prefix(1);
    if (given.starts_with('+')) given.remove_prefix(1);
    long double value = 0.0L;
    const auto parsed = std::from_chars(given.data(), given.data() + given.size(), value);
    return parsed.ptr == given.data() + given.size() && std::abs(value) > 1e30L &&
           (value < 0.0L) == instead.starts_with('-');
  }

  void mend_joint(Element& e) {
    keep_first(e, {"origin", "axis", "limit", "dynamics", "mimic", "parent", "child"});
    pass_over(e, {"safety_controller", "calibration"});
    if (Element* axis = e.FirstChildElement("axis"))
      if (axis->Attribute("xyz") == nullptr) drop(*axis, "it has no xyz: the axis is x");
    if (Element* dynamics = e.FirstChildElement("dynamics"))
      if (dynamics->Attribute("damping") == nullptr && dynamics->Attribute("friction") == nullptr)
        drop(*dynamics);
    if (Element* mimic = e.FirstChildElement("mimic"))
      if (const char* leader = mimic->Attribute("joint"); leader && !joints_.contains(leader)) {
        notes_.left_out(*mimic, "it mimics a joint that does not exist");
        drop(*mimic);
      }
    const char* const given = e.Attribute("type");
    const std::string_view type = given == nullptr ? "" : given;
    const bool needs_limit = type == "revolute" || type == "prismatic";
    Element* limit = e.FirstChildElement("limit");
    if (limit == nullptr && !needs_limit) return;
    const char* const open[] = {"-1e10", "1e10"};
    if (limit == nullptr) {
      limit = e.InsertNewChildElement("limit");
      limit->SetAttribute("lower", open[0]);
      limit->SetAttribute("upper", open[1]);
      notes_.mended(e, "it has no <limit>: it has no limits");
    }
    bool is_whole = true;
    const bool is_new = limit->GetLineNum() == 0;
    for (const char* attribute : {"effort", "velocity"})
      if (limit->Attribute(attribute) == nullptr) {
        limit->SetAttribute(attribute, "1e6");
        is_whole = false;
      }
    if (!is_whole && !is_new)
      notes_.mended(*limit, "effort, velocity: what is missing has no limit");
    for (const auto& [attribute, instead] :
         {std::pair{"lower", open[0]}, {"upper", open[1]}, {"effort", "1e6"}, {"velocity", "1e6"}})
      if (is_out_of_range(limit->Attribute(attribute), instead)) {
        limit->SetAttribute(attribute, instead);
        notes_.mended(*limit, std::string(attribute) + ": a number this large is no limit");
      }
    double lower[1] = {0.0}, upper[1] = {0.0};
    file_.numbers(*limit, "lower", lower);
    file_.numbers(*limit, "upper", upper);
    if (lower[0] <= upper[0]) return;
    const std::string low = limit->Attribute("lower") == nullptr ? "0" : limit->Attribute("lower");
    const std::string high = limit->Attribute("upper") == nullptr ? "0" : limit->Attribute("upper");
    limit->SetAttribute("lower", high.c_str());
    limit->SetAttribute("upper", low.c_str());
    notes_.mended(*limit, "lower, upper: the lower one is taken as the lower");
  }

  XmlFile& file_;
  Notes& notes_;
  MendedUrdf mended_;
  // rgba and texture of each material
  std::map<std::string, std::pair<std::string, std::string>> materials_;
  std::set<std::string> global_, joints_;
  int unnamed_ = 0;
};

}  // namespace

MendedUrdf mend_urdf(XmlFile& file, Notes& notes) { return Mender(file, notes).run(); }

}  // namespace novaphy::detail
