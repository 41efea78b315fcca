// Internal: the source code of the device kernel in contact_body_kernels.h.
#pragma once

namespace novaphy::detail {

const char* contact_body_kernels_source();  // null: the build has no device source

}  // namespace novaphy::detail
