#include "mjcf_include.h"

#include <set>

#include "novaphy/core/io/file.h"

namespace novaphy::detail {
namespace {

namespace fs = std::filesystem;

constexpr size_t kMostFiles = 1000;
constexpr size_t kMostBytes = size_t{64} << 20;  // limit for all included files together
constexpr int kDeepest = 100;                    // largest depth of nested elements

int depth_of(const Element& element) {
  int depth = 0;
  for (const auto* node = element.Parent(); node != nullptr; node = node->Parent()) ++depth;
  return depth;
}

class Includer {
 public:
  Includer(XmlFile& file, std::span<const fs::path> package_dirs)
      : file_(file), package_dirs_(package_dirs), bytes_(file.source().text.size()) {
    if (!file.source().folder.empty())
      seen_.insert(file.source().folder / fs::path(file.source().name).filename());
  }

  void run() {
    for (Element* e = &file_.root(); e != nullptr;)
      e = std::string_view(e->Name()) == "include" ? include(*e) : next(*e, true);
    file_.check_elements();
  }

 private:
  // Returns the next element after `e` in document order. If `inside` is false, children are
  // skipped.
  static Element* next(Element& e, bool inside) {
    if (inside && e.FirstChildElement() != nullptr) return e.FirstChildElement();
    for (Element* at = &e; at != nullptr;) {
      if (at->NextSiblingElement() != nullptr) return at->NextSiblingElement();
      at = at->Parent() == nullptr ? nullptr : at->Parent()->ToElement();
    }
    return nullptr;
  }

  // Replaces an <include> element, and returns the element with which the search continues.
  Element* include(Element& e) {
    const char* const given = e.Attribute("file");
    if (given == nullptr) file_.refuse(e, "file: missing");
    if (depth_of(e) > kDeepest)
      file_.refuse(e, "expected at most 100 elements inside of each other");
    const fs::path path = file_.resolve(e, given, given, package_dirs_);
    if (!seen_.insert(path).second)
      file_.refuse(e, "expected each file once, got " + path.string() + " a second time");
    if (seen_.size() > kMostFiles) file_.refuse(e, "expected at most 1000 files");
    std::error_code error;
    const auto size = fs::file_size(path, error);
    if (error || size > kMostBytes - std::min(bytes_, kMostBytes))
      file_.refuse(e, "expected files of at most 64 MiB in all");
    std::string text;
    try {
      text = read_file(file_.function(), path);
    } catch (const Error& failed) {
      file_.refuse(e, failed.what(), failed.kind());
    }
    bytes_ += text.size();
    const XmlFile other(file_.function(), {path.string(), std::move(text), {}}, nullptr);
    Element* const behind = next(e, false);
    Element* const first = file_.replace(e, other);
    return first != nullptr ? first : behind;
  }

  XmlFile& file_;
  const std::span<const fs::path> package_dirs_;
  std::set<fs::path> seen_;
  size_t bytes_;
};

}  // namespace

void include_files(XmlFile& file, std::span<const fs::path> package_dirs) {
  Includer(file, package_dirs).run();
}

}  // namespace novaphy::detail
