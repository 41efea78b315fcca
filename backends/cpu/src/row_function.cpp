#include "row_function.h"

#include <algorithm>
#include <cstring>

#include "module.h"

namespace novaphy::cpu {

novaphy_status read_row_function(const void* data, uint64_t bytes, novaphy_row_function& function,
                                 novaphy_error* error) {
  if (bytes < sizeof(function)) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "function over rows: expected at least %zu bytes, got %llu", sizeof(function),
                static_cast<unsigned long long>(bytes));
  }
  std::memcpy(&function, data, sizeof(function));
  if (function.struct_size < sizeof(function) || function.name == nullptr ||
      function.rows == nullptr) {
    return fail(error, NOVAPHY_INVALID_ARGUMENT,
                "function over rows: expected a name, a function and at least %zu as struct_size, "
                "got %llu",
                sizeof(function), static_cast<unsigned long long>(function.struct_size));
  }
  return NOVAPHY_OK;
}

void run_row_function(const novaphy_row_function& function, const novaphy_host_api& host, int64_t n,
                      const uint64_t* arguments) {
  // Chunks of rows must not depend on the number of threads.
  const int64_t size = function.chunk == 0 ? 256 : function.chunk;
  struct Work {
    const novaphy_row_function& function;
    int64_t n, size;
    const uint64_t* arguments;
  } work{function, n, size, arguments};
  host.parallel_for((n + size - 1) / size,
                    [](void* pointer, int64_t chunk) {
                      const Work& w = *static_cast<const Work*>(pointer);
                      const int64_t begin = chunk * w.size;
                      w.function.rows(w.arguments, w.n, begin, std::min(begin + w.size, w.n));
                    },
                    &work);
}

}  // namespace novaphy::cpu
