// XML files with the line of each element, and strict parsing of numbers.
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

// The text of a file, or XML that a caller gave as text.
struct XmlSource {
  std::string name;  // for error messages
  std::string text;
  std::filesystem::path folder;  // empty for XML given as text
};

// Reads `source`: XML text if it begins with '<', else the file with this path, or with the path
// package://NAME/... in package_dirs.
XmlSource read_source(std::string_view function, std::string_view source,
                      std::span<const std::filesystem::path> package_dirs);

// Returns the path of a file that a robot file names. The file must lie in the folder of the robot
// file, in its parent folder, or in package_dirs.
std::filesystem::path resolve_file(const std::string& where, std::string_view file,
                                   const std::filesystem::path& folder,
                                   std::span<const std::filesystem::path> package_dirs);

class XmlFile {
 public:
  // Parses the XML. ErrorKind::Value: not XML, nested too deep, too large, a document type,
  // entities, or a root element other than `root`. A null `root` accepts any root element.
  XmlFile(std::string_view function, XmlSource source, const char* root);

  std::string_view function() const { return function_; }
  const XmlSource& source() const { return source_; }
  const Element& root() const { return *root_; }
  Element& root() { return *root_; }
  // Replaces `element` by copies of the children of `other`'s root. The copies keep their file and
  // line. Returns the first copy, or null if there is none.
  Element* replace(Element& element, const XmlFile& other);
  // Returns the document as text, with all changes.
  std::string text() const;
  // Throws ErrorKind::Value for elements that are nested too deep, duplicate attributes, and
  // macros.
  void check_elements() const;

  // Returns the path of a file that an element names: `path` in the folder of this file, else
  // `beside` in the folder of the included file with the element. Errors as for resolve_file.
  std::filesystem::path resolve(const Element& element, std::string_view path,
                                std::string_view beside,
                                std::span<const std::filesystem::path> package_dirs) const;

  // Returns a note with the file, the line, and the element as `<link name="a">`.
  RobotNote note(const Element& element, std::string text) const;
  // Returns "file:line: <link name="a">".
  std::string place(const Element& element) const;
  [[noreturn]] void refuse(const Element& element, std::string_view why,
                           ErrorKind kind = ErrorKind::Value) const;
  // Returns an attribute, or null if it is missing.
  static const char* text(const Element& element, const char* attribute) {
    return element.Attribute(attribute);
  }
  // Reads an attribute as exactly out.size() finite numbers. Returns false if the attribute is
  // missing.
  bool numbers(const Element& element, const char* attribute, std::span<double> out) const;
  // Returns the numbers in the text of an attribute of an element.
  std::vector<double> parse(const Element& element, const char* attribute,
                            std::string_view text) const;
  // Returns the only child of this name, or null if there is none. Two such children are an error.
  const Element* only(const Element& parent, const char* name) const;

 private:
  std::string_view function_;
  XmlSource source_;
  struct Origin {
    std::string file;
    int line;
  };
  void copy_origins(const Element& from, Element& to, const XmlFile& other);

  std::deque<Origin> origins_;  // origins of included elements; the elements point to these entries
  tinyxml2::XMLDocument document_;
  Element* root_ = nullptr;
};

}  // namespace novaphy::detail
