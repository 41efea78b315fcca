// parallel_for over ranges of elements. The chunks have a fixed size, which never depends on the
// number of threads.
#pragma once

#include <algorithm>
#include <cstdint>

#include "novaphy/core/parallel.h"

namespace novaphy {

constexpr int64_t chunk_count(int64_t elements, int64_t chunk_size) {
  return (elements + chunk_size - 1) / chunk_size;
}

// Calls body(begin, end, chunk) for every chunk of [0, elements).
template <class Body>
void for_chunks(int64_t elements, int64_t chunk_size, Body&& body) {
  struct Context {
    int64_t elements, chunk_size;
    Body& body;
  } context{elements, chunk_size, body};
  parallel_for(
      chunk_count(elements, chunk_size),
      [](void* pointer, int64_t chunk) {
        Context& c = *static_cast<Context*>(pointer);
        const int64_t begin = chunk * c.chunk_size;
        c.body(begin, std::min(begin + c.chunk_size, c.elements), chunk);
      },
      &context);
}

}  // namespace novaphy
