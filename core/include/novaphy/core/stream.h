// Streams and events: owners of the handles of <novaphy/abi/backend.h>. Work in one stream runs in
// order. An event marks a point in a stream that another stream or the host can wait for. On the
// CPU all work runs at once.
#pragma once

#include <utility>

#include "novaphy/core/backend.h"
#include "novaphy/core/device.h"
#include "novaphy/core/export.h"

namespace novaphy {

class NOVAPHY_CORE_API Event {
 public:
  explicit Event(Device device = default_device());
  ~Event();
  Event(Event&& other) noexcept
      : context_(other.context_), event_(std::exchange(other.event_, nullptr)) {}
  Event& operator=(Event&& other) noexcept {
    std::swap(context_, other.context_);
    std::swap(event_, other.event_);
    return *this;
  }

  Device device() const { return context_->id; }
  novaphy_event* native() const { return event_; }
  void record();             // marks the work issued so far to the device's default stream
  void synchronize() const;  // the host waits for the mark
  // Returns the seconds between two recorded events of the same device.
  static double elapsed(const Event& start, const Event& stop);

 private:
  const DeviceContext* context_;
  novaphy_event* event_ = nullptr;
};

class NOVAPHY_CORE_API Stream {
 public:
  explicit Stream(Device device = default_device());
  ~Stream();
  Stream(Stream&& other) noexcept
      : context_(other.context_), stream_(std::exchange(other.stream_, nullptr)) {}
  Stream& operator=(Stream&& other) noexcept {
    std::swap(context_, other.context_);
    std::swap(stream_, other.stream_);
    return *this;
  }

  Device device() const { return context_->id; }
  novaphy_stream* native() const { return stream_; }
  void synchronize() const;
  void wait(const Event& event) const;  // later work of this stream waits for the event
  void record(Event& event) const;      // marks the work issued so far to this stream

 private:
  const DeviceContext* context_;
  novaphy_stream* stream_ = nullptr;
};

}  // namespace novaphy
