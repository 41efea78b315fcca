#include "gil.h"

#include <atomic>

namespace novaphy::python {
namespace py = pybind11;

namespace {
std::atomic<int> g_released{0};  // threads that compute without the GIL
// The thread that ends the interpreter; 0: the interpreter runs. Written with the GIL.
std::atomic<unsigned long> g_exiting{0};
}  // namespace

ReleasedGil::ReleasedGil() {
  if (g_exiting != 0) return;
  ++g_released;
  thread_ = PyEval_SaveThread();
}

ReleasedGil::~ReleasedGil() {
  if (thread_ == nullptr) return;
  PyEval_RestoreThread(thread_);
  if (--g_released == 0) g_released.notify_all();
}

bool exit_waits_for_me() { return g_exiting != 0 && g_exiting != PyThread_get_thread_ident(); }

void wait_at_exit() {
  const py::cpp_function wait([] {
    g_exiting = PyThread_get_thread_ident();
    PyThreadState* const thread = PyEval_SaveThread();
    for (int n = 0; (n = g_released) != 0;) g_released.wait(n);
    PyEval_RestoreThread(thread);
  });
  py::module_::import("atexit").attr("register")(wait);
  // After a fork, the child process has only the thread that called fork.
  const py::cpp_function forked([] { g_released = 0; });
  py::module_::import("os").attr("register_at_fork")(py::arg("after_in_child") = forked);
}

}  // namespace novaphy::python
