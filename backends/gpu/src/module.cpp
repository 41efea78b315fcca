// Modules: from serialized Programs to kernels that can be launched.
#include "module.h"

#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <sstream>

#include "ahead.h"
#include "code_cache.h"
#include "compiler.h"
#include "interpreter.h"
#include "vendor.h"

namespace novaphy::gpu {
namespace {

// NOVAPHY_CUDA_CONTRACT=on lets compilers contract products and sums of all kernels to fused
// multiply-adds, as is common on GPUs.
novaphy_status contraction_is_on(bool* on, novaphy_error* error) {
  const char* text = std::getenv("NOVAPHY_CUDA_CONTRACT");
  const std::string_view value = text != nullptr ? text : "";
  *on = value == "on";
  if (*on || value.empty() || value == "off") return NOVAPHY_OK;
  return fail(error, NOVAPHY_INVALID_ARGUMENT,
              "NOVAPHY_CUDA_CONTRACT: expected on or off, got \"%.40s\"", text);
}

novaphy_status create_program(novaphy_device* device, const void* data, uint64_t bytes,
                              novaphy_module& module, novaphy_error* error) {
  if (bytes % sizeof(uint32_t) != 0)
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "not a valid Program: %llu bytes are no whole words",
                static_cast<unsigned long long>(bytes));
  std::vector<uint32_t> words(bytes / sizeof(uint32_t));  // the caller's bytes may be unaligned
  if (bytes != 0) std::memcpy(words.data(), data, bytes);
  nova::ir::Program program;
  std::string reason;
  if (!nova::ir::deserialize(words, program, reason))
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "%s", reason.c_str());
  bool contract = false;
  novaphy_status status = contraction_is_on(&contract, error);
  if (status != NOVAPHY_OK) return status;
  program.contract = program.contract || contract;
  novaphy_kernel& kernel = *module.kernels.emplace_back(std::make_unique<novaphy_kernel>());
  kernel.device = device;
  kernel.name = program.name;
  kernel.argument_count = program.argument_count();
  kernel.hash = nova::ir::hash(program);
  if (kernel.argument_count > kMaxArgumentWords)
    return fail(error, NOVAPHY_NOT_SUPPORTED,
                "kernel '%s': expected at most %u argument words on this device, got %u",
                kernel.name.c_str(), kMaxArgumentWords, kernel.argument_count);
  const Use use(device);
  KernelNames names{kernel.name, {}};
  for (const nova::ir::Source& source : program.sources) names.sources.push_back(source.name);
  kernel.number = remember_kernel(device, std::move(names));
  if (interpreter_is_forced()) return make_interpreted(device, program, kernel, error);
  status =
      load_code(device, kernel_source(program), kernel.name,
                program.contract ? Dialect::Contracted : Dialect::Program, &module.module, error);
  if (status == NOVAPHY_NOT_SUPPORTED && !contract) {  // the interpreter does not contract
    status = make_interpreted(device, program, kernel, error);
    if (status == NOVAPHY_OK) say_interpreted(compiler(driver().version).problem.c_str());
    return status;
  }
  if (status == NOVAPHY_OK)
    status = check(device, driver().module_function(&kernel.function, module.module, kEntry),
                   kernel.name.c_str(), error);
  kernel.program = std::move(program);
  return status;
}

