#include "notes.h"

namespace novaphy::detail {

void set_report(RobotImport& result, RobotReport report) {
  struct Group {
    std::string text;
    size_t count;
  };
  std::vector<Group> groups;
  std::map<std::string, size_t> known;  // index of the group with this text
  const auto add = [&](const RobotNote& note, const char* prefix) {
    const std::string text = prefix + note.text;
    const auto [at, is_new] = known.emplace(text, groups.size());
    if (is_new)
      groups.push_back(
          {note.file + ":" + std::to_string(note.line) + ": " + note.element + ": " + text, 0});
    ++groups[at->second].count;
  };
  for (const RobotNote& note : report.left_out) add(note, "left out: ");
  for (const RobotNote& note : report.mended) add(note, "");
  for (const RobotNote& note : report.ignored) add(note, "");
  for (Group& group : groups) {
    if (group.count > 1) group.text += " (and " + std::to_string(group.count - 1) + " more)";
    result.warnings.push_back(std::move(group.text));
  }
  result.report = std::move(report);
}

}  // namespace novaphy::detail
