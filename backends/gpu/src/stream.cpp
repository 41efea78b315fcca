// Streams, events and the capture of a stream into a graph.
#include <utility>

#include "device.h"

namespace novaphy::gpu {

novaphy_status stream_create(novaphy_device* device, novaphy_stream** stream,
                             novaphy_error* error) {
  if (const novaphy_status status = check_lost(device, "stream_create", error);
      status != NOVAPHY_OK)
    return status;
  return guarded(error, [&] {
    const Use use(device);
    Stream made = nullptr;
    // The stream is ordered with the driver's default stream, which other libraries use by default.
    // Memory shared with them then needs no events.
    const novaphy_status status =
        check(device, driver().stream_create(&made, kStreamDefault), "stream_create", error);
    if (status == NOVAPHY_OK) *stream = new novaphy_stream{device, made};
    return status;
  });
}

void stream_destroy(novaphy_stream* stream) {
  if (!stream->device->lost) {
    const Use use(stream->device);
    driver().stream_destroy(stream->stream);
  }
  delete stream;
}

novaphy_status stream_synchronize(novaphy_stream* stream, novaphy_error* error) {
  if (const novaphy_status status = check_lost(stream->device, "stream_synchronize", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(stream->device);
  const novaphy_status status = check(stream->device, driver().stream_synchronize(stream->stream),
                                      "stream_synchronize", error);
  return status == NOVAPHY_OK ? check_reads(stream->device, stream, error) : status;
}

novaphy_status stream_wait(novaphy_stream* stream, novaphy_event* event, novaphy_error* error) {
  if (const novaphy_status status = check_lost(stream->device, "stream_wait", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(stream->device);
  return check(stream->device, driver().stream_wait(stream->stream, event->event, 0), "stream_wait",
               error);
}

novaphy_status event_create(novaphy_device* device, novaphy_event** event, novaphy_error* error) {
  if (const novaphy_status status = check_lost(device, "event_create", error); status != NOVAPHY_OK)
    return status;
  return guarded(error, [&] {
    const Use use(device);
    Event made = nullptr;
    const novaphy_status status =
        check(device, driver().event_create(&made, 0), "event_create", error);
    if (status == NOVAPHY_OK) *event = new novaphy_event{device, made};
    return status;
  });
}

void event_destroy(novaphy_event* event) {
  if (!event->device->lost) {
    const Use use(event->device);
    driver().event_destroy(event->event);
  }
  delete event;
}

novaphy_status event_record(novaphy_event* event, novaphy_stream* stream, novaphy_error* error) {
  if (const novaphy_status status = check_lost(event->device, "event_record", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(event->device);
  event->recorded = true;
  return check(event->device, driver().event_record(event->event, stream->stream), "event_record",
               error);
}

novaphy_status event_synchronize(novaphy_event* event, novaphy_error* error) {
  if (const novaphy_status status = check_lost(event->device, "event_synchronize", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(event->device);
  return check(event->device, driver().event_synchronize(event->event), "event_synchronize", error);
}

novaphy_status event_elapsed(novaphy_event* start, novaphy_event* stop, double* seconds,
                             novaphy_error* error) {
  if (!start->recorded || !stop->recorded)
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "event_elapsed: the %s event was not recorded",
                start->recorded ? "second" : "first");
  if (const novaphy_status status = check_lost(stop->device, "event_elapsed", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(stop->device);
  float milliseconds = 0.0f;
  novaphy_status status =
      check(stop->device, driver().event_synchronize(stop->event), "event_elapsed", error);
  if (status == NOVAPHY_OK)
    status = check(stop->device, driver().event_elapsed(&milliseconds, start->event, stop->event),
                   "event_elapsed", error);
  *seconds = 1e-3 * static_cast<double>(milliseconds);
  return status;
}

novaphy_status capture_begin(novaphy_stream* stream, novaphy_error* error) {
  if (const novaphy_status status = check_lost(stream->device, "capture_begin", error);
      status != NOVAPHY_OK)
    return status;
  if (stream->capturing)
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "capture_begin: the stream is being captured");
  const Use use(stream->device);
  // The capture uses a stream that is not ordered with the default stream. Otherwise work of
  // another thread on the default stream would break the capture.
  Stream recording = nullptr;
  novaphy_status status =
      check(stream->device, driver().stream_create(&recording, kStreamNonBlocking), "capture_begin",
            error);
  if (status != NOVAPHY_OK) return status;
  status = check(stream->device, driver().capture_begin(recording, kCaptureRelaxed),
                 "capture_begin", error);
  if (status != NOVAPHY_OK) {
    driver().stream_destroy(recording);
    return status;
  }
  stream->before_capture = std::exchange(stream->stream, recording);
  stream->capturing = true;
  return NOVAPHY_OK;
}

novaphy_status capture_end(novaphy_stream* stream, novaphy_graph** graph, novaphy_error* error) {
  if (!stream->capturing)
    return fail(error, NOVAPHY_INVALID_ARGUMENT, "capture_end: the stream is not being captured");
  stream->capturing = false;
  return guarded(error, [&] {
    const Driver& d = driver();
    const Use use(stream->device);
    Graph recorded = nullptr;
    novaphy_status status =
        check(stream->device, d.capture_end(stream->stream, &recorded), "capture_end", error);
    d.stream_destroy(std::exchange(stream->stream, stream->before_capture));
    if (status != NOVAPHY_OK) return status;
    GraphExec exec = nullptr;
    status = check(stream->device, d.graph_instantiate(&exec, recorded, 0), "capture_end", error);
    d.graph_destroy(recorded);
    if (status == NOVAPHY_OK) *graph = new novaphy_graph{stream->device, exec};
    return status;
  });
}

novaphy_status graph_launch(novaphy_graph* graph, novaphy_stream* stream, novaphy_error* error) {
  if (const novaphy_status status = check_lost(stream->device, "graph_launch", error);
      status != NOVAPHY_OK)
    return status;
  const Use use(stream->device);
  return check(stream->device, driver().graph_launch(graph->exec, stream->stream), "graph_launch",
               error);
}

void graph_destroy(novaphy_graph* graph) {
  if (!graph->device->lost) {
    const Use use(graph->device);
    driver().graph_exec_destroy(graph->exec);
  }
  delete graph;
}

}  // namespace novaphy::gpu
