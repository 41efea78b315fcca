// Tests of the device text of the engine's kernels that need no device.
#include <gtest/gtest.h>

#include <regex>
#include <set>
#include <sstream>

#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/registry.h"
#include "novaphy/program/emit.h"

namespace novaphy {
namespace {

// Returns the first value that is read without a declaration in scope; empty if all are declared.
std::string undeclared(const std::string& text) {
  static const std::regex declaration(R"(\bv[fib] (v\d+(?:(?:_\w+)?, v\d+)*))");
  static const std::regex name(R"(\bv\d+\b)");
  const auto all = [](const std::string& line, const std::regex& what, int group) {
    std::vector<std::string> found;
    for (std::sregex_iterator m(line.begin(), line.end(), what), end; m != end; ++m)
      found.push_back((*m)[static_cast<size_t>(group)]);
    return found;
  };
  std::vector<std::set<std::string>> scopes(1);
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const size_t equals = line.find(" = ");
    const std::string before = line.substr(0, equals);
    const bool declares = std::regex_search(before, declaration);
    for (const std::string& v : all(declares ? line.substr(before.size()) : line, name, 0)) {
      bool known = false;
      for (const auto& scope : scopes) known = known || scope.count(v) != 0;
      if (!known) return v + " in: " + line;
    }
    if (declares)
      for (const std::string& v : all(before, name, 0)) scopes.back().insert(v);
    for (const char c : line) {
      if (c == '{') scopes.emplace_back();
      if (c == '}' && scopes.size() > 1) scopes.pop_back();
    }
  }
  return {};
}

// With the first items of sums in registers the body of their loop is written twice.
TEST(DeviceText, ReadsNothingBeforeItIsDeclared) {
  size_t loops = 0;
  for (const nova::ir::Program& program : nova::programs_of(diff::engine_kernels())) {
    if (program.loops.empty() || program.loops[0].kind != nova::ir::LoopKind::Csr) continue;
    const std::vector<char> all(program.sources.size(), 1);
    EXPECT_EQ(undeclared(nova::ir::emit_device(program, "f")), "") << program.name;
    EXPECT_EQ(undeclared(nova::ir::emit_device(program, "f", all)), "") << program.name;
    ++loops;
  }
  EXPECT_GT(loops, 5u);
}

}  // namespace
}  // namespace novaphy