// Makes a module from text. The text names its kernels in lines "// kernel NAME WORDS". WORDS 0
// stands for the number of words of the launch. A kernel whose threads use their block index has "
// NOVAPHY_BLOCK" at the end.
novaphy_status create_source(novaphy_device* device, const void* data, uint64_t bytes,
                             novaphy_module& module, novaphy_error* error) {
  const std::string text(static_cast<const char*>(data), bytes);
  bool contract = false;
  novaphy_status status = contraction_is_on(&contract, error);
  if (status != NOVAPHY_OK) return status;
  const Use use(device);
  status = load_code(device, module_source(text), "source module",
                     contract ? Dialect::ContractedSource : Dialect::Source, &module.module, error);
  std::istringstream lines(text);
  for (std::string line; status == NOVAPHY_OK && std::getline(lines, line);) {
    char name[64], kind[16] = "";
    unsigned words = 0;
    if (std::sscanf(line.c_str(), "// kernel %63s %u %15s", name, &words, kind) < 2) continue;
    novaphy_kernel& kernel = *module.kernels.emplace_back(std::make_unique<novaphy_kernel>());
    kernel.device = device;
    kernel.name = name;
    kernel.is_block = std::string_view(kind) == "NOVAPHY_BLOCK";
    kernel.argument_count = words;
    kernel.number = remember_kernel(device, {name, {}});
    status =
        check(device, driver().module_function(&kernel.function, module.module, name), name, error);
  }
  if (status == NOVAPHY_OK && module.kernels.empty())
    return fail(
        error, NOVAPHY_INVALID_ARGUMENT,
        "source module: expected a line \"// kernel NAME WORDS\" for every kernel, got none");
  return status;
}

void destroy(novaphy_module* module) {
  novaphy_device* const device = module->device;
  for (const auto& kernel : module->kernels)
    if (kernel->number != 0) forget_kernel(device, kernel->number);
  if (!device->lost) {
    const Use use(device);
    for (const auto& kernel : module->kernels)
      if (kernel->interpreted.code != 0) driver().free(kernel->interpreted.code);
    if (module->module != nullptr) driver().module_unload(module->module);
  }
  delete module;
}

}  // namespace

novaphy_status load_code(novaphy_device* device, const std::string& source, const std::string& name,
                         Dialect dialect, Module* module, novaphy_error* error) {
  const Driver& d = driver();
  if (const AheadCode ahead = find_ahead(ahead_key(source, dialect), device->arch);
      ahead.data != nullptr && d.module_load(module, ahead.data) == kSuccess)
    return NOVAPHY_OK;
  const Compiler& c = compiler(d.version);
  const CodeKey key = disk_key(source, dialect, device->arch);
  std::vector<char> code;
  if (CodeCache::get().find(key, code)) {
    if (d.module_load(module, code.data()) == kSuccess) return NOVAPHY_OK;
    code.clear();  // code of another driver, for example, is compiled again
  }
  if (!c.available())
    return fail(error, NOVAPHY_NOT_SUPPORTED, "kernel '%s' cannot be compiled: %s", name.c_str(),
                c.problem.c_str());
  CompiledCode compiled = compile(source, device->arch, dialect);
  if (!compiled.problem.empty())
    return fail(error, NOVAPHY_INTERNAL, "kernel '%s' does not compile: %s", name.c_str(),
                compiled.problem.c_str());
  const novaphy_status status =
      check(device, d.module_load(module, compiled.bytes.data()), name.c_str(), error);
  if (status == NOVAPHY_OK) CodeCache::get().store(key, compiled.bytes);
  return status;
}

novaphy_status launch_function(novaphy_stream* stream, Function function, int64_t blocks,
                               unsigned threads, void** arguments, const char* name,
                               novaphy_error* error) {
  return check(stream->device,
               driver().launch(function, static_cast<unsigned>(blocks), 1, 1, threads, 1, 1, 0,
                               stream->stream, arguments, nullptr),
               name, error);
}

novaphy_status module_create(novaphy_device* device, int32_t format, const void* data,
                             uint64_t bytes, novaphy_module** module, novaphy_error* error) {
  if (const novaphy_status status = check_lost(device, "module_create", error);
      status != NOVAPHY_OK)
    return status;
  return guarded(error, [&] {
    struct Destroy {
      void operator()(novaphy_module* m) const { destroy(m); }
    };
    std::unique_ptr<novaphy_module, Destroy> made(new novaphy_module);
    made->device = device;
    novaphy_status status = NOVAPHY_OK;
    if (format == NOVAPHY_CODE_PROGRAM) {
      status = create_program(device, data, bytes, *made, error);
    } else if (format == NOVAPHY_CODE_BUILTIN) {
      const std::string_view name(static_cast<const char*>(data), bytes);
      // The name may include its terminating zero.
      novaphy_kernel& kernel = *made->kernels.emplace_back(std::make_unique<novaphy_kernel>());
      kernel.device = device;
      status = make_builtin(device, name.substr(0, name.find('\0')), kernel, error);
    } else if (format == NOVAPHY_CODE_SOURCE) {
      status = create_source(device, data, bytes, *made, error);
    } else {
      status = fail(error, NOVAPHY_NOT_SUPPORTED,
                    "the %s backend takes no modules of code format %d", vendor().name, format);
    }
    if (status == NOVAPHY_OK) *module = made.release();
    return status;
  });
}

