// Whether a file is all there, where assimp does not notice: it reads past the end of a PLY file,
// never ends on one without the end of its header or on a COLLADA with something else than numbers
// among its indices, and makes a smaller mesh of an STL text that was cut. (An OBJ does not say how
// much belongs to it; a COLLADA that was cut is no XML.)
#pragma once

#include <string>
#include <string_view>

namespace novaphy::detail {

// `bytes`: the file. ErrorKind::Value, its message beginning with `where`.
void check_whole(const std::string& where, std::string_view extension, std::string_view bytes);

}  // namespace novaphy::detail
