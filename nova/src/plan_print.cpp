#include "plan_print.h"

#include <cstdlib>
#include <map>
#include <sstream>

namespace nova::detail {
namespace {

std::string name_of(const OpList::Op& op) {
  switch (op.kind) {
    case OpList::Op::Kind::Copy:
      return "copy of memory";
    case OpList::Op::Kind::Fill:
      return "fill of memory";
    case OpList::Op::Kind::Launch:
      break;
  }
  return op.name;
}

// Returns the reason why an operation does not run block by block.
std::string reason_of(const OpList::Op& op, std::span<const uint64_t> words,
                      std::span<const MemoryAccess> accesses) {
  std::vector<MemoryAccess> touched;
  if (!touched_by(op, words, accesses, touched)) return "what it touches is not declared";
  if (op.kind == OpList::Op::Kind::Launch) {
    if (op.layout == nullptr || op.layout->of_builtin)
      return "it is no traced kernel, and may touch other rows than its own";
    if (op.active != nullptr) return "the number of its rows is read from memory";
    if (!op.layout->row_local) return "it computes with row numbers, or reads other rows";
  }
  const int64_t rows = rows_of(op), fewest = PlanLimits{}.min_rows;
  if (rows < fewest)
    return "it has " + std::to_string(rows) + " rows, of at least " + std::to_string(fewest);
  return "no neighbor has as many rows and shares memory with it at the own row only";
}

// Returns the names of the operations with their counts, in order of first occurrence.
std::string names(std::span<const OpList::Op> ops) {
  std::vector<std::pair<std::string, size_t>> found;
  for (const OpList::Op& op : ops) {
    const std::string name = name_of(op);
    auto at = found.begin();
    while (at != found.end() && at->first != name) ++at;
    if (at == found.end()) at = found.insert(at, {name, 0});
    ++at->second;
  }
  std::string text;
  for (const auto& [name, count] : found)
    text += (text.empty() ? "" : ", ") + std::to_string(count) + " x " + name;
  return text;
}

}  // namespace

bool prints_plans() {
  const char* wanted = std::getenv("NOVAPHY_PRINT_PLAN");
  return wanted != nullptr && std::string(wanted) == "1";
}

std::string describe_plan(std::span<const OpList::Op> ops, std::span<const PlanPart> parts,
                          std::span<const uint64_t> words, std::span<const MemoryAccess> accesses) {
  std::ostringstream text;
  text << "novaphy: plan of a capture: " << ops.size() << " operations in " << parts.size()
       << " parts\n";
  for (const PlanPart& part : parts) {
    const Segment& s = part.segment;
    const auto own = ops.subspan(s.first, s.last - s.first);
    text << "  operations " << s.first << " to " << s.last - 1 << ": ";
    if (s.n > 0) {
      text << "block by block, " << s.n << " rows, " << s.block_rows << " at a time";
      if (part.scans > 0) text << ", with " << part.scans << " scans over launches of one kernel";
      text << "\n    " << names(own) << "\n";
      continue;
    }
    if (part.phases > 0) {
      text << "in " << part.phases << " phases with a barrier after each\n";
    } else {
      text << "one by one\n";
    }
    std::map<std::string, size_t> lines;
    for (const OpList::Op& op : own)
      ++lines[name_of(op) + ": in no block, because " + reason_of(op, words, accesses)];
    for (const auto& [line, count] : lines) text << "    " << count << " x " << line << "\n";
  }
  return text.str();
}

}  // namespace nova::detail
