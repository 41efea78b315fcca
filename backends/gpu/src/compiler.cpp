#include "compiler.h"

#include <dlfcn.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <mutex>
#include <shared_mutex>

#include "vendor.h"

namespace novaphy::gpu {
namespace {

namespace fs = std::filesystem;
using Program = struct ProgramTag*;

#define NOVAPHY_GPU_COMPILER_FUNCTIONS(X)                                              \
  X(version, int, (int*, int*), "nvrtcVersion")                                        \
  X(error_string, const char*, (int), "nvrtcGetErrorString")                           \
  X(create, int,                                                                       \
    (Program*, const char*, const char*, int, const char* const*, const char* const*), \
    "nvrtcCreateProgram")                                                              \
  X(destroy, int, (Program*), "nvrtcDestroyProgram")                                   \
  X(compile, int, (Program, int, const char* const*), "nvrtcCompileProgram")           \
  X(log_size, int, (Program, size_t*), "nvrtcGetProgramLogSize")                       \
  X(log, int, (Program, char*), "nvrtcGetProgramLog")                                  \
  X(image_size, int, (Program, size_t*), "nvrtcGetCUBINSize")                          \
  X(image, int, (Program, char*), "nvrtcGetCUBIN")                                     \
  X(text_size, int, (Program, size_t*), "nvrtcGetPTXSize")                             \
  X(text, int, (Program, char*), "nvrtcGetPTX")                                        \
  X(arch_count, int, (int*), "nvrtcGetNumSupportedArchs")                              \
  X(archs, int, (int*), "nvrtcGetSupportedArchs")

struct Functions {
#define NOVAPHY_GPU_MEMBER(name, result, arguments, symbol) result(*name) arguments = nullptr;
  NOVAPHY_GPU_COMPILER_FUNCTIONS(NOVAPHY_GPU_MEMBER)
#undef NOVAPHY_GPU_MEMBER
};
Functions g_functions;

constexpr const char* kNames[] = {"libnvrtc.so.13", "libnvrtc.so.12", "libnvrtc.so"};

// Returns the folders of the toolkit, and of the Python packages beside this library.
std::vector<std::string> folders() {
  std::vector<std::string> list;
  const auto add = [&](const fs::path& folder) {
    std::error_code ignored;
    if (fs::is_directory(folder, ignored)) list.push_back(folder.string());
  };
  Dl_info own{};
  if (dladdr(reinterpret_cast<const void*>(&folders), &own) != 0 && own.dli_fname != nullptr) {
    std::error_code ignored;
    fs::path at = fs::absolute(own.dli_fname, ignored).parent_path();
    for (int up = 0; up < 6 && at.has_relative_path(); ++up, at = at.parent_path()) {
      add(at / "nvidia" / "cu13" / "lib");
      add(at / "nvidia" / "cuda_nvrtc" / "lib");
    }
  }
  if (const char* environment = std::getenv("VIRTUAL_ENV"); environment && *environment) {
    std::error_code ignored;
    for (const auto& python : fs::directory_iterator(fs::path(environment) / "lib", ignored)) {
      add(python.path() / "site-packages" / "nvidia" / "cu13" / "lib");
      add(python.path() / "site-packages" / "nvidia" / "cuda_nvrtc" / "lib");
    }
  }
  for (const char* variable : {"CUDA_HOME", "CUDA_PATH"})
    if (const char* root = std::getenv(variable); root && *root) add(fs::path(root) / "lib64");
  add("/usr/local/cuda/lib64");
  return list;
}

class Search {
 public:
  Search(Compiler& found, int driver_version) : found_(found), driver_version_(driver_version) {}

  void run() {
    if (const char* path = std::getenv("NOVAPHY_NVRTC"); path != nullptr && *path != '\0') {
      if (!attempt(path, 0)) found_.problem = "NOVAPHY_NVRTC: " + problems_;
      return;
    }
    for (const char* name : kNames)
      if (attempt(name, RTLD_NOLOAD)) return;
    for (const std::string& folder : folders())
      for (const char* name : kNames) {
        std::error_code ignored;
        const std::string path = folder + "/" + name;
        if (fs::exists(path, ignored) && attempt(path, 0)) return;
      }
    for (const char* name : kNames)
      if (attempt(name, 0)) return;
    found_.problem = "no NVRTC was found (" + problems_ +
                     "); install nvidia-cuda-nvrtc, or name the library in NOVAPHY_NVRTC";
  }

 private:
  bool refuse(const std::string& path, const std::string& why) {
    problems_ += (problems_.empty() ? "" : "; ") + path + ": " + why;
    return false;
  }
  bool attempt(const std::string& path, int flags) {
    void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL | flags);
    if (library == nullptr) {
      if (flags == 0) {
        const char* why = dlerror();
        refuse(path, why != nullptr ? why : "dlopen failed");
      }
      return false;
    }
    Functions f;
    const char* missing = nullptr;
#define NOVAPHY_GPU_LOAD(name, result, arguments, symbol)                 \
  f.name = reinterpret_cast<result(*) arguments>(dlsym(library, symbol)); \
  if (f.name == nullptr && missing == nullptr) missing = symbol;
    NOVAPHY_GPU_COMPILER_FUNCTIONS(NOVAPHY_GPU_LOAD)
#undef NOVAPHY_GPU_LOAD
    int major = 0, minor = 0;
    if (f.version != nullptr) f.version(&major, &minor);
    const std::string version = std::to_string(major) + "." + std::to_string(minor);
    if (missing != nullptr) return refuse(path, "version " + version + " has no symbol " + missing);
    if (driver_version_ != 0 && major > driver_version_ / 1000)
      return refuse(path, "version " + version + " is too new for the driver, which is of " +
                              std::to_string(driver_version_ / 1000) + "." +
                              std::to_string(driver_version_ % 1000 / 10));
    g_functions = f;
    found_.major = major;
    found_.minor = minor;
    found_.name = "nvrtc " + version;
    found_.path = path;
    return true;
  }

