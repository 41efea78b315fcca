// ReleasedGil releases Python's GIL, so that other Python threads run while the engine computes.
#pragma once

#include <pybind11/pybind11.h>

namespace novaphy::python {

// pybind11's class gil_scoped_release takes the GIL back in its destructor. When the interpreter
// ends, Python unwinds the stack of a daemon thread that asks for the GIL. An unwind out of a
// destructor calls std::terminate. Therefore the exit of Python waits for threads that compute, and
// threads that start later keep the GIL.
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

bool exit_waits_for_me();  // whether Python's exit waits for this thread, so long work should end
void wait_at_exit();       // makes Python's exit wait for threads that compute

}  // namespace novaphy::python
