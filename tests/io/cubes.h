// The unit cube in all formats that load_mesh reads, as the bytes of a file: 8 corners, 12
// triangles or 6 squares, counter-clockwise from outside, volume 1. For tests.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <string>

namespace novaphy::testing {

inline constexpr std::array<std::array<int, 4>, 6> kSquares = {
    {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}}};

// Corner n of the cube is the bits of n: x, y, z.
inline std::string corner_text(int n) {
  return std::to_string(n & 1) + " " + std::to_string(n >> 1 & 1) + " " + std::to_string(n >> 2);
}

inline std::string cube_obj() {
  std::string text = "# the unit cube\n";
  for (int n = 0; n < 8; ++n) text += "v " + corner_text(n) + "\n";
  for (const auto& square : kSquares) {
    text += "f";
    for (const int n : square) text += " " + std::to_string(n + 1);
    text += "\n";
  }
  return text;
}

// Calls visit(a, b, c) for the two triangles of each square.
template <class Visit>
void for_each_triangle(const Visit& visit) {
  for (const auto& [a, b, c, d] : kSquares) {
    visit(a, b, c);
    visit(a, c, d);
  }
}

inline std::string cube_stl() {
  std::string text = "solid cube\n";
  for_each_triangle([&](int a, int b, int c) {
    text += "facet normal 0 0 0\n outer loop\n";
    for (const int n : {a, b, c}) text += "  vertex " + corner_text(n) + "\n";
    text += " endloop\nendfacet\n";
  });
  return text + "endsolid cube\n";
}

inline std::string cube_binary_stl() {
  std::string bytes(80, ' ');
  const auto append = [&bytes](const auto& value) {
    char raw[sizeof(value)];
    std::memcpy(raw, &value, sizeof(value));  // little endian, as the tested machines are
    bytes.append(raw, sizeof(value));
  };
  append(uint32_t{12});
  for_each_triangle([&](int a, int b, int c) {
    for (int k = 0; k < 3; ++k) append(0.0f);
    for (const int n : {a, b, c})
      for (const int x : {n & 1, n >> 1 & 1, n >> 2}) append(static_cast<float>(x));
    append(uint16_t{0});
  });
  return bytes;
}

inline std::string cube_ply() {
  std::string text =
      "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\n"
      "property float z\nelement face 6\nproperty list uchar int vertex_indices\nend_header\n";
  for (int n = 0; n < 8; ++n) text += corner_text(n) + "\n";
  for (const auto& square : kSquares) {
    text += "4";
    for (const int n : square) text += " " + std::to_string(n);
    text += "\n";
  }
  return text;
}

inline std::string cube_binary_ply(bool big_endian) {
  std::string bytes = cube_ply();
  bytes.resize(bytes.find("end_header") + 11);
  bytes.replace(bytes.find("ascii"), 5, big_endian ? "binary_big_endian" : "binary_little_endian");
  const auto append = [&](const auto& value) {
    char raw[sizeof(value)];
    std::memcpy(raw, &value, sizeof(value));
    if (big_endian) std::reverse(raw, raw + sizeof(value));
    bytes.append(raw, sizeof(value));
  };
  for (int n = 0; n < 8; ++n)
    for (const int x : {n & 1, n >> 1 & 1, n >> 2}) append(static_cast<float>(x));
  for (const auto& square : kSquares) {
    append(uint8_t{4});
    for (const int32_t n : square) append(n);
  }
  return bytes;
}

// `asset`: the unit and the up axis; `nodes`: the scene, instances of #cube.
inline std::string cube_dae(const std::string& asset, const std::string& nodes) {
  std::string positions, corners, counts;
  for (int n = 0; n < 8; ++n) positions += corner_text(n) + " ";
  for (const auto& square : kSquares) {
    counts += "4 ";
    for (const int n : square) corners += std::to_string(n) + " ";
  }
  return R"(<?xml version="1.0" encoding="utf-8"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset>)" +
         asset + R"(</asset>
<library_geometries><geometry id="cube"><mesh>
<source id="p"><float_array id="pa" count="24">)" +
         positions + R"(</float_array>
<technique_common><accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="6"><input semantic="VERTEX" source="#v" offset="0"/><vcount>)" +
         counts + "</vcount><p>" + corners +
         R"(</p></polylist></mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="scene">)" +
         nodes + R"(</visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#scene"/></scene></COLLADA>
)";
}
inline const std::string kCubeNode = "<node><instance_geometry url=\"#cube\"/></node>";
inline const std::string kMetresZUp = "<unit meter=\"1\"/><up_axis>Z_UP</up_axis>";

}  // namespace novaphy::testing
