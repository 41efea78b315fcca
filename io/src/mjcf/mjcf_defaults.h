// Attributes of MJCF elements: their own, else those of their default class.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "../robot/xml.h"

namespace novaphy::detail {

// <compiler>: how angles and orientations are written.
struct MjcfCompiler {
  double angle = 3.14159265358979323846 / 180.0;  // radians per unit
  bool auto_limits = true;
  enum class Inertia { Auto, Always, Never } inertia_from_geom = Inertia::Auto;
};

class MjcfDefaults {
 public:
  explicit MjcfDefaults(const XmlFile& file);

  // The attribute of an element; its own, that of its class, or that of `childclass`.
  std::optional<std::string> text(const Element& e, const char* attribute,
                                  const std::string& childclass) const;
  // As exactly out.size() finite numbers; false: there is none.
  bool numbers(const Element& e, const char* attribute, const std::string& childclass,
               std::span<double> out) const;
  // As many as there are.
  std::vector<double> list(const Element& e, const char* attribute,
                           const std::string& childclass) const;
  double number(const Element& e, const char* attribute, const std::string& childclass,
                double by_default) const;
  // Raises NotImplemented where an element, or its class, has an attribute that is not in `read`
  // and not in `passed_over`.
  void check_known(const Element& e, const std::string& childclass,
                   std::span<const std::string_view> read,
                   std::span<const std::string_view> passed_over) const;
  // The orientation of an element: quat, axisangle, euler, zaxis or xyaxes; else the identity.
  Quatd orientation(const Element& e, const std::string& childclass,
                    const MjcfCompiler& compiler) const;

 private:
  using Attributes = std::map<std::string, std::string>;
  using Class = std::map<std::string, Attributes>;  // by element

  void read(const Element& e, const std::string& parent);
  const Attributes* of_class(const Element& e, const std::string& childclass) const;

  const XmlFile& file_;
  std::map<std::string, Class> classes_;
};

}  // namespace novaphy::detail
