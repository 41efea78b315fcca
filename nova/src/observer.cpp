// The runtime's reaction to array operations that are not kernel launches.
#include "observer.h"

#include "novaphy/core/error.h"
#include "novaphy/core/storage.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "novaphy/nova/tensor.h"
#include "recorder.h"

namespace nova::detail {
namespace {

using novaphy::ErrorKind;
using novaphy::Range;

class Observer : public novaphy::ArrayObserver {
 public:
  void host_read(const char* what) override { refuse_in_capture(what); }
  void untracked_write(Range&, const char* what) override { refuse_in_capture(what); }

  bool copy(const std::shared_ptr<Range>& target, const std::shared_ptr<Range>& source,
            bool is_float) override {
    if (!is_float) {
      if (!current_capture()) return false;
      submit_copy(target, source);
      return true;
    }
    const auto n = static_cast<int64_t>(target->bytes() / sizeof(float));
    Tensor(target, {n}, DType::F32).copy_(Tensor(source, {n}, DType::F32));
    return true;
  }

  void untracked_operation(const char* what) override {
    refuse_in_capture(what, "; capture the differentiable operation, of a solver its rollout");
    if (Tape::active())
      novaphy::fail(ErrorKind::Runtime, what,
                    " inside an active Tape: it would not be recorded, and gradients would "
                    "silently stop there. Use the "
                    "differentiable operation, or nova.no_grad()");
  }

 private:
  static void refuse_in_capture(const char* what, const char* instead = "") {
    if (current_capture())
      novaphy::fail(ErrorKind::Runtime, what, " inside ", current_capture()->place,
                    ": it cannot be recorded", instead);
  }
};

thread_local Observer observer;
thread_local int depth = 0;
thread_local novaphy::ArrayObserver* before = nullptr;

}  // namespace

void enter_observation() {
  enter_recording();
  if (depth++ == 0) before = novaphy::set_array_observer(&observer);
}
void leave_observation() {
  if (--depth == 0) novaphy::set_array_observer(before);
  leave_recording();
}

}  // namespace nova::detail
