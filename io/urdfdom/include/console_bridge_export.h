// In place of what console_bridge's own build writes: it is linked in, and shows nothing.
#pragma once

#define CONSOLE_BRIDGE_DLLAPI
#define CONSOLE_BRIDGE_DEPRECATED
