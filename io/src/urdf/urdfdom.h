// urdfdom, behind one function: the only file that includes its parser is beside this one.
#pragma once

#include <urdf_model/model.h>

#include <memory>
#include <string>

namespace novaphy::detail {

// Parses a file that check_urdf accepted. `where` begins every message. ErrorKind::Value: urdfdom
// refuses the file, or says of a part that it left it out.
std::shared_ptr<urdf::ModelInterface> parse_urdf(const std::string& where, const std::string& text);

// Takes the links of a model apart, so that a long chain of them does not end on the stack.
void take_apart(urdf::ModelInterface& model);

}  // namespace novaphy::detail
