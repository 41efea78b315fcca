// Attributes of MJCF elements: an element's own value, or else that of its default class.
#pragma once

#include <map>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "mjcf_settings.h"

namespace novaphy::detail {

class MjcfDefaults {
 public:
  explicit MjcfDefaults(const XmlFile& file);

  // Returns an attribute of an element: its own value, else that of its class, else that of
  // `childclass`. The element name for class defaults is `equality` for all equalities, and
  // `tendon` for <spatial> and <fixed>.
  std::optional<std::string> text(const Element& e, const char* attribute,
                                  const std::string& childclass) const;
  // Reads an attribute as exactly out.size() finite numbers. Returns false if the attribute is
  // missing.
  bool numbers(const Element& e, const char* attribute, const std::string& childclass,
               std::span<double> out) const;
  // Reads an attribute as a list of any length.
  std::vector<double> list(const Element& e, const char* attribute,
                           const std::string& childclass) const;
  double number(const Element& e, const char* attribute, const std::string& childclass,
                double by_default) const;
  // Throws ErrorKind::NotImplemented for an attribute of an element or its class that is neither in
  // `read` nor in `passed_over`.
  void check_known(const Element& e, const std::string& childclass,
                   std::span<const std::string_view> read,
                   std::span<const std::string_view> passed_over) const;
  // The actuator elements (<general>, <motor> and so on) in the default classes of an actuator:
  // those of the enclosing classes, outermost first, then those of its own class.
  using ActuatorClasses = std::vector<std::vector<const Element*>>;
  const ActuatorClasses& actuators(const Element& e) const;
  // Returns an attribute of an actuator, or else that of the last actuator element of its class.
  std::optional<std::string> actuator_text(const Element& e, const char* attribute) const;
  // Returns the orientation of an element from axisangle, euler, zaxis, xyaxes or quat. Returns the
  // identity if the element has none of these attributes.
  Quatd orientation(const Element& e, const std::string& childclass,
                    const MjcfCompiler& compiler) const;

 private:
  using Attributes = std::map<std::string, std::string>;
  struct Class {
    std::map<std::string, Attributes> elements;
    ActuatorClasses actuators = {};
  };

  void read(const Element& e, const std::string& parent);
  const Class& class_of(const Element& e, const std::string& childclass) const;
  const Attributes* of_class(const Element& e, const std::string& childclass) const;

  const XmlFile& file_;
  std::map<std::string, Class> classes_;
};

// Returns the rotation by three Euler angles (in the unit of the file), in the order of `eulerseq`.
Quatd euler_turn(const Vec3d& angles, const MjcfCompiler& compiler);

}  // namespace novaphy::detail
