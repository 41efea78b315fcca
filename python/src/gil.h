// ReleasedGil: other Python threads run while the engine computes.
#pragma once

#include <pybind11/pybind11.h>

namespace novaphy::python {

// pybind11's own takes the lock back in a destructor. While the interpreter ends Python unwinds a
// daemon thread that asks for the lock, and out of a destructor that is std::terminate. So the exit
// waits for those that are under way, and later ones keep the lock.
class ReleasedGil {
 public:
  ReleasedGil();
  ~ReleasedGil();
  ReleasedGil(const ReleasedGil&) = delete;
  ReleasedGil& operator=(const ReleasedGil&) = delete;

 private:
  PyThreadState* thread_ = nullptr;  // null: kept
};
using release_gil = pybind11::call_guard<ReleasedGil>;

bool exit_waits_for_me();  // so that long work of this thread should end
void wait_at_exit();       // registers the wait

}  // namespace novaphy::python
