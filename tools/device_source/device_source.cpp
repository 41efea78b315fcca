#include "device_source.h"

#include <algorithm>
#include <fstream>
#include <iterator>
#include <optional>
#include <sstream>
#include <stdexcept>

namespace novaphy::device_source {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kMade = "NOVAPHY_MADE_BY_THE_BUILD ";
constexpr std::string_view kInclude = "#include";

bool is_name(char c, bool digits) {
  return (c >= 'a' && c <= 'z') || c == '_' || (digits && c >= '0' && c <= '9');
}

std::string read(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("device_source: cannot read " + path.string());
  return {std::istreambuf_iterator<char>(file), {}};
}

// Returns the name in `#include "NAME"` at the beginning of a line.
std::optional<std::string_view> quoted_include(std::string_view line) {
  constexpr std::string_view begin = "#include \"";
  if (line.substr(0, begin.size()) != begin) return std::nullopt;
  line.remove_prefix(begin.size());
  const size_t end = line.find('"');
  if (end == std::string_view::npos) return std::nullopt;
  return line.substr(0, end);
}

// Returns the name of `"<code>.inc"` if the text begins with such an include, else an empty text.
std::string_view made_code(std::string_view text) {
  const auto name = quoted_include(text);
  constexpr std::string_view suffix = ".inc";
  if (!name || name->size() <= suffix.size()) return {};
  const std::string_view code = name->substr(0, name->size() - suffix.size());
  if (name->substr(code.size()) != suffix) return {};
  return std::all_of(code.begin(), code.end(), [](char c) { return is_name(c, false); })
             ? code
             : std::string_view();
}

void replace_all(std::string& text, std::string_view from, std::string_view to) {
  for (size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
    text.replace(at, from.size(), to);
}

// Returns the text without includes and `#pragma once`. The rest of these lines is removed, too.
std::string without_includes(std::string_view text) {
  std::string result;
  while (!text.empty()) {
    if (const std::string_view code = made_code(text); !code.empty()) {
      result.append(kMade).append(code);
      text.remove_prefix(kInclude.size() + code.size() + std::string_view(" \".inc\"").size());
      continue;
    }
    const bool include = text.substr(0, kInclude.size()) == kInclude;
    const size_t end = text.find('\n');
    if ((include || text.substr(0, 12) == "#pragma once") && end != std::string_view::npos) {
      text.remove_prefix(end + 1);
      continue;
    }
    result.push_back(text.front());
    text.remove_prefix(1);
  }
  return result;
}

// Returns the text without lines `bool operator==(...) const = default;`, which C++17 does not
// have.
std::string without_defaulted_comparisons(std::string_view text) {
  constexpr std::string_view end = " = default;";
  std::string result;
  for (size_t begin = 0; begin <= text.size();) {
    const size_t stop = std::min(text.find('\n', begin), text.size());
    const std::string_view line = text.substr(begin, stop - begin);
    const size_t first = std::min(line.find_first_not_of(' '), line.size());
    const size_t at = line.rfind(end);
    if (begin > 0 && line.substr(first, 15) == "bool operator==" && at != std::string_view::npos) {
      result += line.substr(at + end.size());
    } else {
      if (begin > 0) result += '\n';
      result += line;
    }
    begin = stop + 1;
  }
  return result;
}

void remove_concept(std::string& text) {
  constexpr std::string_view begin = "\ntemplate <class T>\nconcept FormulaScalar = ";
  for (size_t at = 0; (at = text.find(begin, at)) != std::string::npos;) {
    const size_t end = text.find("};", at);
    if (end == std::string::npos) break;
    text.erase(at, end + 2 - at);
  }
}

void append(const fs::path& path, const std::vector<fs::path>& folders, Source& source) {
  if (std::find(source.files.begin(), source.files.end(), path) != source.files.end()) return;
  source.files.push_back(path);
  const std::string text = read(path);
  std::istringstream lines(text);
  int number = 0;
  for (std::string line; std::getline(lines, line);) {
    ++number;
    const auto name = quoted_include(line);
    if (!name || !made_code(line).empty()) continue;
    const auto has = [&](const fs::path& folder) { return fs::exists(folder / *name); };
    const auto folder = std::find_if(folders.begin(), folders.end(), has);
    if (name->substr(0, 8) != "novaphy/" || folder == folders.end())
      throw std::runtime_error(path.string() + ":" + std::to_string(number) +
                               ": expected a header of the folders for devices, as "
                               "\"novaphy/...\", or \"<code>.inc\", got \"" +
                               std::string(*name) + "\"");
    append(*folder / *name, folders, source);
  }
  source.text += device_code(text);
}

// Returns the line for a kernel with its name and words. `text` begins after `NOVAPHY_ROW_KERNEL(`.
std::string kernel_line(std::string_view text, std::string_view kind) {
  const auto take = [&text](auto&& belongs) {
    size_t size = 0;
    while (size < text.size() && belongs(text[size])) ++size;
    const std::string taken(text.substr(0, size));
    text.remove_prefix(size);
    return taken;
  };
  const auto comma = [&text] {
    if (text.substr(0, 2) != ", ") return false;
    text.remove_prefix(2);
    return true;
  };
  const std::string name = take([](char c) { return is_name(c, true); });
  if (name.empty() || !comma()) return {};
  std::string words = take([](char c) { return c >= '0' && c <= '9'; });
  if (words.empty())
    words = "0";
  else if (!comma())
    return {};
  if (text.empty() || text.front() < 'A' || text.front() > 'Z') return {};
  return "// kernel " + name + " " + words + " NOVAPHY_" + std::string(kind) + "\n";
}

// Splits the text at the includes of code that the build makes. Calls plain(text) for each text
// between, and code(name) for each of these includes.
template <class Text, class Code>
void split_at_made_code(std::string_view text, const Text& plain, const Code& code) {
  for (;;) {
    const size_t at = text.find(kMade);
    plain(text.substr(0, at));
    if (at == std::string_view::npos) return;
    text.remove_prefix(at + kMade.size());
    size_t size = 0;
    while (size < text.size() && is_name(text[size], false)) ++size;
    code(text.substr(0, size));
    text.remove_prefix(size);
  }
}

}  // namespace

std::string device_code(std::string_view text) {
  std::string code = without_includes(text);
  replace_all(code, "bool operator==(const Vec3&) const = default;",
              "bool operator==(const Vec3& o) const { return x == o.x && y == o.y && z == o.z; }");
  code = without_defaulted_comparisons(code);
  remove_concept(code);
  replace_all(code, "template <FormulaScalar T>", "template <class T>");
  return code;
}

Source read_source(const fs::path& header, const std::vector<fs::path>& folders) {
  Source source;
  append(header, folders, source);
  return source;
}

std::string kernel_lines(std::string_view text) {
  std::string lines;
  for (size_t at = 0; (at = text.find("\nNOVAPHY_", at)) != std::string_view::npos; ++at) {
    const std::string_view rest = text.substr(at + 9);
    for (const std::string_view kind : {"ROW", "BLOCK", "SHARED_BLOCK"}) {
      const std::string begin = std::string(kind) + "_KERNEL(";
      if (rest.substr(0, begin.size()) == begin)
        lines += kernel_line(rest.substr(begin.size()), kind == "ROW" ? kind : "BLOCK");
    }
  }
  return lines;
}

std::string with_includes(std::string_view text) {
  std::string result;
  split_at_made_code(
      text, [&](std::string_view plain) { result += plain; },
      [&](std::string_view code) { result.append("#include \"").append(code).append(".inc\""); });
  return result;
}

std::string as_literals(std::string_view text) {
  std::string result = "R\"==(";
  split_at_made_code(
      text,
      [&](std::string_view plain) {
        std::string pieces(plain);
        replace_all(pieces, "\n\n", "\n)==\"\n    R\"==(\n");
        result += pieces;
      },
      [&](std::string_view code) {
        result.append(")==\"\n#include \"").append(code).append("_source.inc\"\nR\"==(");
      });
  return result + ")==\"";
}

}  // namespace novaphy::device_source
