#!/usr/bin/env python3
"""Fail on an include of a higher layer.

The libraries form layers, and each library may use only the layers below it:
    abi <- core <- nova          core <- collision <- dynamics          core, collision <- vbd
    core <- io
    core, nova, collision, dynamics <- operators <- diff
    a backend uses abi and the reader of Programs

Three kinds of files have a layer that follows from their names:
* `diff_*` in collision/, dynamics/ and vbd/ are operators: kernels of the tensor runtime. They are
  compiled into novaphy::dynamics if the build has nova. The forward code of these folders may not
  include them.
* `*_trace.h` are formulas that the forward engine and traced kernels share. `*_law.h` and the
  headers of vbd/elements are formulas that are not traced. Formulas may include only the math
  headers and other formulas.
* `*_kernels.h` in collision/, dynamics/ and vbd/ are hand-written kernels, which compilers of
  devices read, too. They may include formulas, the math headers, and headers of core that need no
  library. The same holds for all headers of collision/geometry and dynamics/articulation, because
  kernels include them.

The abi headers are C and may include only <stdint.h>. The math headers may include only <cstdint>
and <cmath>. In device code, only vendors/cuda.cuh may have assembler.
    tools/lint/check_layers.py [ROOT]

The program prints one line for each fault. The exit code is 1 if a fault exists, and 2 if ROOT has
no sources.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

# Layer -> other layers that it may include.
ALLOWED: dict[str, set[str]] = {
    "abi": set(),
    "math": set(),
    "program": {"abi"},
    "cpu": {"abi", "program"},
    "gpu": {"abi", "program"},
    "cuda": {"abi", "program", "gpu"},
    "dlan": {"abi", "program", "gpu"},
    "text": {"abi", "math"},
    "core": {"abi", "math", "cpu"},  # the CPU backend is linked into core
    "nova": {"abi", "math", "core", "program"},
    "io": {"math", "core"},
    "formula": {"math"},
    "launch": {"abi", "math", "core", "text"},  # devices read core/device in place of these
    "kernels": {"math", "formula", "text", "launch"},
    "collision": {"math", "core", "formula", "kernels"},
    "dynamics": {"math", "core", "collision", "formula", "kernels"},
    "vbd": {"math", "core", "collision", "formula", "kernels"},
    "operators": {"math", "core", "nova", "formula", "collision", "dynamics", "vbd"},
    "diff": {"math", "core", "nova", "formula", "collision", "dynamics", "vbd", "operators"},
}
# Headers of core that any user of core may include, and that device code may include, too.
TEXT_HEADERS = {
    "row_scratch.h",
    "row_stack.h",
    "enums.h",
    "shape_types.h",
    "joint_types.h",
    "shape_pair_rule.h",
    "export.h",
}
# Headers that declare hand-written kernels, both for the host and for devices.
LAUNCH_HEADERS = {"row_kernel.h", "block_kernel.h", "team.h", "launch_arguments.h"}
for allowed in [allowed for allowed in ALLOWED.values() if "core" in allowed] + [ALLOWED["core"]]:
    allowed.update(("text", "launch"))
# Layer -> the only system headers that it may use.
SYSTEM_HEADERS: dict[str, set[str]] = {
    "abi": {"stdint.h"},
    "math": {"cstdint", "cmath"},
    "formula": set(),
}
# Folder of the repository -> layer. The longest matching folder counts.
FOLDERS = {
    "backends/abi": "abi",
    "backends/program": "program",
    "backends/cpu": "cpu",
    "backends/gpu": "gpu",
    "backends/cuda": "cuda",
    "backends/dlan": "dlan",
    "core/include/novaphy/math": "math",
    "core": "core",
    "io": "io",
    "nova": "nova",
    "collision/include/novaphy/collision/geometry": "kernels",
    "collision": "collision",
    "dynamics/include/novaphy/dynamics/articulation": "kernels",
    "dynamics": "dynamics",
    "vbd/include/novaphy/vbd/elements": "formula",
    "vbd": "vbd",
    "diff": "diff",
}
SUFFIXES = {".h", ".hpp", ".inc", ".c", ".cpp", ".cuh"}
ASSEMBLER = re.compile(r"\basm\b")
INCLUDE = re.compile(r'^\s*#\s*include\s*(?:"([^"]+)"|<([^>]+)>)')


def by_name(layer: str, name: str) -> str:
    """Return the layer of a library's file, which the name of the file may decide."""
    if layer in ("collision", "dynamics", "vbd") and name.endswith(("_trace.h", "_law.h")):
        return "formula"
    if layer in ("collision", "dynamics", "vbd") and name.endswith("_kernels.h"):
        return "kernels"
    if layer == "core" and name in TEXT_HEADERS:
        return "text"
    if layer == "core" and name in LAUNCH_HEADERS:
        return "launch"
    if layer in ("collision", "dynamics", "vbd") and name.startswith("diff_"):
        return "operators"
    return layer


