// Internal: observes reads and writes of arrays by a thread on which a tape or a capture is active.
#pragma once

namespace nova::detail {
void enter_observation();
void leave_observation();
}  // namespace nova::detail
