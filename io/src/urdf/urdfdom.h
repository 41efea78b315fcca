// The interface to urdfdom. Only urdfdom.cpp includes its parser.
#pragma once

#include <urdf_model/model.h>

#include <memory>
#include <string>

namespace novaphy::detail {

// Parses a file that check_urdf has accepted. Every error message begins with `where`.
// ErrorKind::Value: urdfdom refuses the file, or reports that it left out a part.
std::shared_ptr<urdf::ModelInterface> parse_urdf(const std::string& where, const std::string& text);

// Disconnects the links of a model. Otherwise the destruction of a long chain would recurse too
// deep.
void take_apart(urdf::ModelInterface& model);

}  // namespace novaphy::detail
