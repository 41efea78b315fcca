// The parts specific to Denglin. docs/guide/denglin.md lists the parts that have not been verified.
#include "vendor.h"

#include <cstdlib>
#include <string>

#include "device_source.h"
#include "kernels.h"
#include "novaphy/abi/backend.h"
#include "runtime.h"

namespace novaphy::gpu {
namespace {

// Returns NOVAPHY_DLAN_LIBRARY, or libcurt.so in the SDK folder NOVAPHY_DLAN_ROOT.
const char* library() {
  if (const char* file = std::getenv("NOVAPHY_DLAN_LIBRARY"); file != nullptr && *file != '\0')
    return file;
  const char* root = std::getenv("NOVAPHY_DLAN_ROOT");
  if (root == nullptr || *root == '\0') return nullptr;
  static const std::string in_root = std::string(root) + "/lib/libcurt.so";
  return in_root.c_str();
}

}  // namespace

const VendorInfo& vendor() {
  static constexpr VendorInfo kDenglin = {
      "dlan",         NOVAPHY_DEVICE_DLAN,
      "Denglin",      "dlan_",
      dlan_text,      "NOVAPHY_DLAN_LIBRARY or NOVAPHY_DLAN_ROOT",
      library,        {"libcurt.so", nullptr, nullptr, nullptr},
      load_runtime,   9000,
      &kDlanCompiler, nullptr,
      false,          0,
  };
  return kDenglin;
}

}  // namespace novaphy::gpu
