#include "glb.h"

#include <charconv>
#include <cmath>
#include <cstring>
#include <map>
#include <variant>

#include "novaphy/core/error.h"
#include "novaphy/math/functions.h"

namespace novaphy::detail {
namespace {

// A JSON value. The values null, false and true are all stored as null.
struct Json {
  std::variant<std::monostate, double, std::string, std::vector<Json>, std::map<std::string, Json>>
      value = {};
};

class JsonReader {
 public:
  JsonReader(const std::string& where, std::string_view text) : where_(where), text_(text) {}
  Json read() {
    Json value = read_value(0);
    skip();
    expect(at_ == text_.size());
    return value;
  }

 private:
  void expect(bool good) const {
    require(good, ErrorKind::Value, where_, ": expected JSON, at byte ", at_, " of its text");
  }
  void skip() {
    while (at_ < text_.size() && std::strchr(" \t\r\n", text_[at_]) != nullptr && text_[at_] != 0)
      ++at_;
  }
  bool take(char c) {
    skip();
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }
  std::string read_string() {
    expect(take('"'));
    std::string text;
    while (at_ < text_.size() && text_[at_] != '"') {
      if (text_[at_] == '\\') ++at_;  // names that the reader needs have no escapes
      expect(at_ < text_.size());
      text.push_back(text_[at_++]);
    }
    expect(take('"'));
    return text;
  }
  Json read_value(int depth) {
    expect(depth < 64);
    skip();
    if (take('[')) {
      std::vector<Json> all;
      if (take(']')) return {all};
      do all.push_back(read_value(depth + 1));
      while (take(','));
      expect(take(']'));
      return {std::move(all)};
    }
    if (take('{')) {
      std::map<std::string, Json> all;
      if (take('}')) return {all};
      do {
        std::string name = read_string();
        expect(take(':'));
        all[std::move(name)] = read_value(depth + 1);
      } while (take(','));
      expect(take('}'));
      return {std::move(all)};
    }
    if (at_ < text_.size() && text_[at_] == '"') return {read_string()};
    for (const std::string_view word : {"null", "true", "false"})
      if (text_.substr(at_).starts_with(word)) {
        at_ += word.size();
        return {};
      }
    double number = 0.0;
    const auto [end, error] =
        std::from_chars(text_.data() + at_, text_.data() + text_.size(), number);
    expect(error == std::errc());
    at_ = static_cast<size_t>(end - text_.data());
    return {number};
  }

