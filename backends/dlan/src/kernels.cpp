#include "kernels.h"

#include <dlfcn.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <set>
#include <sstream>
#include <tuple>
#include <vector>

#include "ahead.h"
#include "device_source.h"

namespace novaphy::gpu {
namespace {

// Replaces a code image: a pointer to stubs, or a shared library in memory.
struct Code {
  char magic[8];
  uint64_t value;  // kStubs: address of the stubs; kLibrary: number of bytes that follow
};
constexpr char kStubs[8] = "NVPSTUB", kLibrary[8] = "NVPLIBR";

// A loaded module: its stubs, and the shared library that has them.
struct StubLibrary {
  const Stub* stubs;
  void* library;  // null: the stubs are in the library of all modules
};

struct Kernels {
  std::string problem;
  const void* fill = nullptr;
  std::vector<unsigned char> ahead;
};

std::string default_path() {
  if (const char* path = std::getenv("NOVAPHY_DLAN_KERNELS"); path != nullptr && *path != '\0')
    return path;
  Dl_info own{};
  if (dladdr(reinterpret_cast<const void*>(&kernels_problem), &own) == 0) return {};
  const std::string plugin = own.dli_fname;
  return plugin.substr(0, plugin.rfind('/') + 1) + "novaphy_dlan_kernels.so";
}

template <class T>
void put(std::vector<unsigned char>& bytes, const T& value) {
  const auto* const from = reinterpret_cast<const unsigned char*>(&value);
  bytes.insert(bytes.end(), from, from + sizeof(value));
}

// Builds the table of ahead.h. Each entry holds the address of the stubs.
void list_modules(const StubModule* modules, Kernels& kernels) {
  std::vector<StubModule> all;
  for (; modules->stubs != nullptr; ++modules) all.push_back(*modules);
  std::sort(all.begin(), all.end(), [](const StubModule& x, const StubModule& y) {
    return std::tie(x.key[0], x.key[1]) < std::tie(y.key[0], y.key[1]);
  });
  AheadHeader header{};
  std::memcpy(header.magic, kAheadMagic, sizeof(header.magic));
  header.count = all.size();
  put(kernels.ahead, header);
  uint64_t offset = sizeof(header) + all.size() * sizeof(AheadEntry);
  for (const StubModule& m : all) {
    // Marked as text for the oldest device, so that every device accepts the code.
    put(kernels.ahead, AheadEntry{{m.key[0], m.key[1]}, 0, 1, offset, sizeof(Code)});
    offset += sizeof(Code);
  }
  for (const StubModule& m : all) {
    Code code{};
    std::memcpy(code.magic, kStubs, sizeof(code.magic));
    code.value = reinterpret_cast<uint64_t>(m.stubs);
    put(kernels.ahead, code);
  }
}

const Kernels& kernels() {
  static const Kernels* const opened = [] {
    auto* k = new Kernels;
    const std::string path = default_path();
    void* const library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
    if (library == nullptr) {
      const char* why = dlerror();
      k->problem = "no kernels: " + std::string(why != nullptr ? why : path) +
                   "; python -m novaphy.backend_check dlan compiles them";
      return k;
    }
    using Modules = const StubModule* (*)();
    using Fill = const void* (*)();
    const auto modules = reinterpret_cast<Modules>(dlsym(library, "novaphy_dlan_modules"));
    const auto fill = reinterpret_cast<Fill>(dlsym(library, "novaphy_dlan_fill"));
    if (modules == nullptr || fill == nullptr) {
      k->problem = "no kernels: " + path + " has no symbol novaphy_dlan_" +
                   (modules == nullptr ? "modules" : "fill");
      return k;
    }
    k->fill = fill();
    list_modules(modules(), *k);
    return k;
  }();
  return *opened;
}

// Opens a shared library that lies in memory.
void* open_bytes(const char* bytes, uint64_t count) {
  const int file = memfd_create("novaphy_kernel", MFD_CLOEXEC);
  if (file < 0) return nullptr;
  void* library = nullptr;
  uint64_t done = 0;
  while (done < count) {
    const ssize_t wrote = ::write(file, bytes + done, count - done);
    if (wrote <= 0) break;
    done += static_cast<uint64_t>(wrote);
  }
  if (done == count)
    library = dlopen(("/proc/self/fd/" + std::to_string(file)).c_str(), RTLD_NOW | RTLD_LOCAL);
  ::close(file);
  return library;
}

// Returns the names of the kernels after the prelude, from lines "// kernel NAME WORDS" and uses of
// VENDOR_ENTRY.
std::set<std::string> kernel_names(std::string source) {
  source.erase(0, prelude_text().size() - 1);  // the last line of the prelude ends there
  std::set<std::string> names;
  const auto word_at = [&](size_t at) {
    size_t end = at;
    while (end < source.size() &&
           (std::isalnum(static_cast<unsigned char>(source[end])) != 0 || source[end] == '_'))
      ++end;
    return source.substr(at, end - at);
  };
  std::istringstream lines(source);
  for (std::string line; std::getline(lines, line);) {
    char name[64];
    uint32_t words = 0;
    if (std::sscanf(line.c_str(), "// kernel %63s %u", name, &words) == 2) names.insert(name);
  }
  if (!names.empty()) return names;
  for (const std::string entry : {"\nVENDOR_ENTRY ", "\nBUILTIN "})
    for (size_t at = source.find(entry); at != std::string::npos; at = source.find(entry, at + 1)) {
      at += entry.size();
      const std::string bounds = "__launch_bounds__";
      if (source.compare(at, bounds.size(), bounds) == 0) at = source.find(") ", at) + 2;
      names.insert(word_at(at));
    }
  return names;
}

const char* compiler_command() { return std::getenv("NOVAPHY_DLAN_COMPILER"); }

}  // namespace

const std::string& kernels_problem() { return kernels().problem; }
const void* fill_stub() { return kernels().fill; }

AheadData ahead_data() { return {kernels().ahead.data(), kernels().ahead.size()}; }

Result load_stubs(Module* module, const void* code) {
  Code head;
  std::memcpy(&head, code, sizeof(head));
  StubLibrary made{};
  if (std::memcmp(head.magic, kStubs, sizeof(kStubs)) == 0) {
    made.stubs = reinterpret_cast<const Stub*>(head.value);
  } else if (std::memcmp(head.magic, kLibrary, sizeof(kLibrary)) == 0) {
    made.library = open_bytes(static_cast<const char*>(code) + sizeof(head), head.value);
    if (made.library == nullptr) return kInvalidValue;
    using Stubs = const Stub* (*)();
    const auto stubs = reinterpret_cast<Stubs>(dlsym(made.library, "novaphy_dlan_stubs"));
    if (stubs != nullptr) made.stubs = stubs();
  }
  if (made.stubs == nullptr) {
    if (made.library != nullptr) dlclose(made.library);
    return kInvalidValue;
  }
  *module = reinterpret_cast<Module>(new StubLibrary(made));
  return kSuccess;
}

// Libraries are never closed, because run-time libraries keep addresses of registered kernels.
Result unload_stubs(Module module) {
  delete reinterpret_cast<StubLibrary*>(module);
  return kSuccess;
}

Result find_stub(Function* function, Module module, const char* name) {
  constexpr Result kNotFound = 500;
  for (const Stub* s = reinterpret_cast<StubLibrary*>(module)->stubs; s->name != nullptr; ++s) {
    if (std::strcmp(s->name, name) != 0) continue;
    *function = reinterpret_cast<Function>(const_cast<void*>(s->function));
    return kSuccess;
  }
  return kNotFound;
}

std::string stub_table(const std::string& source) {
  std::string text =
      "#ifndef NOVAPHY_STUB\n#define NOVAPHY_STUB(kernel) ((const void*)kernel)\n#endif\n"
      "namespace novaphy {}\nusing namespace novaphy;\n"
      "static const struct {\n  const char* name;\n  const void* function;\n} stubs[] = {\n";
  for (const std::string& name : kernel_names(source))
    text += "    {\"" + name + "\", NOVAPHY_STUB(" + name + ")},\n";
  return text + "    {0, 0}};\n";
}

// The options do not depend on the compiler command, so code compiled ahead of time stays valid.
const CompilerHook kDlanCompiler = {
    [](Compiler& found, int) {
      const char* command = compiler_command();
      if (command != nullptr && *command != '\0') {
        found.path = found.name = command;
      } else {
        found.problem = "NOVAPHY_DLAN_COMPILER names no command that compiles device code";
      }
    },
    [](Dialect dialect) { return "dialect " + std::to_string(static_cast<int>(dialect)); },
    [](const std::string& source, int, Dialect dialect, bool) {
      CompiledCode code;
      if (dialect == Dialect::Contracted || dialect == Dialect::ContractedSource) {
        code.problem = "no contraction on this device";
        return code;
      }
      code = compile_by_command(
          compiler_command(),
          "namespace novaphy_module {\n" + source + stub_table(source) +
              "}\nextern \"C\" __attribute__((visibility(\"default\"))) const void* "
              "novaphy_dlan_stubs() { return novaphy_module::stubs; }\n");
      if (!code.problem.empty()) return code;
      Code head{};
      std::memcpy(head.magic, kLibrary, sizeof(head.magic));
      head.value = code.bytes.size();
      const auto* const bytes = reinterpret_cast<const char*>(&head);
      code.bytes.insert(code.bytes.begin(), bytes, bytes + sizeof(head));
      return code;
    }};

}  // namespace novaphy::gpu
