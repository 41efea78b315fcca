// TangentVisitor: an observer that sees the tangents of kernels while Tape::jvp runs, and may
// change them.
#pragma once

#include <memory>
#include <span>
#include <string_view>

#include "novaphy/nova/export.h"
#include "novaphy/nova/kernel.h"

namespace nova {

// Tape::jvp of this thread calls the visitor that exists, between its construction and destruction.
// Visitors do not nest. On the CPU, outside of captures, the tangents are computed when visit is
// called.
class NOVAPHY_NOVA_API TangentVisitor {
 public:
  TangentVisitor();
  virtual ~TangentVisitor();
  TangentVisitor(const TangentVisitor&) = delete;
  TangentVisitor& operator=(const TangentVisitor&) = delete;

  // Called for each launch of a kernel. `inputs` are the operands of the launch, and `tangents` is
  // the memory of the tangents of each output.
  virtual void visit(std::string_view kernel, std::span<const Operand> inputs,
                     std::span<const std::shared_ptr<novaphy::Range>> tangents) = 0;
  static TangentVisitor* current();  // null: no visitor exists
};

}  // namespace nova
