// Prints the choices that the core library makes from the environment. Errors are printed as
// "error: ...".
#include <cstdio>
#include <cstring>
#include <string>

#include "novaphy/core/backend.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"

namespace {

void print_backends() {
  for (const novaphy::BackendInfo& info : novaphy::backends()) {
    std::printf("%s|%s|%s|%s|%d|%s\n", info.name.c_str(), info.path.c_str(),
                info.loaded ? "loaded" : "refused", info.active ? "active" : "idle",
                info.device_count, info.error.c_str());
  }
}

int run(const std::string& command, const std::string& argument) {
  if (command == "threads") {
    std::printf("%d\n", novaphy::num_threads());
  } else if (command == "backends") {
    print_backends();
  } else if (command == "default_device") {
    std::printf("%s\n", novaphy::default_device().str().c_str());
  } else if (command == "open") {
    novaphy::require_device(novaphy::Device::parse(argument));
    std::printf("opened\n");
  } else if (command == "launch") {  // launches a builtin kernel
    const auto in = novaphy::DeviceArray<int32_t>(4), out = novaphy::DeviceArray<int32_t>(4);
    static const novaphy::DeviceKernel kernel(argument.c_str());  // static: the module stays loaded
    kernel.launch(novaphy::Device::cpu(), 4,
                  {novaphy::reads("in", in), novaphy::writes("out", out)});
    std::printf("launched\n");
  } else if (command == "load") {
    const novaphy::BackendInfo info = novaphy::load_backend(argument);
    std::printf("%s %s %s\n", info.name.c_str(), info.version.c_str(),
                info.active ? "active" : "idle");
    novaphy::DeviceArray<float> array(3);
    array.fill(2.0f);
    std::printf("%g\n", static_cast<double>(array.to_host()[2]));
    print_backends();
  } else {
    return 2;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return argc >= 2 ? run(argv[1], argc >= 3 ? argv[2] : "") : 2;
  } catch (const novaphy::Error& error) {
    std::printf("error: %s\n", error.what());
    return 1;
  }
}
