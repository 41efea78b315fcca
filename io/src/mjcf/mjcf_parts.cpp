// Reads equalities, tendons, height fields and sensors of MJCF files without interpreting them.
#include <algorithm>
#include <cstring>

#include "mjcf_context.h"
#include "novaphy/core/io/file.h"

namespace novaphy::detail {
namespace {

constexpr std::string_view kNames[] = {"body",  "actuator", "camera",  "objname", "refname",
                                       "body1", "body2",    "joint1",  "joint2",  "joint",
                                       "site1", "site2",    "site",    "geom1",   "geom2",
                                       "geom",  "tendon1",  "tendon2", "sidesite"};
constexpr std::string_view kNumbers[] = {"cutoff",         "noise",          "anchor",
                                         "relpose",        "polycoef",       "torquescale",
                                         "solref",         "solimp",         "range",
                                         "frictionloss",   "damping",        "stiffness",
                                         "springlength",   "width",          "margin",
                                         "armature",       "solreflimit",    "solimplimit",
                                         "solreffriction", "solimpfriction", "actuatorfrcrange",
                                         "coef",           "divisor",        "size",
                                         "elevation",      "nrow",           "ncol"};
constexpr std::string_view kWords[] = {
    "objtype", "reftype", "datatype", "active", "limited", "actuatorfrclimited", "file"};

}  // namespace

RobotPart read_part(const MjcfContext& context, const Element& e) {
  RobotPart part{.kind = e.Name()};
  const auto text = [&](std::string_view name) {
    return context.defaults.text(e, std::string(name).c_str(), {});
  };
  if (const char* name = e.Attribute("name")) part.name = context.named(name);
  for (const std::string_view name : kNames)
    if (const auto given = text(name)) part.names[std::string(name)] = context.named(*given);
  for (const std::string_view name : kWords)
    if (const auto given = text(name)) part.names[std::string(name)] = *given;
  for (const std::string_view name : kNumbers)
    if (const auto given = text(name))
      part.numbers[std::string(name)] = context.file.parse(e, std::string(name).c_str(), *given);
  for (const Element* c = e.FirstChildElement(); c != nullptr; c = c->NextSiblingElement())
    part.parts.push_back(read_part(context, *c));
  return part;
}

// Reads a height field in MuJoCo's binary format: two counts, then elevations as float32. Other
// files are images.
RobotPart read_height_field(const MjcfContext& context, const Element& e) {
  RobotPart part = read_part(context, e);
  const auto file = part.names.find("file");
  if (file == part.names.end()) return part;
  if (part.name.empty()) part.name = context.named(std::filesystem::path(file->second).stem());
  if (file->second.ends_with(".png")) return part;
  const std::filesystem::path path =
      context.file.resolve(e, (context.settings.compiler.mesh_folder / file->second).string(),
                           file->second, context.options.package_dirs);
  const std::string bytes = read_file(context.file.function(), path);
  int32_t counts[2] = {};
  if (bytes.size() >= sizeof counts) std::memcpy(counts, bytes.data(), sizeof counts);
  const int64_t numbers = int64_t{counts[0]} * counts[1];
  if (counts[0] < 1 || counts[1] < 1 ||
      static_cast<int64_t>(bytes.size()) != static_cast<int64_t>(sizeof counts) + 4 * numbers)
    context.file.refuse(e, "file: expected a whole height field of MuJoCo: " + path.string());
  std::vector<float> values(static_cast<size_t>(numbers));
  std::memcpy(values.data(), bytes.data() + sizeof counts, 4 * values.size());
  part.numbers["nrow"] = {static_cast<double>(counts[0])};
  part.numbers["ncol"] = {static_cast<double>(counts[1])};
  part.numbers["elevation"] = {values.begin(), values.end()};
  return part;
}

}  // namespace novaphy::detail
