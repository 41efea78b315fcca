// Refuses errors in URDF files that urdfdom accepts.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "../robot/notes.h"

namespace novaphy::detail {

struct UrdfElements {
  // The <link> and <joint> elements of a file, by name. A link and a joint may have the same name.
  std::map<std::string, const Element*> links, joints;
  std::vector<std::string> link_order, joint_order;  // names in the order of the file
  std::string root;                                  // the link without a parent
};

// Checks names, numbers and the tree: one root, every other link is the child of exactly one joint,
// and no cycle exists.
UrdfElements check_urdf(const XmlFile& file, Notes& notes);

}  // namespace novaphy::detail
