#include "xml.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <fstream>

#include "novaphy/core/io/file.h"

namespace novaphy::detail {
namespace {

namespace fs = std::filesystem;

constexpr size_t kLargest = size_t{64} << 20;  // bytes
constexpr int kDeepest = 100;                  // largest depth of nested elements

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\n' || c == '\r'; }

bool is_inside(const fs::path& file, const fs::path& folder) {
  const fs::path relative = file.lexically_relative(folder);
  return !relative.empty() && *relative.begin() != "..";
}

fs::path resolved(const fs::path& path) {
  std::error_code error;
  fs::path result = fs::weakly_canonical(path, error);
  return error ? path.lexically_normal() : result;
}

// Returns the folders that an environment variable lists.
std::vector<fs::path> listed(const char* variable) {
  std::vector<fs::path> folders;
  const char* const given = std::getenv(variable);
  std::string_view rest = given == nullptr ? "" : given;
  while (!rest.empty()) {
    const size_t end = std::min(rest.find(':'), rest.size());
    if (end > 0) folders.emplace_back(rest.substr(0, end));
    rest.remove_prefix(std::min(end + 1, rest.size()));
  }
  return folders;
}

// Returns whether a folder contains the package, according to its package.xml.
bool is_package(const fs::path& folder, std::string_view name) {
  std::error_code none;
  if (!fs::is_regular_file(folder / "package.xml", none)) return false;
  std::ifstream file(folder / "package.xml");
  std::string text(size_t{64} << 10, '\0');
  file.read(text.data(), static_cast<std::streamsize>(text.size()));
  text.resize(static_cast<size_t>(file.gcount()));
  constexpr std::string_view kBegin = "<name>";
  for (size_t at = text.find(kBegin); at != std::string::npos; at = text.find(kBegin, at)) {
    at += kBegin.size();
    std::string_view found = std::string_view(text).substr(at);
    found = found.substr(0, found.find('<'));
    while (!found.empty() && is_space(found.front())) found.remove_prefix(1);
    while (!found.empty() && is_space(found.back())) found.remove_suffix(1);
    if (found == name) return true;
  }
  return false;
}

// Returns the folder of a package below the folders of ROS_PACKAGE_PATH, or an empty path. As
// rospack does, the search does not look inside of packages.
fs::path crawl_ros_packages(std::string_view name) {
  constexpr int kDeepestPackage = 6;
  std::vector<fs::path> found;
  for (const fs::path& root : listed("ROS_PACKAGE_PATH")) {
    std::error_code error;
    fs::recursive_directory_iterator at(root, fs::directory_options::skip_permission_denied, error);
    for (; !error && at != fs::recursive_directory_iterator(); at.increment(error)) {
      std::error_code none;
      if (!at->is_directory(none)) continue;
      const fs::path& folder = at->path();
      const bool is_any_package = fs::is_regular_file(folder / "package.xml", none);
      if (is_any_package && is_package(folder, name)) found.push_back(folder);
      if (is_any_package || at.depth() >= kDeepestPackage ||
          folder.filename().string().starts_with('.'))
        at.disable_recursion_pending();
    }
    if (!found.empty()) return *std::min_element(found.begin(), found.end());
  }
  return {};
}

// Returns the folders that may contain a package, the most likely first: `package_dirs`, the
// folders of ROS, then the folders above the robot's file with the folders next to them.
std::vector<fs::path> package_roots(std::string_view package, const fs::path& folder,
                                    std::span<const fs::path> package_dirs) {
  std::vector<fs::path> roots, dirs(package_dirs.begin(), package_dirs.end());
  for (const fs::path& each : listed("ROS_PACKAGE_PATH")) dirs.push_back(each);
  for (const fs::path& each : listed("AMENT_PREFIX_PATH")) dirs.push_back(each / "share");
  for (const fs::path& each : dirs) {
    roots.push_back(each / package);
    if (resolved(each).filename() == package) roots.push_back(each);
  }
  // Files in these two folders may always be read.
  for (const fs::path& each : {folder, folder.parent_path()})
    if (!folder.empty()) roots.push_back(each / package);
  int levels = 0;
  for (fs::path at = folder; at.has_relative_path() && levels < 8;
       at = at.parent_path(), ++levels) {
    if (at.filename() == package || is_package(at, package)) roots.push_back(at);
    if (is_package(at / package, package)) roots.push_back(at / package);
  }
  return roots;
}

fs::path in_packages(const std::string& where, std::string_view file, const fs::path& folder,
                     std::span<const fs::path> package_dirs) {
  std::string_view path = file.substr(file.find("://") + 3);
  path.remove_prefix(std::min(path.find_first_not_of('/'), path.size()));
  const size_t slash = path.find('/');
  std::error_code none;
  if (slash == std::string_view::npos && !path.empty() && path != ".." && !folder.empty() &&
      fs::is_regular_file(folder / path, none))
    return resolved(folder / path);
  require(slash != std::string_view::npos && slash > 0 && slash + 1 < path.size(), ErrorKind::Value,
          where, ": expected package://NAME/FILE, got ", file);
  const std::string_view package = path.substr(0, slash);
  std::string_view rest = path.substr(slash + 1);
  rest.remove_prefix(std::min(rest.find_first_not_of('/'), rest.size()));
  require(package != "." && package != "..", ErrorKind::Value, where,
          ": expected a file inside of its package, got ", file);
  const auto in = [&](const fs::path& root) -> fs::path {
    const fs::path found = resolved(root / rest);
    std::error_code error;
    if (root.empty() || !fs::exists(found, error)) return {};
    require(is_inside(found, resolved(root)), ErrorKind::Value, where,
            ": expected a file inside of its package, got ", file);
    return found;
  };
  for (const fs::path& root : package_roots(package, folder, package_dirs))
    if (const fs::path found = in(root); !found.empty()) return found;
  if (const fs::path found = in(crawl_ros_packages(package)); !found.empty()) return found;
  std::string folders;
  for (const fs::path& each : package_dirs) folders += " " + each.string();
  fail(ErrorKind::Value, where, ": there is no ", file,
       " in package_dirs, ROS_PACKAGE_PATH, AMENT_PREFIX_PATH and around the file; package_dirs:",
       folders.empty() ? " none" : folders);
}

// Returns whether a text is valid UTF-8 (RFC 3629), so that names can become Python strings.
bool is_utf8(std::string_view text) {
  for (size_t k = 0; k < text.size();) {
    const auto byte = [&](size_t i) {
      return i < text.size() ? static_cast<uint32_t>(static_cast<unsigned char>(text[i])) : 0u;
    };
    const uint32_t first = byte(k);
    const size_t more = first < 0x80 ? 0 : first >> 5 == 6 ? 1 : first >> 4 == 14 ? 2 : 3;
    if (more == 3 && first >> 3 != 30) return false;
    uint32_t code = more == 0 ? first : first & (0x3Fu >> more);
    for (size_t i = 1; i <= more; ++i) {
      if (byte(k + i) >> 6 != 2) return false;
      code = code << 6 | (byte(k + i) & 0x3F);
    }
    constexpr uint32_t kLeast[] = {0, 0x80, 0x800, 0x10000};
    if (code < kLeast[more] || code > 0x10FFFF || code >> 11 == 27) return false;
    k += more + 1;
  }
  return true;
}

bool names_package(std::string_view file) {
  return file.starts_with("package://") || file.starts_with("model://");
}

}  // namespace

XmlSource read_source(std::string_view function, std::string_view source,
                      std::span<const fs::path> package_dirs) {
  size_t first = source.starts_with("\xEF\xBB\xBF") ? 3 : 0;
  while (first < source.size() && is_space(source[first])) ++first;
  require(first < source.size(), ErrorKind::Value, function,
          ": source: expected a path or XML, got nothing");
  // Some programs append a zero byte to a file.
  const auto text_of = [](std::string_view all) {
    return std::string(all.substr(0, all.find_last_not_of('\0') + 1));
  };
  if (source[first] == '<') return {"<text>", text_of(source), {}};
  require(source.find('\0') == std::string_view::npos && source.size() < 4096, ErrorKind::Value,
          function, ": source: expected a path, or XML that begins with '<', got ", source.size(),
          " bytes");
  fs::path path(source);
  if (names_package(source))
    path = in_packages(std::string(function) + ": source", source, {}, package_dirs);
  const std::string text = read_file(function, path);
  return {path.string(), text_of(text), resolved(fs::absolute(path)).parent_path()};
}

fs::path resolve_file(const std::string& where, std::string_view file, const fs::path& folder,
                      std::span<const fs::path> package_dirs) {
  if (names_package(file)) return in_packages(where, file, folder, package_dirs);
  if (file.starts_with("file://")) file.remove_prefix(7);
  require(!file.empty() && file.find('\0') == std::string_view::npos &&
              file.find("://") == std::string_view::npos,
          ErrorKind::Value, where, ": expected a path, package:// or file://, got \"", file, "\"");
  const fs::path path(file);
  std::vector<fs::path> roots;
  if (!folder.empty()) roots = {folder, folder.parent_path()};
  for (const fs::path& extra : package_dirs) roots.push_back(resolved(extra));
  require(!roots.empty(), ErrorKind::Value, where, ": ", file,
          " needs package_dirs: XML that is no file has no folder of its own");
  std::vector<fs::path> tries;
  if (path.is_absolute()) tries.push_back(path);
  for (const fs::path& root : roots)
    if (!path.is_absolute() && root != folder.parent_path()) tries.push_back(root / path);
  std::error_code error;
  for (const fs::path& each : tries) {
    const fs::path found = resolved(each);
    if (!fs::exists(found, error)) continue;
    for (const fs::path& root : roots)
      if (is_inside(found, root)) return found;
    fail(ErrorKind::Value, where,
         ": expected a file in the folder of the robot's file, the one above it, or in "
         "package_dirs, got ",
         found.string());
  }
  fail(ErrorKind::Value, where, ": there is no file ", file, " (looked for ",
       tries.empty() ? path.string() : tries.front().string(), ")");
}

XmlFile::XmlFile(std::string_view function, XmlSource source, const char* root)
    : function_(function), source_(std::move(source)) {
  const auto broken = [&](int line, std::string_view why) {
    fail(ErrorKind::Value, function_, ": ", source_.name, ":", line, ": ", why);
  };
  if (source_.text.size() > kLargest) broken(0, "expected at most 64 MiB");
  if (source_.text.find('\0') != std::string::npos) broken(0, "expected text, got a 0 byte");
  // The parser would skip these declarations silently, and with them their effect.
  for (const std::string_view word : {"<!DOCTYPE", "<!ENTITY", "<!doctype"})
    if (source_.text.find(word) != std::string::npos)
      broken(0, std::string(word) + ": a document type and entities are not read");
  if (document_.Parse(source_.text.data(), source_.text.size()) != tinyxml2::XML_SUCCESS)
    broken(document_.ErrorLineNum(), std::string("expected XML: ") + document_.ErrorStr());
  root_ = document_.RootElement();
  if (root_ == nullptr) broken(0, "expected an element, got none");
  if (root != nullptr && std::string_view(root_->Name()) != root)
    refuse(*root_, std::string("expected the root element <") + root + ">");
  if (const Element* other = root_->NextSiblingElement())
    refuse(*other, "expected one root element, got a second one");
  check_elements();
}

void XmlFile::check_elements() const {
  // A loop instead of a recursion, because a document may be nested too deep for recursion.
  int depth = 0;
  for (const tinyxml2::XMLNode* node = root_; node != nullptr;) {
    if (const Element* element = node->ToElement()) {
      if (depth > kDeepest) refuse(*element, "expected at most 100 elements inside of each other");
      if (std::string_view(element->Name()).starts_with("xacro:"))
        refuse(*element, "this is a xacro file: make a URDF file of it with xacro first");
      if (!is_utf8(element->Name())) refuse(*element, "expected a name in UTF-8");
      for (const auto* a = element->FirstAttribute(); a != nullptr; a = a->Next()) {
        if (!is_utf8(a->Name()) || !is_utf8(a->Value()))
          refuse(*element,
                 std::string("expected UTF-8, got ") + a->Name() + "=\"" + a->Value() + "\"");
        if (std::string_view(a->Value()).find("${") != std::string_view::npos)
          refuse(*element, "${...}: make a file without macros of it with xacro first");
        if (element->Attribute(a->Name()) != a->Value())
          refuse(*element, std::string("expected one attribute ") + a->Name() + ", got two");
      }
    }
    if (node->ToText() != nullptr && !is_utf8(node->Value()))
      refuse(*node->Parent()->ToElement(), "expected UTF-8");
    if (node->FirstChild() != nullptr) {
      node = node->FirstChild();
      ++depth;
      continue;
    }
    while (node != root_ && node->NextSibling() == nullptr) {
      node = node->Parent();
      --depth;
    }
    node = node == root_ ? nullptr : node->NextSibling();
  }
}

Element* XmlFile::replace(Element& element, const XmlFile& other) {
  Element* first = nullptr;
  tinyxml2::XMLNode *const parent = element.Parent(), *last = &element;
  for (const Element* e = other.root().FirstChildElement(); e != nullptr;
       e = e->NextSiblingElement()) {
    last = parent->InsertAfterChild(last, e->DeepClone(&document_));
    if (first == nullptr) first = last->ToElement();
    copy_origins(*e, *last->ToElement(), other);
  }
  parent->DeleteChild(&element);
  return first;
}

void XmlFile::copy_origins(const Element& from, Element& to, const XmlFile& other) {
  const RobotNote place = other.note(from, {});
  to.SetUserData(&origins_.emplace_back(place.file, place.line));
  Element* copy = to.FirstChildElement();
  for (const Element* e = from.FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) {
    copy_origins(*e, *copy, other);
    copy = copy->NextSiblingElement();
  }
}

fs::path XmlFile::resolve(const Element& element, std::string_view path, std::string_view beside,
                          std::span<const fs::path> package_dirs) const {
  const std::string where = std::string(function_) + ": " + place(element);
  const auto* const origin = static_cast<const Origin*>(element.GetUserData());
  std::error_code error;
  if (origin != nullptr && !source_.folder.empty() && !fs::exists(source_.folder / path, error)) {
    const fs::path other = fs::path(origin->file).parent_path() / beside;
    if (fs::exists(other, error))
      return resolve_file(where, other.string(), source_.folder, package_dirs);
  }
  return resolve_file(where, path, source_.folder, package_dirs);
}

std::string XmlFile::text() const {
  tinyxml2::XMLPrinter printer(nullptr, true);
  document_.Print(&printer);
  return {printer.CStr(), static_cast<size_t>(printer.CStrSize() - 1)};
}

RobotNote XmlFile::note(const Element& element, std::string text) const {
  std::string name = std::string("<") + element.Name();
  if (const char* given = element.Attribute("name")) name += std::string(" name=\"") + given + "\"";
  name += ">";
  if (const auto* origin = static_cast<const Origin*>(element.GetUserData()))
    return {origin->file, origin->line, std::move(name), std::move(text)};
  return {source_.name, element.GetLineNum(), std::move(name), std::move(text)};
}

std::string XmlFile::place(const Element& element) const {
  const RobotNote at = note(element, {});
  return at.file + ":" + std::to_string(at.line) + ": " + at.element;
}

void XmlFile::refuse(const Element& element, std::string_view why, ErrorKind kind) const {
  fail(kind, function_, ": ", place(element), ": ", why);
}

std::vector<double> XmlFile::parse(const Element& element, const char* attribute,
                                   std::string_view text) const {
  std::vector<double> values;
  const char *at = text.data(), *const end = at + text.size();
  while (true) {
    while (at != end && is_space(*at)) ++at;
    if (at == end) return values;
    const char* const word = at;
    if (*at == '+' && at + 1 != end && at[1] != '-') ++at;
    double value = 0.0;
    const auto parsed = std::from_chars(at, end, value);
    const bool is_whole = parsed.ptr == end || is_space(*parsed.ptr);
    if (parsed.ec != std::errc() || !is_whole || !std::isfinite(value) || std::abs(value) > 1e30) {
      const char* stop = word;
      while (stop != end && !is_space(*stop)) ++stop;
      refuse(element, std::string(attribute) + ": expected finite numbers, got \"" +
                          std::string(word, stop) + "\"");
    }
    values.push_back(value);
    at = parsed.ptr;
  }
}

bool XmlFile::numbers(const Element& element, const char* attribute, std::span<double> out) const {
  const char* const given = element.Attribute(attribute);
  if (given == nullptr) return false;
  const std::vector<double> values = parse(element, attribute, given);
  if (values.size() != out.size())
    refuse(element, std::string(attribute) + ": expected " + std::to_string(out.size()) +
                        " number(s), got \"" + given + "\"");
  std::copy(values.begin(), values.end(), out.begin());
  return true;
}

const Element* XmlFile::only(const Element& parent, const char* name) const {
  const Element* const found = parent.FirstChildElement(name);
  if (found != nullptr && found->NextSiblingElement(name) != nullptr)
    refuse(*found->NextSiblingElement(name),
           std::string("expected one <") + name + "> in " + place(parent));
  return found;
}

}  // namespace novaphy::detail
