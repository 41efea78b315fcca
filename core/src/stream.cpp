#include "novaphy/core/stream.h"

#include "novaphy/core/error.h"

namespace novaphy {
namespace {

void require_same_device(const char* what, Device expected, Device got) {
  require(expected == got, ErrorKind::Value, what, ": expected an event of device ", expected.str(),
          ", got one of ", got.str());
}

}  // namespace

Event::Event(Device device) : context_(&device_context(device)) {
  novaphy_error error = make_error();
  check(context_->api->event_create(context_->device, &event_, &error), error, "Event");
}

Event::~Event() {
  if (event_ != nullptr) context_->api->event_destroy(event_);
}

void Event::record() {
  novaphy_error error = make_error();
  check(context_->api->event_record(event_, context_->stream, &error), error, "Event.record");
}

void Event::synchronize() const {
  novaphy_error error = make_error();
  check(context_->api->event_synchronize(event_, &error), error, "Event.synchronize");
}

double Event::elapsed(const Event& start, const Event& stop) {
  require_same_device("Event.elapsed", start.device(), stop.device());
  novaphy_error error = make_error();
  double seconds = 0.0;
  check(start.context_->api->event_elapsed(start.event_, stop.event_, &seconds, &error), error,
        "Event.elapsed");
  return seconds;
}

Stream::Stream(Device device) : context_(&device_context(device)) {
  novaphy_error error = make_error();
  check(context_->api->stream_create(context_->device, &stream_, &error), error, "Stream");
}

Stream::~Stream() {
  if (stream_ != nullptr) context_->api->stream_destroy(stream_);
}

void Stream::synchronize() const {
  novaphy_error error = make_error();
  check(context_->api->stream_synchronize(stream_, &error), error, "Stream.synchronize");
}

void Stream::wait(const Event& event) const {
  require_same_device("Stream.wait", device(), event.device());
  novaphy_error error = make_error();
  check(context_->api->stream_wait(stream_, event.native(), &error), error, "Stream.wait");
}

void Stream::record(Event& event) const {
  require_same_device("Stream.record", device(), event.device());
  novaphy_error error = make_error();
  check(context_->api->event_record(event.native(), stream_, &error), error, "Stream.record");
}

}  // namespace novaphy
