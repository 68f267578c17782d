#!/usr/bin/env python3
"""Writes models.json: what an independent reader finds in model files.

trimesh 5.2.0, numpy 2.4.6 (pip); run as `make_models.py ASSETS > models.json`.
All numbers are of the whole scene in world space, in double precision; triangles without area are not counted.
Not in the list: sparse accessors and negative OBJ indices, which trimesh reads wrongly (tested otherwise in models.rs).
"""

import json
import sys
from pathlib import Path

import numpy as np
import trimesh

FILES = """
gltf/pbr/Suzanne/Suzanne.gltf
gltf/pbr/Avocado/Avocado.gltf
gltf/pbr/BoomBoxWithAxes/BoomBoxWithAxes.gltf
gltf/pbr/Box/Box.glb
gltf/pbr/BoxInterleaved/BoxInterleaved.glb
gltf/pbr/Cube/Cube.gltf
gltf/pbr/NormalTangentTest/NormalTangentTest.glb
gltf/pbr/SimpleMeshes/SimpleMeshes.gltf
gltf/pbr/TextureCoordinateTest/TextureCoordinateTest.gltf
gltf/pbr/Triangle/Triangle.gltf
gltf/pbr/TriangleWithoutIndices/TriangleWithoutIndices.gltf
gltf/pbr/TwoSidedPlane/TwoSidedPlane.gltf
gltf/edge/gltf-transform/ShapeCollection.glb
gltf/edge/gltf-transform/TwoCubes.glb
obj/sphere.obj
obj/torus.obj
obj/double-torus.obj
obj/hemisphere.obj
obj/hexagon.obj
obj/soccerball.obj
obj/spot/spot_triangulated.obj
obj/edge/tobj/triangle.obj
""".split()


def measure(path):
    scene = trimesh.load(path, process=False, force="scene", skip_materials=True)
    triangles = [np.zeros((0, 3, 3))]
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh):
            continue
        corners = np.asarray(mesh.vertices, np.float64)[mesh.faces]
        corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
        if np.linalg.det(matrix[:3, :3]) < 0:
            corners = corners[:, ::-1]
        triangles.append(corners)
    t = np.concatenate(triangles)
    cross = np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])
    area = 0.5 * np.linalg.norm(cross, axis=1)
    t, area = t[area > 0], area[area > 0]
    volume = np.einsum("ij,ij->i", t[:, 0], np.cross(t[:, 1], t[:, 2])).sum() / 6
    return {
        "triangles": len(t),
        "low": t.min((0, 1)).tolist(),
        "high": t.max((0, 1)).tolist(),
        "area": area.sum(),
        "signed_volume": volume,
    }


assets = Path(sys.argv[1])
print(json.dumps({name: measure(assets / name) for name in FILES}, indent=1))
