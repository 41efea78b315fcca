// Refuses faults of URDF files that urdfdom lets through.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "../robot/notes.h"

namespace novaphy::detail {

struct UrdfElements {
  // The <link> and <joint> elements, by name; names of links and joints are apart.
  std::map<std::string, const Element*> links, joints;
  std::vector<std::string> link_order, joint_order;  // as in the file
  std::string root;                                  // the link without a parent
};

// Checks names, numbers and the tree: one root, each other link the child of one joint, no cycle.
UrdfElements check_urdf(const XmlFile& file, Notes& notes);

}  // namespace novaphy::detail
