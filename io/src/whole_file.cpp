#include "whole_file.h"

#include <algorithm>
#include <charconv>
#include <vector>

#include "novaphy/core/error.h"

namespace novaphy::detail {
namespace {

struct Property {
  bool is_list = false;
  size_t count_size = 0;  // bytes of the length of a list; 0: not a list
  size_t size = 0;        // bytes of a value
};
struct Element {
  size_t rows = 0;
  std::vector<Property> properties;
};
struct PlyHeader {
  std::string format;
  std::vector<Element> elements;
  std::string_view body;
};

// Removes the first line from the text and returns it without its end.
std::string_view take_line(std::string_view& text) {
  const size_t end = std::min(text.find('\n'), text.size());
  std::string_view line = text.substr(0, end);
  text.remove_prefix(std::min(end + 1, text.size()));
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line;
}

// Splits a line into words. The memory of `words` is reused.
void split(std::string_view line, std::vector<std::string_view>& words) {
  const auto is_blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  words.clear();
  for (size_t at = 0; at < line.size();) {
    size_t end = at;
    while (end < line.size() && !is_blank(line[end])) ++end;
    if (end > at) words.push_back(line.substr(at, end - at));
    at = end + 1;
  }
}
std::vector<std::string_view> split(std::string_view line) {
  std::vector<std::string_view> words;
  split(line, words);
  return words;
}

size_t size_of_type(std::string_view type) {
  for (const std::string_view name : {"char", "uchar", "int8", "uint8"})
    if (type == name) return 1;
  for (const std::string_view name : {"short", "ushort", "int16", "uint16"})
    if (type == name) return 2;
  for (const std::string_view name : {"int", "uint", "int32", "uint32", "float", "float32"})
    if (type == name) return 4;
  return type == "double" || type == "float64" ? 8 : 0;
}

PlyHeader read_ply_header(const std::string& where, std::string_view bytes) {
  PlyHeader header;
  for (size_t number = 1; !bytes.empty(); ++number) {
    const std::vector<std::string_view> words = split(take_line(bytes));
    const auto check = [&](bool condition, const char* expected) {
      require(condition, ErrorKind::Value, where, ":", number, ": expected ", expected);
    };
    if (number == 1) check(words.size() == 1 && (words[0] == "ply" || words[0] == "PLY"), "ply");
    if (words.empty()) continue;
    if (words[0] == "end_header") {
      header.body = bytes;
      check(!header.format.empty(), "a line with the format before the end of the header");
      return header;
    }
    if (words[0] == "format") {
      check(words.size() == 3, "format, its name and 1.0");
      header.format = words[1];
      check(header.format == "ascii" || header.format == "binary_little_endian" ||
                header.format == "binary_big_endian",
            "format ascii, binary_little_endian or binary_big_endian");
    } else if (words[0] == "element") {
      check(words.size() == 3, "element, its name and a number");
      Element element;
      const char* const end = words[2].data() + words[2].size();
      const auto parsed = std::from_chars(words[2].data(), end, element.rows);
      check(parsed.ec == std::errc() && parsed.ptr == end, "element, its name and a number");
      header.elements.push_back(element);
    } else if (words[0] == "property") {
      const bool is_list = words.size() == 5 && words[1] == "list";
      check(!header.elements.empty() && (is_list || words.size() == 3),
            "property, its type and name, or property list, its types and name, in an element");
      const Property property = {is_list, is_list ? size_of_type(words[2]) : 0,
                                 size_of_type(words[is_list ? 3 : 1])};
      check(property.size > 0 && (!is_list || (property.count_size > 0 && property.count_size < 8)),
            "a type of PLY, char to double");
      header.elements.back().properties.push_back(property);
    }
  }
  fail(ErrorKind::Value, where, ": expected end_header, got the end of the file");
}

// Reads the length of a list, a number of 1, 2 or 4 bytes. A negative length becomes larger than
// any file.
size_t read_length(std::string_view bytes, bool big_endian) {
  size_t value = 0;
  for (size_t n = 0; n < bytes.size(); ++n)
    value |= size_t{static_cast<unsigned char>(bytes[big_endian ? bytes.size() - 1 - n : n])}
             << (8 * n);
  return value;
}

// Removes `count` values of `size` bytes from the body. Returns false if the body has fewer bytes.
bool take(std::string_view& body, size_t count, size_t size) {
  if (count > body.size() / size) return false;
  body.remove_prefix(count * size);
  return true;
}

// Removes the rows of an element from a binary body. Returns false if the body has fewer rows.
bool take_rows(std::string_view& body, const Element& element, bool big_endian) {
  const bool has_list = std::any_of(element.properties.begin(), element.properties.end(),
                                    [](const Property& p) { return p.is_list; });
  size_t row_size = 0;
  for (const Property& p : element.properties) row_size += p.size;
  if (!has_list) return row_size == 0 || take(body, element.rows, row_size);
  for (size_t row = 0; row < element.rows; ++row)
    for (const Property& p : element.properties) {
      size_t count = 1;
      if (p.is_list) {
        if (body.size() < p.count_size) return false;
        count = read_length(body.substr(0, p.count_size), big_endian);
        body.remove_prefix(p.count_size);
      }
      if (!take(body, count, p.size)) return false;
    }
  return true;
}

// Removes `rows` lines from a text body. Returns false if the body has fewer lines.
bool take_lines(std::string_view& body, size_t rows) {
  for (; rows > 0; --rows) {
    while (!body.empty() && split(body.substr(0, body.find('\n'))).empty()) take_line(body);
    if (body.empty()) return false;
    take_line(body);
  }
  return true;
}

void check_ply(const std::string& where, std::string_view bytes) {
  const PlyHeader header = read_ply_header(where, bytes);
  std::string_view body = header.body;
  for (size_t n = 0; n < header.elements.size(); ++n) {
    const Element& element = header.elements[n];
    const bool whole = header.format == "ascii"
                           ? take_lines(body, element.rows)
                           : take_rows(body, element, header.format == "binary_big_endian");
    require(whole, ErrorKind::Value, where, ": expected ", element.rows, " rows of element ", n,
            ", as the header says, got the end of the file");
  }
}

void check_stl(const std::string& where, std::string_view bytes) {
  constexpr size_t kHeader = 84, kTriangle = 50;
  if (bytes.size() >= kHeader) {
    const size_t count = read_length(bytes.substr(kHeader - 4, 4), false);
    if (bytes.size() == kHeader + count * kTriangle) return;  // a binary file that is complete
  }
  require(!bytes.starts_with("solid") || bytes.find("endsolid") != std::string_view::npos,
          ErrorKind::Value, where, ": expected endsolid, got the end of the file");
}

bool is_of_integers(char c) {
  return (c >= '0' && c <= '9') || c == ' ' || c == '\n' || c == '\t' || c == '\r' || c == '+' ||
         c == '-';
}

void check_dae(const std::string& where, std::string_view bytes) {
  for (size_t at = bytes.find("<p"); at != std::string_view::npos; at = bytes.find("<p", at)) {
    at += 2;
    if (bytes.substr(at, 1).find_first_of("> \t\r\n") != 0) continue;  // a longer name
    at = std::min(bytes.find('>', at), bytes.size() - 1) + 1;
    const std::string_view text = bytes.substr(at, bytes.find('<', at) - at);
    const auto bad = std::ranges::find_if_not(text, is_of_integers);
    if (bad == text.end()) continue;
    const size_t place = at + static_cast<size_t>(bad - text.begin());
    fail(ErrorKind::Value, where, ":", 1 + std::ranges::count(bytes.substr(0, place), '\n'),
         ": expected whole numbers in <p>");
  }
}

bool is_number(std::string_view word) {
  if (word.starts_with('+')) word.remove_prefix(1);
  double value = 0.0;
  const char* const end = word.data() + word.size();
  const auto parsed = std::from_chars(word.data(), end, value);
  return parsed.ec != std::errc::invalid_argument && parsed.ptr == end;
}

}  // namespace

std::string obj_for_assimp(const std::string& where, std::string_view bytes) {
  if (bytes.starts_with("\xEF\xBB\xBF")) bytes.remove_prefix(3);
  std::string text, line;
  std::vector<std::string_view> words;
  text.reserve(bytes.size() + bytes.size() / 8);
  size_t next = 1;
  while (!bytes.empty()) {
    const size_t number = next;
    for (line.clear(); !bytes.empty();) {  // a line goes on after a backslash at its end
      size_t end = 0;
      while (end < bytes.size() && bytes[end] != '\n' && bytes[end] != '\r') ++end;
      line.append(bytes.substr(0, end));
      const bool two = bytes.substr(end).starts_with("\r\n");
      bytes.remove_prefix(std::min(end + (two ? 2 : 1), bytes.size()));
      ++next;
      if (!line.ends_with('\\')) break;
      line.back() = ' ';
    }
    line.erase(0, line.find_first_not_of(" \t"));
    if (!line.starts_with('v')) {
      if (line.starts_with("f ") || line.starts_with("f\t"))
        line.resize(std::min(line.find('#'), line.size()));
      if (!line.starts_with("mtllib")) text.append(line).push_back('\n');
      continue;
    }
    if (line.size() > 1 && (line[1] == 'n' || line[1] == 't'))
      continue;  // normals and texture coordinates are skipped
    split(std::string_view(line).substr(0, line.find('#')), words);
    if (words.empty() || words[0] != "v") continue;
    const size_t numbers = words.size() - 1;
    require((numbers == 3 || numbers == 4 || numbers == 6 || numbers == 7) &&
                std::all_of(words.begin() + 1, words.end(), is_number),
            ErrorKind::Value, where, ":", number,
            ": expected v and 3 numbers, or 4, 6 or 7 with w, r g b or r g b a behind");
    text.push_back('v');
    for (size_t k = 1; k <= (numbers == 4 ? 4u : 3u); ++k) {
      std::string_view word = words[k];
      text.push_back(' ');
      if (word.starts_with('-') || word.starts_with('+')) {
        text.push_back(word[0]);
        word.remove_prefix(1);
      }
      if (word.starts_with('.')) text.push_back('0');
      text.append(word);
    }
    text.push_back('\n');
  }
  return text;
}

void check_whole(const std::string& where, std::string_view extension, std::string_view bytes) {
  if (extension == ".ply") check_ply(where, bytes);
  if (extension == ".stl") check_stl(where, bytes);
  if (extension == ".dae") check_dae(where, bytes);
}

}  // namespace novaphy::detail
