#include "msh_file.h"

#include <cmath>
#include <limits>
#include <unordered_map>
#include <utility>

namespace novaphy::detail {
namespace {

constexpr int64_t kTetrahedronType = 4;  // of four nodes

// Names of the most common solid elements, by their number in the format.
const char* element_name(int64_t type) {
  switch (type) {
    case 5:
      return "hexahedra";
    case 6:
      return "prisms";
    case 7:
      return "pyramids";
    case 11:
      return "tetrahedra of 10 nodes (second order)";
    default:
      return "other elements";
  }
}

class Reader {
 public:
  explicit Reader(Words& words) : words_(words) {}

  MshFile read() {
    read_format();
    while (!words_.at_end()) read_section();
    require(has_nodes_, ErrorKind::Value, words_.where(),
            ": expected a section $Nodes, got none: the file is not whole");
    require(has_elements_, ErrorKind::Value, words_.where(),
            ": expected a section $Elements, got none: the file is not whole");
    resolve();
    return std::move(file_);
  }

 private:
  struct RawTetrahedron {
    int64_t tag;
    size_t line;
    std::array<int64_t, 4> nodes;  // node tags
  };

  void expect(std::string_view word) {
    const std::string_view got = words_.next(word);
    words_.check(got == word, "expected ", word, ", got ", quoted(got));
  }

  void read_format() {
    constexpr std::string_view start = "$MeshFormat, with which an MSH file begins";
    const std::string_view first = words_.next(start);
    words_.check(first == "$MeshFormat", "expected ", start, ", got ", quoted(first));
    const std::string_view version = words_.next("the version 4.1");
    words_.check(version == "4.1", "expected the version 4.1, got ", quoted(version),
                 " (gmsh old.msh -save -format msh41 -o new.msh converts)");
    const int64_t type = words_.integer("0 (ASCII)");
    words_.check(type == 0, "expected 0 (ASCII), got ", type,
                 ", a binary file (gmsh old.msh -save -format msh41 -o new.msh converts)");
    words_.integer("the size of a number");
    expect("$EndMeshFormat");
  }

  void read_section() {
    const std::string_view name = words_.next("a section");
    words_.check(name.size() > 1 && name[0] == '$' && !name.starts_with("$End"),
                 "expected a section, $Nodes for one, got ", quoted(name));
    const std::string end = "$End" + std::string(name.substr(1));
    if (name == "$Nodes") {
      words_.check(!has_nodes_, "expected one section $Nodes, got a second");
      has_nodes_ = true;
      read_nodes();
      expect(end);
    } else if (name == "$Elements") {
      words_.check(!has_elements_, "expected one section $Elements, got a second");
      has_elements_ = true;
      read_elements();
      expect(end);
    } else {
      while (words_.next(end) != end) continue;
    }
  }

  int64_t dimension() {
    const int64_t value = words_.integer("the dimension of a block");
    words_.check(value >= 0 && value <= 3, "expected a dimension of 0 to 3, got ", value);
    return value;
  }

  void read_nodes() {
    const size_t blocks = words_.count("the number of node blocks");
    const size_t nodes = words_.count("the number of nodes");
    words_.check(nodes <= std::numeric_limits<int32_t>::max(), "expected at most ",
                 std::numeric_limits<int32_t>::max(), " nodes, got ", nodes);
    words_.integer("the smallest node tag");
    words_.integer("the largest node tag");
    rows_.reserve(nodes);
    for (size_t block = 0; block < blocks; ++block) {
      const int64_t dim = dimension();
      words_.integer("the tag of an entity");
      const int64_t parametric = words_.integer("0 or 1 (parametric)");
      words_.check(parametric == 0 || parametric == 1, "expected 0 or 1 (parametric), got ",
                   parametric);
      read_node_block(words_.count("the number of nodes of a block"), parametric * dim);
    }
    words_.check(file_.positions.size() == nodes, "expected ", nodes,
                 " nodes, as $Nodes says, got ", file_.positions.size());
  }

  // `parameters`: the number of parametric coordinates after each position, which are skipped.
  void read_node_block(size_t nodes, int64_t parameters) {
    for (size_t n = 0; n < nodes; ++n) {
      const int64_t tag = words_.integer("a node tag");
      const bool is_new = rows_.try_emplace(tag, static_cast<int32_t>(rows_.size())).second;
      words_.check(is_new, "node ", tag, ": expected every tag once, got it again");
      file_.node_tags.push_back(tag);
    }
    for (size_t n = 0; n < nodes; ++n) {
      float x[3];
      for (float& component : x) {
        component = static_cast<float>(words_.number("a coordinate"));
        words_.check(std::isfinite(component), "node ", file_.node_tags[file_.positions.size()],
                     ": expected finite float32 coordinates, got ", component);
      }
      for (int64_t p = 0; p < parameters; ++p) words_.number("a parameter of a node");
      file_.positions.push_back({x[0], x[1], x[2]});
    }
  }

  void read_elements() {
    const size_t blocks = words_.count("the number of element blocks");
    const size_t elements = words_.count("the number of elements");
    words_.integer("the smallest element tag");
    words_.integer("the largest element tag");
    size_t seen = 0;
    for (size_t block = 0; block < blocks; ++block) {
      const int64_t dim = dimension();
      words_.integer("the tag of an entity");
      const int64_t type = words_.integer("the type of elements");
      const size_t count = words_.count("the number of elements of a block");
      seen += count;
      if (dim < 3) {
        words_.skip_lines(count, "an element");
        continue;
      }
      words_.check(type == kTetrahedronType, "expected solids that are tetrahedra of 4 nodes ",
                   "(type 4), got ", element_name(type), " (type ", type, ")");
      read_tetrahedra(count);
    }
    words_.check(seen == elements, "expected ", elements, " elements, as $Elements says, got ",
                 seen);
  }

  void read_tetrahedra(size_t count) {
    for (size_t n = 0; n < count; ++n) {
      RawTetrahedron raw{};
      raw.tag = words_.integer("an element tag");
      raw.line = words_.line();
      for (int64_t& node : raw.nodes) node = words_.integer("a node tag");
      raw_.push_back(raw);
    }
  }

  // Replaces tags by rows. All sections must have been read, because they may come in any order.
  void resolve() {
    file_.tetrahedra.reserve(raw_.size());
    for (const RawTetrahedron& raw : raw_) {
      MshFile::Tetrahedron tetrahedron{raw.tag, raw.line, {}};
      for (size_t corner = 0; corner < 4; ++corner) {
        const auto at = rows_.find(raw.nodes[corner]);
        words_.check_at(raw.line, at != rows_.end(), "element ", raw.tag,
                        ": expected nodes of $Nodes, got ", raw.nodes[corner],
                        ", which does not exist");
        tetrahedron.nodes[corner] = at->second;
      }
      file_.tetrahedra.push_back(tetrahedron);
    }
  }

  Words& words_;
  MshFile file_;
  std::unordered_map<int64_t, int32_t> rows_;  // node tag -> row
  std::vector<RawTetrahedron> raw_;
  bool has_nodes_ = false, has_elements_ = false;
};

}  // namespace

MshFile read_msh(Words& words) { return Reader(words).read(); }

}  // namespace novaphy::detail
