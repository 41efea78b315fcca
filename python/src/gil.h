// ReleasedGil: other Python threads run while the engine computes.
#pragma once

#include <pybind11/pybind11.h>

namespace novaphy::python {

// pybind11's own class takes the GIL back in a destructor. While the interpreter ends, Python
// unwinds a daemon thread that asks for the GIL. An unwind out of a destructor calls
// std::terminate. The exit therefore waits for threads that compute, and later threads keep the
// GIL.
class ReleasedGil {
 public:
  ReleasedGil();
  ~ReleasedGil();
  ReleasedGil(const ReleasedGil&) = delete;
  ReleasedGil& operator=(const ReleasedGil&) = delete;

 private:
  PyThreadState* thread_ = nullptr;  // null: the thread keeps the GIL
};
using release_gil = pybind11::call_guard<ReleasedGil>;

bool exit_waits_for_me();  // long work of this thread should then end
void wait_at_exit();       // registers the wait

}  // namespace novaphy::python