def layer_of_file(path: Path, root: Path) -> str | None:
    """Return the layer of a file of the repository; None: every include is allowed."""
    relative = path.relative_to(root).as_posix()
    for folder in sorted(FOLDERS, key=len, reverse=True):
        if relative.startswith(folder + "/"):
            return by_name(FOLDERS[folder], path.name)
    return None


def layer_of_include(text: str, quoted: bool, path: Path, root: Path) -> str | None:
    """Return the layer of an include; None: a system header or a private file of the library."""
    parts = text.split("/")
    if parts[0] == "novaphy" and len(parts) > 2:
        if parts[1:3] in (["collision", "geometry"], ["dynamics", "articulation"]):
            return "kernels"
        if parts[1:3] == ["vbd", "elements"]:
            return "formula"
        return by_name(parts[1], parts[-1])
    if quoted:
        target = (path.parent / text).resolve()
        if target.is_file() and target.is_relative_to(root):
            return layer_of_file(target, root)
    return None


def check_file(path: Path, root: Path) -> list[str]:
    """Return a message for each fault of a file."""
    layer = layer_of_file(path, root)
    if layer is None:
        return []
    faults = []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if path.suffix == ".cuh" and ASSEMBLER.search(line) and path.name != "cuda.cuh":
            where = f"{path.relative_to(root)}:{number}"
            faults.append(f"{where}: assembler belongs to vendors/cuda.cuh")
        match = INCLUDE.match(line)
        if match is None:
            continue
        text = match[1] or match[2]
        where = f"{path.relative_to(root)}:{number}"
        target = layer_of_include(text, match[1] is not None, path, root)
        if target is None:
            system = SYSTEM_HEADERS.get(layer)
            if system is not None and match[2] is not None and text not in system:
                allowed = ", ".join(f"<{h}>" for h in sorted(system)) or "no system header"
                faults.append(f"{where}: {layer} may not include <{text}> (allowed: {allowed})")
        elif target != layer and target not in ALLOWED[layer]:
            kind = "unknown layer" if target not in ALLOWED else "layer"
            faults.append(f'{where}: {layer} may not include "{text}" ({kind} {target})')
    return faults


def sources(root: Path) -> list[Path]:
    """Return all C and C++ files of the folders that have a layer."""
    top = sorted({folder.split("/")[0] for folder in FOLDERS})
    return sorted(p for t in top for p in (root / t).rglob("*") if p.suffix in SUFFIXES)


def main(arguments: list[str]) -> int:
    """Check a source tree."""
    default = Path(__file__).parents[2]
    root = Path(arguments[0] if arguments else default).resolve()
    files = sources(root)
    if not files:
        print(f"check_layers: no sources under {root}", file=sys.stderr)
        return 2
    faults = [fault for path in files for fault in check_file(path, root)]
    for fault in faults:
        print(fault)
    print(f"check_layers: {len(files)} files, {len(faults)} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
