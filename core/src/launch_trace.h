// Internal to core: starts the tracing of launches.
#pragma once

namespace novaphy {

// Opens the trace that NOVAPHY_TRACE names, once. Throws ErrorKind::Value if the trace is not
// available.
void open_launch_trace();

}  // namespace novaphy
