// Attributes of MJCF elements: their own, else those of their default class.
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

  // The attribute of an element; its own, that of its class, or that of `childclass`. Classes have
  // the defaults of all equalities under equality, those of <spatial> and <fixed> under tendon.
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
  // The <general>, <motor>, ... of the classes around an actuator's, outermost first, and its own.
  using ActuatorClasses = std::vector<std::vector<const Element*>>;
  const ActuatorClasses& actuators(const Element& e) const;
  // The attribute, or that of the <general>, <position>, ... of the class that comes last.
  std::optional<std::string> actuator_text(const Element& e, const char* attribute) const;
  // The orientation of an element: axisangle, euler, zaxis or xyaxes, else quat; else the identity.
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

// The turn of three angles of the file, by `eulerseq`.
Quatd euler_turn(const Vec3d& angles, const MjcfCompiler& compiler);

}  // namespace novaphy::detail
