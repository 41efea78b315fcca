// LaunchList: the launches of a step. A solver makes the list once, and again when the model or the
// contacts of the list change. A step sets the arguments that differ, and runs the list or a range
// of it. The CPU runs the launches as phases of one call of its threads. A device enqueues the
// launches. A thread that records submits the launches to its recorder.
//
//   LaunchList list(device);
//   const auto scale = list.add(kScale, n, {.x = x, .y = y, .factor = 2.0f});
//   list.run();
//   list.set(scale, {.x = z, .y = y, .factor = 3.0f});
//   list.run();
//
// Devices and row counts are checked when a launch is added or set. Arrays must live until the last
// run. A run without a recorder allocates nothing, counts no references and takes no lock.
//
// On the CPU an argument may be host memory (`direct`) instead of an array. A list with such an
// argument always runs at once, even on a thread that records.
//
// A step that reads results on the host runs the list in two ranges, and reads between them. After
// `run` of the first range the results are ready on the CPU. On a device the host must wait first.
// While a capture records, no result exists.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/device_kernel.h"

namespace novaphy {

class NOVAPHY_CORE_API LaunchList {
 public:
  // The handle of a launch in the list, which `set` takes.
  template <class A>
  struct Place {
    size_t number = 0;
  };

  explicit LaunchList(Device device);

  // Appends a launch. `chunk`: the number of rows that a CPU thread takes at a time. Errors as for
  // DeviceKernel::launch.
  template <class A>
  Place<A> add(const Kernel<A>& kernel, int64_t n, const std::type_identity_t<A>& arguments,
               int64_t chunk = 256) {
    return {append(kernel, n, detail::ArgumentTable<A>::kInfos,
                   reinterpret_cast<const ArgumentWord*>(&arguments), chunk)};
  }
  template <class A>
  void set(Place<A> place, const std::type_identity_t<A>& arguments) {
    put(place.number, reinterpret_cast<const ArgumentWord*>(&arguments));
  }
  size_t size() const { return ops_.size(); }

  void run() const { run(0, size()); }
  // Runs the launches [first, last).
  void run(size_t first, size_t last) const;

 private:
  struct Op {
    const DeviceKernel* kernel;
    const DeviceKernel::Made* made;
    std::span<const ArgumentInfo> infos;
    int64_t n;
    size_t first_word, first_phase;
    bool writes_arrays = false, has_memory = false;
  };
  struct Chunk {
    size_t op;
    int64_t begin, end;
  };
  size_t append(const DeviceKernel& kernel, int64_t n, std::span<const ArgumentInfo> infos,
                const ArgumentWord* values, int64_t chunk);
  void put(size_t number, const ArgumentWord* values);
  void record(const Op& op) const;
  std::span<const uint64_t> words(const Op& op) const {
    return std::span(words_).subspan(op.first_word, op.infos.size());
  }

  Device device_;
  bool has_memory_ = false;  // whether an argument is host memory
  std::vector<Op> ops_;
  std::vector<uint64_t> words_;
  std::vector<Range*> ranges_;  // range of each argument word, or null
  std::vector<Chunk> chunks_;   // chunks of rows, for the CPU
  std::vector<int64_t> ends_;   // end of each phase in chunks_
};

}  // namespace novaphy