  const std::string& where_;
  std::string_view text_;
  size_t at_ = 0;
};

using Matrix = std::array<double, 16>;  // column-major

Matrix multiply(const Matrix& a, const Matrix& b) {
  Matrix c{};
  for (size_t i = 0; i < 4; ++i)
    for (size_t j = 0; j < 4; ++j)
      for (size_t k = 0; k < 4; ++k) c[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return c;
}

class GlbReader {
 public:
  GlbReader(const std::string& where, std::string_view bytes) : where_(where) {
    expect(bytes.size() >= 20 && bytes.substr(0, 4) == "glTF" && word(bytes, 4) == 2 &&
               word(bytes, 8) <= bytes.size(),
           "a whole .glb file of version 2");
    bytes = bytes.substr(0, word(bytes, 8));
    for (size_t at = 12; at + 8 <= bytes.size();) {
      const size_t size = word(bytes, at);
      const std::string_view kind = bytes.substr(at + 4, 4);
      expect(size <= bytes.size() - at - 8, "a whole .glb file");
      const std::string_view chunk = bytes.substr(at + 8, size);
      if (kind == "JSON") json_ = JsonReader(where, chunk).read();
      if (kind.substr(0, 3) == "BIN") data_ = chunk;
      at += 8 + size;
    }
  }

  Soup read() {
    const auto scene = static_cast<size_t>(number(json_, "scene", 0.0));
    const Json* const root = entry("scenes", scene);
    Matrix identity{};
    for (size_t k = 0; k < 4; ++k) identity[5 * k] = 1.0;
    if (const Json* nodes = member(*root, "nodes"))
      for (const Json& node : list(*nodes)) add_node(index(node), identity, 0);
    return std::move(soup_);
  }

 private:
  void expect(bool good, const char* what) const {
    require(good, ErrorKind::Value, where_, ": expected ", what);
  }
  static uint32_t word(std::string_view bytes, size_t at) {
    uint32_t value = 0;
    std::memcpy(&value, bytes.data() + at, sizeof(value));
    return value;
  }
  const Json* member(const Json& of, const char* name) const {
    const auto* all = std::get_if<std::map<std::string, Json>>(&of.value);
    expect(all != nullptr, "JSON objects of glTF");
    const auto found = all->find(name);
    return found == all->end() ? nullptr : &found->second;
  }
  const std::vector<Json>& list(const Json& value) const {
    const auto* all = std::get_if<std::vector<Json>>(&value.value);
    expect(all != nullptr, "JSON lists of glTF");
    return *all;
  }
  double to_number(const Json& value) const {
    const auto* number = std::get_if<double>(&value.value);
    expect(number != nullptr, "JSON numbers of glTF");
    return *number;
  }
  double number(const Json& of, const char* name, double otherwise) const {
    const Json* const value = member(of, name);
    return value == nullptr ? otherwise : to_number(*value);
  }
  size_t index(const Json& value) const {
    const double n = to_number(value);
    expect(n >= 0.0 && n < 2147483648.0, "whole numbers in the JSON of glTF");
    return static_cast<size_t>(n);
  }
  size_t size_of(const Json& of, const char* name) const {
    const Json* const value = member(of, name);
    return value == nullptr ? 0 : index(*value);
  }
  const Json* entry(const char* of, size_t k) const {
    const Json* const all = member(json_, of);
    expect(all != nullptr && k < list(*all).size(), "indices of parts that the file has");
    return &list(*all)[k];
  }
  template <size_t N>
  bool numbers(const Json& of, const char* name, std::array<double, N>& to) const {
    const Json* const value = member(of, name);
    if (value == nullptr) return false;
    expect(list(*value).size() == N, "as many numbers as glTF defines");
    for (size_t k = 0; k < N; ++k) to[k] = to_number(list(*value)[k]);
    return true;
  }

  void add_node(size_t k, const Matrix& outer, int depth) {
    expect(depth < 100 && ++nodes_ < 100000, "nodes that make a tree");
    const Json& node = *entry("nodes", k);
    Matrix local{};
    if (!numbers(node, "matrix", local)) {
      std::array<double, 3> p{}, s = {1.0, 1.0, 1.0};
      std::array<double, 4> q = {0.0, 0.0, 0.0, 1.0};
      numbers(node, "translation", p);
      numbers(node, "scale", s);
      numbers(node, "rotation", q);
      for (size_t axis = 0; axis < 3; ++axis) {
        const Vec3<double> unit = {axis == 0 ? 1.0 : 0.0, axis == 1 ? 1.0 : 0.0,
                                   axis == 2 ? 1.0 : 0.0};
        const Vec3<double> v = math::rotate(Quat<double>{q[0], q[1], q[2], q[3]}, unit);
        local[4 * axis] = v.x * s[axis];
        local[4 * axis + 1] = v.y * s[axis];
        local[4 * axis + 2] = v.z * s[axis];
        local[12 + axis] = p[axis];
      }
      local[15] = 1.0;
    }
    const Matrix pose = multiply(outer, local);
    if (const Json* mesh = member(node, "mesh")) {
      const Json* const primitives = member(*entry("meshes", index(*mesh)), "primitives");
      expect(primitives != nullptr, "meshes with primitives");
      for (const Json& primitive : list(*primitives)) add_primitive(primitive, pose);
    }
    if (const Json* children = member(node, "children"))
      for (const Json& child : list(*children)) add_node(index(child), pose, depth + 1);
  }

  // Returns the color of a primitive's material, or nothing if the material has an image. The file
  // has linear colors, which are converted to sRGB, as viewers show them.
  std::optional<Vec3f> color_of(const Json& primitive) const {
    const Json* const number = member(primitive, "material");
    if (number == nullptr) return std::nullopt;
    const Json* const look = member(*entry("materials", index(*number)), "pbrMetallicRoughness");
    std::array<double, 4> c{};
    if (look == nullptr || member(*look, "baseColorTexture") != nullptr ||
        !numbers(*look, "baseColorFactor", c))
      return std::nullopt;
    for (double& x : c) x = x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1.0 / 2.4) - 0.055;
    return Vec3f{static_cast<float>(c[0]), static_cast<float>(c[1]), static_cast<float>(c[2])};
  }

  struct Rows {
    const char* first;
    size_t count, stride;
  };
  // Returns the rows of an accessor. `width`: numbers per row.
  Rows rows(const Json& accessor, size_t bytes) const {
    const Json* const view = member(accessor, "bufferView");
    require(view != nullptr && member(accessor, "sparse") == nullptr, ErrorKind::NotImplemented,
            where_, ": sparse data of glTF is not read");
    const Json& part = *entry("bufferViews", index(*view));
    require(size_of(part, "buffer") == 0 && !data_.empty(), ErrorKind::NotImplemented, where_,
            ": data outside of the file is not read");
    const size_t begin = size_of(part, "byteOffset"), length = size_of(part, "byteLength");
    const size_t offset = size_of(accessor, "byteOffset"), count = size_of(accessor, "count");
    size_t stride = size_of(part, "byteStride");
    if (stride == 0) stride = bytes;
    expect(begin <= data_.size() && length <= data_.size() - begin, "data that is all there");
    expect(count > 0 && offset <= length && length - offset >= bytes &&
               (length - offset - bytes) / stride >= count - 1,
           "data that is all there");
    return {data_.data() + begin + offset, count, stride};
  }

  void add_primitive(const Json& primitive, const Matrix& pose) {
    require(number(primitive, "mode", 4.0) == 4.0, ErrorKind::NotImplemented, where_,
            ": primitives of glTF other than triangles are not read");
    const Json* const attributes = member(primitive, "attributes");
    const Json* const position = attributes == nullptr ? nullptr : member(*attributes, "POSITION");
    if (position == nullptr) return;
    const Json& accessor = *entry("accessors", index(*position));
    expect(number(accessor, "componentType", 0.0) == 5126.0, "positions of float32");
    const Rows points = rows(accessor, 3 * sizeof(float));
    const auto point = [&](size_t k) {
      expect(k < points.count, "indices of vertices that the file has");
      float v[3];
      std::memcpy(v, points.first + k * points.stride, sizeof(v));
      float out[3];
      for (size_t i = 0; i < 3; ++i)
        out[i] = static_cast<float>(pose[i] * double{v[0]} + pose[4 + i] * double{v[1]} +
                                    pose[8 + i] * double{v[2]} + pose[12 + i]);
      return Vec3f{out[0], out[1], out[2]};
    };
    const Json* const given = member(primitive, "indices");
    size_t count = points.count, bytes = 0;
    Rows corners{};
    if (given != nullptr) {
      const Json& of = *entry("accessors", index(*given));
      const double type = number(of, "componentType", 0.0);
      bytes = type == 5121.0 ? 1 : type == 5123.0 ? 2 : type == 5125.0 ? 4 : 0;
      expect(bytes != 0, "indices of whole numbers");
      corners = rows(of, bytes);
      count = corners.count;
    }
    expect(count % 3 == 0, "three corners of a triangle");
    const auto corner = [&](size_t k) {
      if (bytes == 0) return point(k);
      uint32_t at = 0;  // little endian, as in the file
      std::memcpy(&at, corners.first + k * corners.stride, bytes);
      return point(at);
    };
    const std::optional<Vec3f> color = color_of(primitive);
    for (size_t k = 0; k < count; k += 3)
      soup_.add({corner(k), corner(k + 1), corner(k + 2)}, color);
  }

  const std::string& where_;
  Json json_ = {std::map<std::string, Json>{}};
  std::string_view data_;
  Soup soup_;
  int nodes_ = 0;
};

}  // namespace

Soup read_glb(const std::string& where, std::string_view bytes) {
  return GlbReader(where, bytes).read();
}

}  // namespace novaphy::detail
