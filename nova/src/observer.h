// Internal: installs an array observer on a thread while a tape or a capture is active there.
#pragma once

namespace nova::detail {
void enter_observation();
void leave_observation();
}  // namespace nova::detail
