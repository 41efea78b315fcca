#include <algorithm>

#include "kernel_impl.h"
#include "novaphy/core/error.h"
#include "optional_entry.h"

namespace nova {
namespace detail {
namespace {

// Outlives every kernel, including kernels in static variables.
struct Known {
  std::mutex mutex;
  std::vector<Executable*> list;
};
Known& known() {
  static Known* instance = new Known;
  return *instance;
}

KernelInfo ask(const novaphy::DeviceContext& context, novaphy_kernel* kernel,
               const ir::Program& program) {
  KernelInfo out{program.name, ir::hash(program), context.id, "unknown", "", 1};
  const novaphy_backend_api& api = *context.api;
  if (!has_entry(api, &novaphy_backend_api::kernel_info)) return out;
  novaphy_kernel_info info{};
  info.struct_size = sizeof(info);
  novaphy_error error = novaphy::make_error();
  novaphy::check(api.kernel_info(kernel, &info, &error), error, program.name.c_str());
  info.isa[sizeof(info.isa) - 1] = '\0';
  out.how = info.native != 0 ? "native" : "interpreter";
  out.isa = info.isa;
  out.lanes = info.lanes;
  return out;
}

}  // namespace

void remember_executable(Executable* executable) {
  Known& k = known();
  const std::lock_guard lock(k.mutex);
  k.list.push_back(executable);
}

void forget_executable(Executable* executable) {
  Known& k = known();
  const std::lock_guard lock(k.mutex);
  std::erase(k.list, executable);
}

void Executable::describe(std::vector<KernelInfo>& list) {
  const std::lock_guard lock(mutex_);
  for (const auto& c : all_) list.push_back(ask(*c->context, c->kernel, program));
}

}  // namespace detail

std::vector<KernelInfo> kernel_info() {
  detail::Known& k = detail::known();
  const std::lock_guard lock(k.mutex);
  std::vector<KernelInfo> list;
  for (detail::Executable* executable : k.list) executable->describe(list);
  return list;
}

KernelInfo kernel_info(const ir::Program& program, const novaphy::Device& device) {
  detail::Executable executable(program);
  executable.get(novaphy::device_context(device));
  std::vector<KernelInfo> list;
  executable.describe(list);
  return list.at(0);
}

}  // namespace nova
