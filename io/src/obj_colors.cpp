#include "obj_colors.h"

#include <set>
#include <sstream>

#include "novaphy/core/io/file.h"

namespace novaphy::detail {
namespace {

constexpr std::uintmax_t kLargest = 1 << 20;  // bytes

// Returns the rest of the line without blanks at its beginning and end.
std::string rest_of(std::istream& line) {
  std::string text;
  std::getline(line >> std::ws, text);
  text.erase(text.find_last_not_of(" \t\r\n") + 1);
  return text;
}

std::string library_of(std::string_view bytes) {
  constexpr std::string_view kWord = "mtllib";
  for (size_t at = bytes.find(kWord); at != std::string_view::npos;
       at = bytes.find(kWord, at + kWord.size())) {
    if (at != 0 && bytes[at - 1] != '\n' && bytes[at - 1] != '\r') continue;
    at += kWord.size();
    std::istringstream line(std::string(bytes.substr(at, bytes.find_first_of("\r\n", at) - at)));
    return rest_of(line);
  }
  return {};
}

}  // namespace

Colors obj_colors(const std::filesystem::path& folder, std::string_view bytes) {
  const std::filesystem::path name = library_of(bytes);
  const std::filesystem::path path = folder / name.filename();
  std::error_code error;
  if (name.empty() || !std::filesystem::is_regular_file(path, error) ||
      std::filesystem::file_size(path, error) > kLargest)
    return {};
  Colors colors;
  std::istringstream text(read_file("load_mesh", path));
  std::set<std::string> images;
  std::string line, word, material;
  while (std::getline(text, line)) {
    std::istringstream words(line);
    Vec3f c;
    if (!(words >> word)) continue;
    if (word == "newmtl")
      material = rest_of(words);
    else if (word == "Kd" && words >> c.x >> c.y >> c.z)
      colors[material] = c;
    else if (word == "map_Kd")
      images.insert(material);
  }
  std::erase_if(colors, [&](const auto& item) { return images.contains(item.first); });
  return colors;
}

}  // namespace novaphy::detail
