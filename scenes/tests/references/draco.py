#!/usr/bin/env python3
"""Writes draco.gltf: two tori that Google's Draco compressed, by both of its methods for meshes.

DracoPy 2.2.0 (pip), numpy; run as `draco.py` in this folder. All values follow from the place on the torus, so that a reader is
tested against formulae: texture coordinates (u, v) in [0, 1), positions of a torus of radii 1 and .4 about y, its normals, and
colours of 8 bits (255 u, 255 v, 128). Positions have 14 bits, texture coordinates 12, normals 10.
"""

import base64
import json
from pathlib import Path

import DracoPy
import numpy as np

AROUND, ACROSS = 24, 12


def torus():
    u, v = np.meshgrid(np.arange(AROUND) / AROUND, np.arange(ACROSS) / ACROSS, indexing="ij")
    u, v = u.ravel(), v.ravel()
    a, b = 2 * np.pi * u, 2 * np.pi * v
    normals = np.stack([np.cos(b) * np.cos(a), np.sin(b), -np.cos(b) * np.sin(a)], 1)
    centres = np.stack([np.cos(a), 0 * a, -np.sin(a)], 1)
    at = lambda i, j: (i % AROUND) * ACROSS + j % ACROSS
    quads = [(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)) for i in range(AROUND) for j in range(ACROSS)]
    faces = [t for p, q, r, s in quads for t in ((p, q, r), (p, r, s))]
    colors = np.stack([255 * u, 255 * v, 0 * u + 128], 1).round().astype(np.uint8)
    return centres + 0.4 * normals, np.array(faces, np.uint32), normals, np.stack([u, v], 1), colors


positions, faces, normals, uvs, colors = torus()
data, views, accessors, meshes = b"", [], [], []
for level, ordered in [(1, True), (10, False)]:
    stream = DracoPy.encode(
        positions,
        faces,
        quantization_bits=14,
        compression_level=level,
        preserve_order=ordered,
        colors=colors,
        tex_coord=uvs,
        normals=normals,
        tex_coord_quantization_bits=12,
        normal_quantization_bits=10,
    )
    decoded = DracoPy.decode(stream)
    ids = {a["attribute_type"]: a["unique_id"] for a in decoded.attributes}
    names = {"POSITION": ids[0], "NORMAL": ids[1], "COLOR_0": ids[2], "TEXCOORD_0": ids[3]}
    views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(stream)})
    data += stream + bytes(-len(stream) % 4)
    kinds = {"POSITION": (5126, "VEC3"), "NORMAL": (5126, "VEC3"), "COLOR_0": (5121, "VEC3"), "TEXCOORD_0": (5126, "VEC2")}
    first, points = len(accessors), len(decoded.points)
    for name, (component, kind) in kinds.items():
        accessor = {"componentType": component, "type": kind, "count": points, "normalized": component == 5121}
        accessors.append(accessor)
    accessors.append({"componentType": 5123, "type": "SCALAR", "count": decoded.faces.size})
    primitive = {
        "attributes": {name: first + k for k, name in enumerate(kinds)},
        "indices": first + 4,
        "extensions": {"KHR_draco_mesh_compression": {"bufferView": len(views) - 1, "attributes": names}},
    }
    meshes.append({"name": f"level {level}", "primitives": [primitive]})
document = {
    "asset": {"version": "2.0"},
    "extensionsUsed": ["KHR_draco_mesh_compression"],
    "extensionsRequired": ["KHR_draco_mesh_compression"],
    "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}],
    "bufferViews": views,
    "accessors": accessors,
    "meshes": meshes,
    "nodes": [{"mesh": 0}, {"mesh": 1, "translation": [4, 0, 0]}],
    "scenes": [{"nodes": [0, 1]}],
    "scene": 0,
}
Path("draco.gltf").write_text(json.dumps(document) + "\n")
