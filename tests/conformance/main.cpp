// Conformance of a backend to <novaphy/abi/backend.h> and <novaphy/abi/program.h>.
//   test_conformance --backend <path of a plugin, or a device type> [--require <device type>]
//   [--collect <file>] [--native] [gtest options]
// --collect writes the Programs that were tested, one after the other, for the kernel generator.
// --native asks that the backend runs at least half of them as compiled kernels. A backend without
// a device skips with its reason; --require makes that a failure.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <cstdio>
#include <cstring>
#include <string>

#include "harness.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"

namespace {

using conformance::backend;

std::string g_reason;  // why there is nothing to test

void host_parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context) {
  novaphy::parallel_for(chunks, body, context);
}

const novaphy_backend_api* load(const std::string& path) {
  static const novaphy_host_api host = {sizeof(novaphy_host_api), NOVAPHY_ABI_MAJOR,
                                        NOVAPHY_ABI_MINOR, &host_parallel_for, nullptr};
  void* library = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) {
    g_reason = dlerror();
    return nullptr;
  }
  const auto query =
      reinterpret_cast<novaphy_backend_query_fn>(dlsym(library, NOVAPHY_BACKEND_QUERY_SYMBOL));
  if (query == nullptr) {
    g_reason = "no symbol " NOVAPHY_BACKEND_QUERY_SYMBOL;
    return nullptr;
  }
  novaphy_error error = conformance::make_error();
  const novaphy_backend_api* api = query(NOVAPHY_ABI_MAJOR, &host, &error);
  if (api == nullptr) g_reason = error.message;
  return api;
}

bool open(const std::string& name) {
  auto& b = backend();
  if (name.find('/') != std::string::npos) {
    b.api = load(name);
  } else {
    try {
      b.api = novaphy::device_context(novaphy::Device::parse(name)).api;
    } catch (const novaphy::Error& error) {
      g_reason = error.what();
    }
  }
  if (b.api == nullptr) return false;
  novaphy_error error = conformance::make_error();
  if (b.api->device_count(&b.device_total, &error) != NOVAPHY_OK || b.device_total < 1 ||
      b.api->device_open(0, &b.device, &error) != NOVAPHY_OK ||
      b.api->stream_create(b.device, &b.stream, &error) != NOVAPHY_OK) {
    g_reason = error.message;
    return false;
  }
  return true;
}

}  // namespace

int main(int argc, char** argv) {
  testing::InitGoogleTest(&argc, argv);
  std::string name, required, collected;
  bool native = false;
  for (int k = 1; k < argc; ++k) {
    const bool has_value = k + 1 < argc;
    if (std::strcmp(argv[k], "--backend") == 0 && has_value) {
      name = argv[++k];
    } else if (std::strcmp(argv[k], "--require") == 0 && has_value) {
      required = argv[++k];
    } else if (std::strcmp(argv[k], "--collect") == 0 && has_value) {
      collected = argv[++k];
    } else if (std::strcmp(argv[k], "--native") == 0) {
      native = true;
    } else {
      std::fprintf(stderr, "unknown argument '%s'\n", argv[k]);
      return 2;
    }
  }
  if (name.empty()) {
    std::fprintf(stderr, "usage: %s --backend <path or device type> [--require <device type>]\n",
                 argv[0]);
    return 2;
  }
  const bool opened = open(name);
  if (opened && !required.empty() && required != backend().api->name) {
    std::fprintf(stderr, "required backend '%s', got '%s'\n", required.c_str(),
                 backend().api->name);
    return 1;
  }
  if (!opened) {
    std::fprintf(stderr, "%s: %s\n", required.empty() ? "skipped" : "required backend missing",
                 g_reason.c_str());
    return required.empty() ? 77 : 1;  // CTest's SKIP_RETURN_CODE
  }
  auto& b = backend();
  if (!collected.empty() && (b.collected = std::fopen(collected.c_str(), "wb")) == nullptr) {
    std::fprintf(stderr, "cannot write %s\n", collected.c_str());
    return 2;
  }
  const int status = RUN_ALL_TESTS();
  if (b.collected != nullptr && std::fclose(b.collected) != 0) return 2;
  std::printf("%lld Programs ran natively, %lld in an interpreter\n",
              static_cast<long long>(b.native), static_cast<long long>(b.interpreted));
  if (native && b.native < b.interpreted) {
    std::fprintf(stderr, "too few Programs ran as compiled kernels\n");
    return 1;
  }
  if (testing::UnitTest::GetInstance()->test_to_run_count() == 0) {
    std::fprintf(stderr, "no test was run\n");
    return 1;
  }
  backend().api->stream_destroy(backend().stream);
  backend().api->device_close(backend().device);
  return status;
}
