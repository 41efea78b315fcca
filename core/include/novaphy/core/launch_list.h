// LaunchList: the launches of a step, made once, and again when what they were made of changes. A
// step sets what differs, and runs the list or a stretch of it. The CPU runs the launches as phases
// of one call of its threads. A device enqueues them, and a thread that records submits them.
//
//   LaunchList list(device);
//   const auto scale = list.add(kScale, n, {.x = x, .y = y, .factor = 2.0f});
//   list.run();
//   list.set(scale, {.x = z, .y = y, .factor = 3.0f});
//   list.run();
//
// Devices and rows are checked when a launch is added or set; its arrays live until it ran last.
// Nothing is allocated, counted or locked when a list runs and nobody records.
//
// On the CPU arguments may be memory (`direct`) instead of arrays. A list that has any runs at
// once, also on a thread that records.
//
// Questions of a step to the host stand between two stretches. The CPU has run the first stretch
// when `run` returns, a device when the host has waited. A recording has run nothing.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/device_kernel.h"

namespace novaphy {

class NOVAPHY_CORE_API LaunchList {
 public:
  // A launch of the list.
  template <class A>
  struct Place {
    size_t number = 0;
  };

  explicit LaunchList(Device device);

  // At the end of the list; `chunk`: the rows that a thread of the CPU takes at a time. Errors as
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
  // The launches [first, last).
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
  bool has_memory_ = false;  // among the arguments
  std::vector<Op> ops_;
  std::vector<uint64_t> words_;
  std::vector<Range*> ranges_;  // of each word, or null
  std::vector<Chunk> chunks_;   // on the CPU
  std::vector<int64_t> ends_;   // of the chunks of each phase
};

}  // namespace novaphy