  Compiler& found_;
  const int driver_version_;
  std::string problems_;
};

std::string log_of(Program program) {
  size_t size = 0;
  if (g_functions.log_size(program, &size) != 0 || size < 2) return {};
  std::string log(size, '\0');
  if (g_functions.log(program, log.data()) != 0) return {};
  log.resize(size - 1);
  return log;
}

// Returns "--gpu-architecture=sm_90". For a device newer than the compiler, returns compute_XX and
// sets `is_text`.
std::string architecture_option(int arch, bool& is_text) {
  if (is_text) return "--gpu-architecture=compute_" + std::to_string(arch);
  int count = 0;
  std::vector<int> known;
  if (g_functions.arch_count(&count) == 0 && count > 0) {
    known.resize(static_cast<size_t>(count));
    if (g_functions.archs(known.data()) != 0) known.clear();
  }
  is_text = !known.empty() && std::find(known.begin(), known.end(), arch) == known.end();
  if (!is_text) return "--gpu-architecture=sm_" + std::to_string(arch);
  int nearest = known.front();
  for (const int k : known)
    if (k <= arch) nearest = std::max(nearest, k);
  return "--gpu-architecture=compute_" + std::to_string(nearest);
}

// A mutex that compilations hold and that delays the exit of the process. The exit destroys static
// objects of the compiler, so a running compilation would crash or hang. The delay must come before
// this destruction. The mutex is therefore made after the compiler's objects, most of which the
// compiler makes in its first compilation. (The host prevents an exit before that:
// wait_for_compilers in <novaphy/nova/op_list.h>.)
std::shared_mutex& before_exit() {
  static std::shared_mutex& mutex = [&]() -> std::shared_mutex& {
    Program program = nullptr;
    if (g_functions.create(&program, "__global__ void f() {}", "f.cu", 0, nullptr, nullptr) == 0) {
      g_functions.compile(program, 0, nullptr);
      g_functions.destroy(&program);
    }
    return *new std::shared_mutex;
  }();
  static const struct Exit {
    ~Exit() { mutex.lock(); }
  } exit;
  return mutex;
}

std::string nvrtc_options(Dialect dialect) {
  const bool source = dialect == Dialect::Source || dialect == Dialect::ContractedSource;
  const bool contract = dialect == Dialect::Contracted || dialect == Dialect::ContractedSource;
  return std::string(source ? "--std=c++20 --device-as-default-execution-space" : "--std=c++17") +
         " --ftz=false --prec-div=true --prec-sqrt=true --fmad=" + (contract ? "true" : "false");
}

CompiledCode nvrtc_compile(const std::string& source, int arch, Dialect dialect, bool as_text) {
  CompiledCode code;
  const std::shared_lock lock(before_exit(), std::try_to_lock);
  if (!lock) {
    code.problem = "the process exits";
    return code;
  }
  const Functions& f = g_functions;
  bool is_text = as_text;
  std::vector<std::string> options = {architecture_option(arch, is_text)};
  const std::string all = nvrtc_options(dialect);
  for (size_t at = 0; at < all.size();) {
    const size_t end = std::min(all.find(' ', at), all.size());
    options.push_back(all.substr(at, end - at));
    at = end + 1;
  }
  std::vector<const char*> words;
  for (const std::string& option : options) words.push_back(option.c_str());
  Program program = nullptr;
  int result = f.create(&program, source.c_str(), "kernel.cu", 0, nullptr, nullptr);
  if (result == 0) result = f.compile(program, static_cast<int>(words.size()), words.data());
  size_t size = 0;
  if (result == 0) result = is_text ? f.text_size(program, &size) : f.image_size(program, &size);
  if (result == 0) {
    code.bytes.resize(size);
    result = is_text ? f.text(program, code.bytes.data()) : f.image(program, code.bytes.data());
  }
  if (result != 0 || size == 0) {
    code.problem = f.error_string(result);
    if (program != nullptr) code.problem += "\n" + log_of(program);
  }
  if (program != nullptr) f.destroy(&program);
  return code;
}

}  // namespace

const CompilerHook kNvrtc = {
    [](Compiler& found, int driver_version) { Search(found, driver_version).run(); }, nvrtc_options,
    nvrtc_compile};

const Compiler& compiler(int driver_version) {
  static const Compiler* const found = [&] {
    auto* c = new Compiler;
    const VendorInfo& v = vendor();
    if (v.no_compiler != nullptr) {
      c->problem = v.no_compiler;
    } else {
      v.compiler->find(*c, driver_version);
    }
    return c;
  }();
  return *found;
}

std::string compile_options(Dialect dialect) { return vendor().compiler->options(dialect); }

CompiledCode compile(const std::string& source, int arch, Dialect dialect, bool as_text) {
  return vendor().compiler->compile(source, arch, dialect, as_text);
}

}  // namespace novaphy::gpu