void module_destroy(novaphy_module* module) { destroy(module); }

novaphy_status kernel_get(novaphy_module* module, const char* name, novaphy_kernel** kernel,
                          novaphy_error* error) {
  for (const auto& own : module->kernels) {
    // The kernel of a Program is named "main". Other kernels have names of their own.
    const bool is_main = own->hash != 0 || own->run != nullptr;
    if (std::strcmp(name, is_main ? "main" : own->name.c_str()) != 0) continue;
    *kernel = own.get();
    return NOVAPHY_OK;
  }
  return fail(error, NOVAPHY_INVALID_ARGUMENT, "kernel_get: the module has no kernel \"%.64s\"",
              name);
}

novaphy_status launch(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                      const uint64_t* arguments, uint32_t argument_count, novaphy_error* error) {
  return launch_active(stream, kernel, n, nullptr, arguments, argument_count, error);
}

novaphy_status launch_active(novaphy_stream* stream, novaphy_kernel* kernel, int64_t n,
                             const int32_t* active, const uint64_t* arguments,
                             uint32_t argument_count, novaphy_error* error) {
  if (kernel->argument_count != 0 && argument_count != kernel->argument_count) [[unlikely]]
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "kernel '%s': expected %u argument words, got %u",
                kernel->name.c_str(), kernel->argument_count, argument_count);
  if (n <= 0 || n > INT32_MAX) [[unlikely]] {
    if (n == 0) return NOVAPHY_OK;
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "launch: n: expected 0 to %d, got %lld", INT32_MAX,
                static_cast<long long>(n));
  }
  novaphy_device* const device = stream->device;
  if (const novaphy_status status = check_lost(device, kernel->name.c_str(), error);
      status != NOVAPHY_OK) [[unlikely]]
    return status;
  const Use use(device);
  const auto count = reinterpret_cast<DevicePointer>(active);
  if (active != nullptr && kernel->hash == 0)
    return fail(error, NOVAPHY_NOT_SUPPORTED, "launch_active: '%s' is no Program",
                kernel->name.c_str());
  if (kernel->interpreted.code != 0)
    return run_interpreted(stream, *kernel, n, count, arguments, error);
  if (kernel->run != nullptr) return kernel->run(stream, *kernel, n, arguments, error);
  SinkArgument sink = sink_of(device, kernel->number, count);
  // The driver copies the arguments during the call.
  void* pointers[] = {const_cast<uint64_t*>(arguments), &n, &sink};
  const unsigned threads = kernel->is_block ? kBlock : threads_of_block(n, device->units);
  return launch_function(stream, kernel->function, (n + threads - 1) / threads, threads, pointers,
                         kernel->name.c_str(), error);
}

novaphy_status kernel_info(novaphy_kernel* kernel, novaphy_kernel_info* info,
                           novaphy_error* error) {
  const uint64_t size = info->struct_size;
  if (size < sizeof(novaphy_kernel_info))
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "kernel_info: struct_size: expected at least %zu, got %llu",
                sizeof(novaphy_kernel_info), static_cast<unsigned long long>(size));
  *info = {};
  info->struct_size = size;
  info->hash = kernel->hash;
  info->native = kernel->interpreted.code != 0 ? 0 : kernel->program.contract ? 2 : 1;
  info->lanes = 1;
  std::snprintf(info->isa, sizeof(info->isa), "%s", arch_name(kernel->device->arch).c_str());
  return NOVAPHY_OK;
}

}  // namespace novaphy::gpu
