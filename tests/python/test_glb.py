"""Binary glTF: places of nodes, types of indices, files that are cut, and what is not read."""

from __future__ import annotations

import json
import random
import struct

import numpy as np
import pytest
from numpy.testing import assert_allclose

import novaphy
from novaphy import io

pytestmark = pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]], np.float32)
FACES = [0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3]


def glb(kind: str = "H", **changes: object) -> bytes:
    """A tetrahedron, its indices of the type `kind`, with changes of the JSON."""
    indices = struct.pack(f"<{len(FACES)}{kind}", *FACES)
    data = CORNERS.tobytes() + indices
    component = {"B": 5121, "H": 5123, "I": 5125, "f": 5126}[kind]
    text = {
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": component, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": len(indices)},
        ],
        "asset": {"version": "2.0", "generator": 'a "quoted" name'},
    }
    body = json.dumps({**text, **changes}).encode()
    body += b" " * (-len(body) % 4)
    chunks = struct.pack("<I4s", len(body), b"JSON") + body
    chunks += struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def load(tmp_path, content: bytes):
    path = tmp_path / "mesh.glb"
    path.write_bytes(content)
    return io.load_mesh(path)


@pytest.mark.parametrize("kind", "BHI")
def test_triangles_are_those_of_the_file(tmp_path, kind):
    mesh = load(tmp_path, glb(kind))
    assert_allclose(mesh.vertices[mesh.indices.ravel()], CORNERS[FACES])


def test_nodes_place_their_meshes(tmp_path):
    half = np.sqrt(0.5)
    nodes = [
        {"children": [1], "translation": [1, 2, 3], "rotation": [0, 0, half, half]},
        {"mesh": 0, "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 5, 0, 1]},
    ]
    mesh = load(tmp_path, glb(nodes=nodes))
    x, y, z = (2 * CORNERS[FACES] + [0, 5, 0]).T
    expected = np.stack([1 - y, 2 + x, 3 + z], axis=1)
    assert_allclose(mesh.vertices[mesh.indices.ravel()], expected, atol=1e-6)


BAD = {
    "cut": (glb()[:-4], ValueError, "a whole .glb file"),
    "version": (b"glTF\1" + glb()[5:], ValueError, "version 2"),
    "text": (glb().replace(b'"scenes"', b'"scenes!', 1), ValueError, "JSON"),
    "cycle": (glb(nodes=[{"mesh": 0, "children": [0]}]), ValueError, "make a tree"),
    "node": (glb(scenes=[{"nodes": [7]}]), ValueError, "parts that the file has"),
    "view": (glb(bufferViews=[{"buffer": 0, "byteLength": 47}] * 2), ValueError, "all there"),
    "indices": (glb("f"), ValueError, "indices of whole numbers"),
    "outside": (glb(bufferViews=[{"buffer": 1, "byteLength": 48}] * 2), NotImplementedError,
                "data outside of the file"),
    "lines": (glb(meshes=[{"primitives": [{"mode": 1, "attributes": {"POSITION": 0}}]}]),
              NotImplementedError, "other than triangles"),
    "nothing": (glb(scenes=[{}]), ValueError, "at least one triangle"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused(tmp_path, name):
    content, error, message = BAD[name]
    with pytest.raises(error, match=message):
        load(tmp_path, content)


def test_mutated_files_are_read_or_refused(tmp_path):
    draw = random.Random(3)
    for _ in range(300):
        content = bytearray(glb("BHI"[draw.randrange(3)]))
        for _ in range(draw.randrange(1, 6)):
            content[draw.randrange(len(content))] = draw.randrange(256)
        try:
            load(tmp_path, bytes(content))
        except (ValueError, NotImplementedError) as error:
            assert "mesh.glb" in str(error)
