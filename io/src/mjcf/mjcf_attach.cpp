#include "mjcf_attach.h"

#include <algorithm>

#include "mjcf_include.h"
#include "novaphy/core/io/file.h"

namespace novaphy::detail {
namespace {

namespace fs = std::filesystem;

constexpr int32_t kMostModels = 1000;
constexpr size_t kMostBytes = size_t{256} << 20;  // for all attached models together

// Prepares an attached file. Only the options of the main file count, so the option sections of the
// attached file are removed.
const XmlFile& prepared(XmlFile& file, std::span<const fs::path> package_dirs) {
  include_files(file, package_dirs);
  for (const char* section : {"option", "keyframe", "custom", "size", "visual", "statistic"})
    while (Element* const e = file.root().FirstChildElement(section)) file.root().DeleteChild(e);
  return file;
}

const char* needed(const MjcfContext& context, const Element& e, const char* name) {
  const char* const given = e.Attribute(name);
  if (given == nullptr) context.file.refuse(e, std::string(name) + ": missing");
  return given;
}

// Reads a file that <model> names. The file must lie in the folder of this file or in a folder next
// to it, so that references of the model cannot reach files elsewhere.
XmlSource read_model(MjcfContext& context, const Element& e) {
  const XmlFile& file = context.file;
  const char* const given = needed(context, e, "file");
  const fs::path path = file.resolve(e, given, given, context.options.package_dirs);
  const fs::path above = path.parent_path().parent_path();
  const auto is_inside = [&](const fs::path& folder) {
    const fs::path relative = above.lexically_relative(folder);
    return !folder.empty() && !relative.empty() && *relative.begin() != "..";
  };
  bool is_allowed = is_inside(context.attaching->top);
  for (const fs::path& folder : context.options.package_dirs)
    is_allowed = is_allowed || is_inside(fs::weakly_canonical(folder));
  if (!is_allowed)
    file.refuse(e, "expected a model in the folder of the file, below it or beside it, got " +
                       path.string());
  for (const MjcfContext* at = &context; at != nullptr; at = at->parent)
    if (at->file.source().folder / fs::path(at->file.source().name).filename() == path)
      file.refuse(e, "expected no model inside of itself, got " + path.string());
  XmlSource source{path.string(), {}, path.parent_path()};
  std::error_code error;
  context.attaching->bytes += fs::file_size(path, error);
  if (error || context.attaching->bytes > kMostBytes)
    file.refuse(e, "expected models of at most 256 MiB in all");
  try {
    source.text = read_file(file.function(), path);
  } catch (const Error& failed) {
    file.refuse(e, failed.what(), failed.kind());
  }
  return source;
}

// Notes further models with a duplicate name. The first model counts, as in MuJoCo.
void note_others(MjcfContext& context, const Element& first, const std::string& name) {
  for (const Element* m = first.NextSiblingElement("model"); m != nullptr;
       m = m->NextSiblingElement("model"))
    if (const char* const own = m->Attribute("name"); own != nullptr && own == name)
      context.notes.ignored(*m, "another model of this name stands before it");
}

// Finds a <model> by its name. A <model> without a name has the name of its file.
std::shared_ptr<MjcfAttached> read_named(MjcfContext& context, const Element& e) {
  const std::string wanted = needed(context, e, "model");
  for (const Element* all = context.file.root().FirstChildElement("asset"); all != nullptr;
       all = all->NextSiblingElement("asset"))
    for (const Element* m = all->FirstChildElement("model"); m != nullptr;
         m = m->NextSiblingElement("model")) {
      const char* const name = m->Attribute("name");
      if (name != nullptr && name != wanted) continue;
      auto read = std::make_shared<MjcfAttached>(context, read_model(context, *m));
      const char* const own = read->file.root().Attribute("model");
      if (name == nullptr && (own == nullptr || own != wanted)) continue;
      note_others(context, *m, wanted);
      return read;
    }
  context.file.refuse(e, "there is no model \"" + wanted + "\" among the assets");
}

}  // namespace

MjcfAttached::MjcfAttached(const MjcfContext& parent, XmlSource source)
    : file(parent.file.function(), std::move(source), "mujoco"),
      context(parent.builder, prepared(file, parent.options.package_dirs), parent.options) {
  context.parent = &parent;
  context.attaching = parent.attaching;
  context.settings.option = parent.settings.option;
}

void attach(MjcfContext& context, const Element& e, BodyPart& to) {
  for (const auto* a = e.FirstAttribute(); a != nullptr; a = a->Next())
    if (const std::string_view name = a->Name();
        name != "model" && name != "body" && name != "prefix")
      context.file.refuse(
          e, "expected the attributes model, body and prefix, got " + std::string(name));
  if (const Element* inner = e.FirstChildElement())
    context.file.refuse(*inner, "expected no element in <attach>");
  if (context.attaching == nullptr) {
    context.attaching = std::make_shared<MjcfAttaching>();
    const fs::path& folder = context.file.source().folder;
    if (!folder.empty()) context.attaching->top = fs::weakly_canonical(folder).parent_path();
  }
  if (++context.attaching->models > kMostModels)
    context.file.refuse(e, "expected at most 1000 models that are attached");
  context.attached.push_back(read_named(context, e));
  MjcfContext& other = context.attached.back()->context;
  const char* const body = e.Attribute("body");
  other.prefix = to.prefix + needed(context, e, "prefix");
  other.suffix = to.suffix;
  other.is_part = body != nullptr;
  other.robot = std::move(context.robot);
  read_others(other);
  BodyPart part = to;
  part.prefix = other.prefix;
  if (!read_attached(other, body, part))
    context.file.refuse(
        e, "there is no body \"" + std::string(body) + "\" in " + other.file.source().name);
  to.geoms = part.geoms;
  context.robot = std::move(other.robot);

  const auto merge = [&](auto& all, const auto& more) {
    for (const auto& item : more)
      if (!all.insert(item).second) {
        std::string name;
        if constexpr (requires { item.first; })
          name = item.first;
        else
          name = item;
        context.file.refuse(e, "expected different names, got \"" + name + "\" twice");
      }
  };
  merge(context.bodies, other.bodies);
  merge(context.joints, other.joints);
  merge(context.geoms, other.geoms);
  merge(context.sites, other.sites);
  context.lights.insert(other.lights.begin(), other.lights.end());
  context.cameras.insert(other.cameras.begin(), other.cameras.end());
  context.joint_order.insert(context.joint_order.end(), other.joint_order.begin(),
                             other.joint_order.end());
}

void finish_attached(MjcfContext& context) {
  for (const auto& each : context.attached) {
    MjcfContext& other = each->context;
    other.robot = std::move(context.robot);
    read_contacts(other);
    read_actuators(other);
    finish_attached(other);
    context.robot = std::move(other.robot);
    for (MjcfActuator& a : other.actuators) {
      for (const MjcfActuator& b : context.actuators)
        if (a.args.law.label == b.args.law.label)
          context.file.refuse(context.file.root(), "expected different names of actuators, got \"" +
                                                       a.args.law.label + "\" twice");
      context.actuators.push_back(std::move(a));
    }
    const auto append = [](auto& to, auto& from) {
      to.insert(to.end(), std::make_move_iterator(from.begin()),
                std::make_move_iterator(from.end()));
    };
    append(context.equalities, other.equalities);
    append(context.tendons, other.tendons);
    append(context.height_fields, other.height_fields);
    append(context.sensors, other.sensors);
    append(context.refused, other.refused);
    context.notes.add(other.notes.take());
  }
}

}  // namespace novaphy::detail
