// XML files with the places of their elements, and strict numbers.
#pragma once

#include <tinyxml2.h>

#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "robot.h"

namespace novaphy::detail {

using Element = tinyxml2::XMLElement;

// A file that is read whole, or XML that was given as text.
struct XmlSource {
  std::string name;  // in messages
  std::string text;
  std::filesystem::path folder;  // empty: text
};

// `source`: XML, when it begins with '<'; else a path, or package://NAME/... in package_dirs.
XmlSource read_source(std::string_view function, std::string_view source,
                      std::span<const std::filesystem::path> package_dirs);

// A file that a robot file names. It lies in the folder of that, the one above, or in package_dirs.
std::filesystem::path resolve_file(const std::string& where, std::string_view file,
                                   const std::filesystem::path& folder,
                                   std::span<const std::filesystem::path> package_dirs);

class XmlFile {
 public:
  // ErrorKind::Value: no XML, nested too deep, too large, another root element than `root`, a
  // document type or entities.
  XmlFile(std::string_view function, XmlSource source, const char* root);

  const XmlSource& source() const { return source_; }
  const Element& root() const { return *root_; }
  // "file:line: <link name="a">"
  std::string place(const Element& element) const;
  [[noreturn]] void refuse(const Element& element, std::string_view why,
                           ErrorKind kind = ErrorKind::Value) const;
  // An attribute; nullptr: there is none.
  static const char* text(const Element& element, const char* attribute) {
    return element.Attribute(attribute);
  }
  // The attribute as exactly out.size() finite numbers; false: there is none.
  bool numbers(const Element& element, const char* attribute, std::span<double> out) const;
  // The numbers of a text that belongs to an element.
  std::vector<double> parse(const Element& element, const char* attribute,
                            std::string_view text) const;
  // The only child of that name; nullptr: there is none. Two are refused.
  const Element* only(const Element& parent, const char* name) const;

 private:
  std::string_view function_;
  XmlSource source_;
  tinyxml2::XMLDocument document_;
  const Element* root_ = nullptr;
};

}  // namespace novaphy::detail
