// XML files with the places of their elements, and strict numbers.
#pragma once

#include <tinyxml2.h>

#include <deque>
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
  // ErrorKind::Value: no XML, nested too deep, too large, another root element than `root` (null:
  // any), a document type or entities.
  XmlFile(std::string_view function, XmlSource source, const char* root);

  std::string_view function() const { return function_; }
  const XmlSource& source() const { return source_; }
  const Element& root() const { return *root_; }
  Element& root() { return *root_; }
  // Puts copies of the children of `other`'s root in the place of `element`, which goes. The copies
  // keep the places that they have in their file. Returns the first; null: there is none.
  Element* replace(Element& element, const XmlFile& other);
  // The document as text, as it stands now.
  std::string text() const;
  // ErrorKind::Value: elements nested too deep, attributes twice, macros.
  void check_elements() const;

  // The path of a file that an element names: `path` in the folder of this file, else `beside` in
  // the folder of the included file that the element comes from. ErrorKind::Value: see
  // resolve_file.
  std::filesystem::path resolve(const Element& element, std::string_view path,
                                std::string_view beside,
                                std::span<const std::filesystem::path> package_dirs) const;

  // File, line, and the element as `<link name="a">`.
  RobotNote note(const Element& element, std::string text) const;
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
  struct Origin {
    std::string file;
    int line;
  };
  void keep_places(const Element& from, Element& to, const XmlFile& other);

  std::deque<Origin> origins_;  // of elements of other files, which point here
  tinyxml2::XMLDocument document_;
  Element* root_ = nullptr;
};

}  // namespace novaphy::detail
