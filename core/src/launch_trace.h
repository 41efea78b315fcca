// Internal to core.
#pragma once

namespace novaphy {

// Opens what NOVAPHY_TRACE asks for, once; throws ErrorKind::Value where that cannot be had.
void open_launch_trace();

}  // namespace novaphy
