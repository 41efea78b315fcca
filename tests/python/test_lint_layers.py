"""The layer lint accepts a good tree, and names the line of every kind of upward include."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINT = ROOT / "tools" / "lint" / "check_layers.py"

GOOD = {
    "backends/abi/include/novaphy/abi/backend.h": "#include <stdint.h>\n",
    "backends/cpu/src/run.cpp": '#include <vector>\n#include "module.h"\n',
    "backends/cpu/src/module.h": '#include "novaphy/program/ir.h"\n',
    "backends/gpu/src/device_prelude.cuh": '#include "novaphy/program/scalars.h"\n',
    "backends/gpu/src/vendors/cuda.cuh": 'VENDOR_FN void f() { asm volatile("trap;"); }\n',
    "backends/dlan/src/runtime.h": '#include "novaphy/program/ir.h"\n',
    "backends/cuda/src/plugin.cpp": '#include "novaphy/abi/backend.h"\n',
    "core/include/novaphy/math/types.h": "#include <cstdint>\n",
    "core/src/backend.cpp": '#include "novaphy/cpu/query.h"\n#include "novaphy/math/types.h"\n',
    "nova/src/tape.cpp": '#include "novaphy/core/error.h"\n#include "novaphy/program/ir.h"\n',
    "collision/include/novaphy/collision/diff_soft_contact_trace.h": (
        '#include "novaphy/math/types.h"\n'
    ),
    "collision/src/pipeline.cpp": '#include "novaphy/collision/diff_soft_contact_trace.h"\n',
    "collision/src/soft_contact_kernels.h": (
        '#include "novaphy/collision/diff_soft_contact_trace.h"\n'
        '#include "novaphy/collision/geometry/plane_pairs.h"\n'
        '#include "novaphy/core/row_kernel.h"\n'
    ),
    "collision/include/novaphy/collision/geometry/plane_pairs.h": (
        '#include "novaphy/math/types.h"\n#include "novaphy/core/sim/enums.h"\n'
    ),
    "collision/src/soft_contacts.cpp": (
        '#include "soft_contact_kernels.h"\n#include "novaphy/core/device_kernel.h"\n'
    ),
    "core/include/novaphy/core/row_kernel.h": '#include "novaphy/abi/backend.h"\n',
    "collision/src/diff_soft_contacts.cpp": '#include "novaphy/nova/kernel.h"\n',
    "dynamics/src/solver.cpp": '#include "novaphy/collision/collision_pipeline.h"\n',
    "dynamics/src/diff_particles.cpp": '#include "novaphy/collision/diff_soft_contacts.h"\n',
    "diff/src/solver.cpp": '#include "novaphy/dynamics/diff_particles.h"\n',
    "io/src/mesh.cpp": '#include "novaphy/core/error.h"\n#include <assimp/scene.h>\n',
    "tests/core/test_all.cpp": '#include "novaphy/diff/losses.h"\n',
}

# name -> (file, content, what the lint says)
BAD = {
    "geometry, which kernels include, includes a model": (
        "collision/include/novaphy/collision/geometry/shape.h",
        '#include "novaphy/core/sim/model.h"\n',
        "geometry/shape.h:1: kernels may not include",
    ),
    "device code includes core": (
        "backends/gpu/src/sequence.cuh",
        '#include "novaphy/core/error.h"\n',
        "backends/gpu/src/sequence.cuh:1: gpu may not include",
    ),
    "a differentiable operator of vbd is included by its solver": (
        "vbd/src/solver.cpp",
        '#include "novaphy/vbd/diff_solver.h"\n',
        "vbd/src/solver.cpp:1: vbd may not include",
    ),
    "device code of all vendors has assembler": (
        "backends/gpu/src/sequence.cuh",
        'LANE_FN void f() { asm volatile("trap;"); }\n',
        "backends/gpu/src/sequence.cuh:1: assembler belongs to vendors/cuda.cuh",
    ),
    "core includes io": (
        "core/src/io/tet_mesh.cpp",
        '#include "novaphy/io/mesh.h"\n',
        'core/src/io/tet_mesh.cpp:1: core may not include "novaphy/io/mesh.h" (layer io)',
    ),
    "core includes nova": (
        "core/src/array.cpp",
        '#include "novaphy/nova/tensor.h"\n',
        'core/src/array.cpp:1: core may not include "novaphy/nova/tensor.h" (layer nova)',
    ),
    "collision includes dynamics": (
        "collision/src/a.cpp",
        "\n  #  include <novaphy/dynamics/semi_implicit/solver_semi_implicit.h>\n",
        "collision/src/a.cpp:2: collision may not include",
    ),
    "forward code includes the operator beside it": (
        "collision/src/a.cpp",
        '#include "novaphy/collision/diff_soft_contacts.h"\n',
        "(layer operators)",
    ),
    "a formula includes the engine": (
        "dynamics/include/novaphy/dynamics/integrator_trace.h",
        '#include "novaphy/core/error.h"\n',
        "formula may not include",
    ),
    "a formula includes a library header": (
        "dynamics/include/novaphy/dynamics/integrator_trace.h",
        "#include <vector>\n",
        "formula may not include <vector>",
    ),
    "hand-written kernels include the engine": (
        "collision/src/soft_contact_kernels.h",
        '#include "novaphy/core/device_kernel.h"\n',
        "kernels may not include",
    ),
    "the abi includes a C++ header": (
        "backends/abi/include/novaphy/abi/backend.h",
        "#include <cstdint>\n",
        "abi may not include <cstdint>",
    ),
    "a backend includes core": (
        "backends/cpu/src/run.cpp",
        '#include "novaphy/core/parallel.h"\n',
        "cpu may not include",
    ),
    "by a relative path": (
        "nova/src/tape.cpp",
        '#include "../../diff/src/solver.h"\n',
        "nova may not include",
    ),
    "a library that nobody knows": (
        "diff/src/solver.cpp",
        '#include "novaphy/secret/a.h"\n',
        "(unknown layer secret)",
    ),
}


def write(root: Path, files: dict[str, str]) -> None:
    """Write a tree."""
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content, encoding="utf-8")


def lint(root: Path) -> subprocess.CompletedProcess[str]:
    """Run the lint on a tree."""
    return subprocess.run(
        [sys.executable, str(LINT), str(root)], capture_output=True, text=True, check=False
    )


def test_a_tree_that_keeps_the_layers_passes(tmp_path: Path) -> None:
    write(tmp_path, GOOD)
    result = lint(tmp_path)
    assert result.returncode == 0, result.stdout
    assert "0 faults" in result.stdout


@pytest.mark.parametrize("name", BAD)
def test_an_upward_include_is_named_with_its_line(tmp_path: Path, name: str) -> None:
    file, content, message = BAD[name]
    write(tmp_path, GOOD | {"diff/src/solver.h": "", file: content})
    result = lint(tmp_path)
    assert result.returncode == 1
    assert message in result.stdout
    assert "1 faults" in result.stdout


def test_a_tree_without_sources_is_an_error(tmp_path: Path) -> None:
    assert lint(tmp_path).returncode == 2


def test_this_repository_keeps_the_layers() -> None:
    result = lint(ROOT)
    assert result.returncode == 0, result.stdout
