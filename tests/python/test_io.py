"""Meshes from files, and what a build without the mesh reader says."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import novaphy
from novaphy import io

DATA = Path(__file__).parents[1] / "data"
NEEDS_IO = pytest.mark.skipif(
    not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it"
)
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n"
SQUARES = {  # the same square in all formats
    ".obj": SQUARE,
    ".stl": """solid square
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 1 1 0
endloop
endfacet
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 1 0
vertex 0 1 0
endloop
endfacet
endsolid square
""",
    ".ply": """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
1 1 0
0 1 0
4 0 1 2 3
""",
    ".dae": """<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_geometries><geometry id="square"><mesh>
<source id="p"><float_array id="a" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
<technique_common><accessor source="#a" count="4" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>4</vcount><p>0 1 2 3</p></polylist>
</mesh></geometry></library_geometries>
<library_visual_scenes><visual_scene id="s"><node><instance_geometry url="#square"/></node>
</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>
</COLLADA>
""",
}


def volume(vertices: np.ndarray, tets: np.ndarray) -> float:
    """The volume of tetrahedra, in double."""
    p, q, r, s = (vertices.astype(np.float64)[tets[:, c]] for c in range(4))
    return float(np.einsum("ij,ij->i", q - p, np.cross(r - p, s - p)).sum() / 6.0)


def test_a_tet_mesh_is_arrays_that_the_builder_takes():
    mesh = io.load_tet_mesh(DATA / "cube.msh")
    vertices, indices = mesh
    assert vertices.shape == (8, 3) and vertices.dtype == np.float32
    assert indices.shape == (5, 4) and indices.dtype == np.int32
    assert vertices is mesh.vertices and indices is mesh.indices
    assert volume(*mesh) == 1.0
    vertices *= 2.0  # an array of one's own
    assert volume(*mesh) == 8.0

    for given in ({"mesh": mesh}, {"vertices": vertices, "indices": indices}):
        builder = novaphy.ModelBuilder()
        builder.add_soft_mesh(**given, density=3.0)
        model = builder.finalize()
        assert (model.particle_count, model.tet_count, model.tri_count) == (8, 5, 12)
        assert model.particle_mass.numpy().sum() == pytest.approx(24.0)


def test_tet_mesh_paths_are_strings_or_paths():
    path = DATA / "cube.msh"
    for given in (str(path), os.fspath(path), path):
        assert len(io.load_tet_mesh(given).indices) == 5
    with pytest.raises(TypeError):
        io.load_tet_mesh(None)


def test_bad_tet_meshes_are_python_errors_with_file_and_line(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.msh"):
        io.load_tet_mesh(tmp_path / "none.msh")
    with pytest.raises(IsADirectoryError):
        io.load_tet_mesh(tmp_path)
    path = tmp_path / "bad.msh"
    good = (DATA / "cube.msh").read_text()
    for old, new, message in [
        ("4.1 0 8", "2.2 0 8", r"bad\.msh:2: expected the version 4\.1, got \"2\.2\""),
        ("\n0 0 1\n", "\n0 0 nan\n", "node 20: expected finite"),
        ("12 40 3 10 20", "12 40 3 10 99", "element 12: expected nodes of .Nodes, got 99"),
        ("12 40 3 10 20", "12 3 40 10 20", r"\(element 12\) is inverted.* 1 inverted"),
        ("12 40 3 10 20", "12 40 3 10 11", r"\(element 12\) is degenerate.* 1 are degenerate"),
        ("13 11 10 3 23", "13 40 3 10 20", "on one side"),
    ]:
        assert old in good
        path.write_text(good.replace(old, new))
        with pytest.raises(ValueError, match=message):
            io.load_tet_mesh(path)
    loose = good.replace("3 8 3 40", "4 9 3 50")
    path.write_text(loose.replace("\n3 1 0 4\n", "\n0 9 0 1\n50\n9 9 9\n3 1 0 4\n"))
    with pytest.raises(ValueError, match="node 50: .* loose"):
        io.load_tet_mesh(path)
    assert io.load_tet_mesh(path, drop_loose_vertices=True).vertices.shape == (8, 3)


@pytest.mark.skipif(novaphy.has_io(), reason="this build has the mesh reader")
def test_a_build_without_the_mesh_reader_says_how_to_get_it(tmp_path):
    for path in ("a.obj", tmp_path):
        with pytest.raises(ImportError, match=r"-DNOVAPHY_WITH_IO=ON -DNOVAPHY_ASSIMP=source"):
            io.load_mesh(path)
    for add in (novaphy.ModelBuilder().add_urdf, novaphy.ModelBuilder().add_mjcf):
        with pytest.raises(ImportError, match=r"-DNOVAPHY_URDFDOM=source"):
            add("robot.urdf", floating=True)
    assert novaphy.build_info()["NOVAPHY_WITH_IO"] is False


@NEEDS_IO
def test_a_mesh_is_arrays_that_the_builder_takes(tmp_path):
    assert novaphy.build_info()["NOVAPHY_WITH_IO"] is True
    path = tmp_path / "square.obj"
    path.write_text(SQUARE)
    mesh = io.load_mesh(path)
    assert mesh.vertices.dtype == np.float32 and mesh.indices.dtype == np.int32
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert mesh.indices.shape == (2, 3)
    builder = novaphy.ModelBuilder()
    builder.add_cloth_mesh(**mesh._asdict(), density=0.5)
    model = builder.finalize()
    assert (model.particle_count, model.tri_count, model.edge_count) == (4, 2, 5)
    assert model.particle_mass.numpy().sum() == pytest.approx(0.5)
    apart = io.load_mesh(str(path), join_vertices=False)
    assert apart.vertices.shape == (6, 3) and apart.indices.tolist() == [[0, 1, 2], [3, 4, 5]]


@NEEDS_IO
@pytest.mark.parametrize("ending", SQUARES)
def test_all_formats_give_the_same_mesh(tmp_path, ending):
    path, text = tmp_path / f"square{ending}", SQUARES[ending]
    path.write_text(text)
    vertices, indices = io.load_mesh(path)
    assert vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    assert indices.tolist() == [[0, 1, 2], [0, 2, 3]]
    path.write_text(text[: len(text) // 2])
    with pytest.raises(ValueError, match=rf"load_mesh: .*square\{ending}:([0-9]+:)? expected"):
        io.load_mesh(path)


@NEEDS_IO
def test_bad_meshes_are_python_errors_that_name_the_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.obj"):
        io.load_mesh(tmp_path / "none.obj")
    for name, text, message in [
        ("a.fbx", SQUARE, r"ends in \.obj, \.stl, \.ply, \.dae or \.glb, got \.fbx"),
        ("a.obj", "", r"a\.obj: expected a whole \.obj file; assimp says: "),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "triangle 0: expected finite"),
        ("a.obj", SQUARE + "f 1 2 9\n", "assimp says: .*out of range"),
        ("a.obj", SQUARE + "f 1 2 2\n", "two at one position"),
    ]:
        (tmp_path / name).write_text(text)
        with pytest.raises(ValueError, match=message):
            io.load_mesh(tmp_path / name)
    assert len(io.load_mesh(tmp_path / "a.obj", drop_degenerate=True).indices) == 2


def test_what_is_no_regular_file_is_not_replaced(tmp_path):
    pipe = tmp_path / "pipe.npz"
    os.mkfifo(pipe)
    with pytest.raises(ValueError, match="path: expected a regular file"):
        novaphy.io.save_npz(pipe, x=np.zeros(1))
    assert pipe.is_fifo()
