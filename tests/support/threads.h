// Sets the number of threads of the engine for a scope.
#pragma once

#include "novaphy/core/parallel.h"

namespace novaphy::testing {

class Threads {
 public:
  explicit Threads(int count) { set_num_threads(count); }
  ~Threads() { set_num_threads(before_); }
  Threads(const Threads&) = delete;
  Threads& operator=(const Threads&) = delete;

 private:
  const int before_ = num_threads();
};

}  // namespace novaphy::testing
