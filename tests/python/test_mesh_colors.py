"""Shapes of robots have the colors of the materials of their meshes."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")

# A triangle of 1/2 m^2 and one of 2 m^2.
OBJ = """mtllib look.mtl
v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nv 0 2 0\nv 0 0 1
usemtl small part
f 1 2 3
usemtl large
f 1 4 5
usemtl unknown
f 1 4 6
"""
MTL = "newmtl small part\nKd 1 0 0\nnewmtl large\n  Kd 0.25 0.5 0.75\n"
DAE = """<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit meter="1"/><up_axis>Z_UP</up_axis></asset>
<library_effects><effect id="e"><profile_COMMON><technique sid="t"><phong><diffuse>
<color>0.25 0.5 0.75 1</color></diffuse></phong></technique></profile_COMMON></effect>
</library_effects><library_materials><material id="m" name="m">
<instance_effect url="#e"/></material>
</library_materials><library_geometries><geometry id="g"><mesh><source id="p">
<float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common>
<accessor source="#a" count="3" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
<triangles material="s" count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p>
</triangles></mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="w">
<node><instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="s" target="#m"/></technique_common></bind_material></instance_geometry>
</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#w"/></scene>
</COLLADA>"""


def glb(look: dict) -> bytes:
    """One triangle with a material."""
    data = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]).tobytes()
    text = json.dumps(
        {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
            "materials": [{"pbrMetallicRoughness": look}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3}],
            "bufferViews": [{"buffer": 0, "byteLength": len(data)}],
        }
    ).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text
    body += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def colors(folder, mesh: str, material: str = "") -> list[float]:
    """Of a robot with one visual."""
    urdf = folder / "robot.urdf"
    urdf.write_text(
        f'<robot name="r"><link name="a"><visual><geometry><mesh filename="{mesh}"/></geometry>'
        f"{material}</visual></link></robot>"
    )
    builder = novaphy.ModelBuilder()
    builder.add_urdf(str(urdf))
    return builder.finalize().shape_color.numpy()[0].tolist()


def test_materials_color_a_mesh(tmp_path):
    (tmp_path / "part.obj").write_text(OBJ)
    none = [-1.0, -1.0, -1.0]
    assert colors(tmp_path, "part.obj") == none  # without the file of materials
    (tmp_path / "look.mtl").write_text(MTL)
    assert colors(tmp_path, "part.obj") == [1.0, 0.0, 0.0]  # the color of the first part
    blue = '<material name="blue"><color rgba="0 0 1 1"/></material>'
    assert colors(tmp_path, "part.obj", blue) == [0.0, 0.0, 1.0]  # the file of the robot counts
    (tmp_path / "look.mtl").write_text(MTL + "map_Kd image.png\n")
    assert colors(tmp_path, "part.obj") == [1.0, 0.0, 0.0]  # an image is no color
    (tmp_path / "part.dae").write_text(DAE)
    assert colors(tmp_path, "part.dae") == [0.25, 0.5, 0.75]
    (tmp_path / "part.glb").write_bytes(glb({"baseColorFactor": [0.0, 1.0, 0.214041140, 1.0]}))
    np.testing.assert_allclose(colors(tmp_path, "part.glb"), [0.0, 1.0, 0.5], atol=1e-6)
    (tmp_path / "part.glb").write_bytes(glb({"baseColorTexture": {"index": 0}}))
    assert colors(tmp_path, "part.glb") == none


def test_a_part_of_each_material_has_its_color(tmp_path):
    (tmp_path / "part.obj").write_text(OBJ)
    (tmp_path / "look.mtl").write_text(MTL)
    urdf = tmp_path / "robot.urdf"
    mesh = '<geometry><mesh filename="part.obj" scale="1 1 -1"/></geometry>'
    urdf.write_text(
        f'<robot name="r"><link name="a"><visual>{mesh}</visual><visual>{mesh}</visual>'
        f'<collision>{mesh}</collision><visual>{mesh}<material name="m"><color rgba="0 1 0 1"/>'
        "</material></visual></link></robot>"
    )
    builder = novaphy.ModelBuilder()
    builder.add_urdf(str(urdf))
    model = builder.finalize()
    assert model.shape_label == [
        *("a/visual_0", "a/visual_0/part_1", "a/visual_0/part_2"),
        *("a/visual_1", "a/visual_1/part_1", "a/visual_1/part_2"),
        *("a/visual_2", "a/collision_0"),
    ]
    shown = model.shape_color.numpy()
    parts = [[1, 0, 0], [0.25, 0.5, 0.75], [-1, -1, -1]]
    np.testing.assert_allclose(shown, [*parts, *parts, [0, 1, 0], [0.25, 0.5, 0.75]])
    # Each part has one triangle, with its corners in the file.
    ranges = model.shape_mesh_range.numpy()
    assert ranges[:, [1, 3]].tolist() == [[3, 1]] * 6 + [[6, 3]] * 2
    corners = model.mesh_vertices.numpy()[ranges[1, 0] : ranges[1, 0] + 3]
    assert sorted(corners.tolist()) == [[0, 0, 0], [0, 2, 0], [2, 0, 0]]
